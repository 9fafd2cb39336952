"""Ensembles of trees as plain arrays, which are saved without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

LEAF = -1  # instead of the number of a feature


@dataclass(frozen=True)
class Forest:
    """Classification trees whose class probabilities are averaged.

    Attributes:
        root: number of each tree's first node.
        feature: number of the feature that a node compares; LEAF = none.
        threshold: up to which a row goes on to ``left``, and beyond it to ``right``.
        left: number of a node; both are greater than that of the node itself.
        right: likewise.
        share: probability of each class at a leaf.

    Example:
        >>> from sklearn.ensemble import ExtraTreesClassifier
        >>> x, y = np.arange(20.0)[:, None], np.arange(20) // 10
        >>> trees = ExtraTreesClassifier(5, random_state=0).fit(x, y)
        >>> bool((Forest.of(trees).probabilities(x) == trees.predict_proba(x)).all())
        True
    """

    root: Int[np.ndarray, " tree"]
    feature: Int[np.ndarray, " node"]
    threshold: Float[np.ndarray, " node"]
    left: Int[np.ndarray, " node"]
    right: Int[np.ndarray, " node"]
    share: Float[np.ndarray, "node klass"]

    @classmethod
    def of(cls, forest: Any, classes: Int[np.ndarray, " klass"] | None = None) -> Forest:
        """The trees of a fitted scikit-learn ensemble for classification.

        Args:
            forest: the ensemble.
            classes: sorted, among them all that it learned; one that it did not learn has no share. None = those.
        """
        trees = [estimator.tree_ for estimator in forest.estimators_]
        root = np.cumsum([0, *(tree.node_count for tree in trees[:-1])])
        leaf = np.concatenate([tree.children_left for tree in trees]) < 0
        value = np.concatenate([tree.value[:, 0] for tree in trees])
        share = value / value.sum(1, keepdims=True)
        if classes is not None:
            known, share = share, np.zeros((len(share), len(classes)))
            share[:, np.searchsorted(classes, forest.classes_)] = known
        left, right = (
            np.concatenate([getattr(tree, side) + first for tree, first in zip(trees, root, strict=True)])
            for side in ("children_left", "children_right")
        )
        return cls(
            root,
            np.where(leaf, LEAF, np.concatenate([tree.feature for tree in trees])).astype(np.int32),
            np.where(leaf, 0.0, np.concatenate([tree.threshold for tree in trees])),
            np.where(leaf, 0, left).astype(np.int32),
            np.where(leaf, 0, right).astype(np.int32),
            share,
        )

    def probabilities(self, x: Float[np.ndarray, "row feature"]) -> Float[np.ndarray, "row klass"]:
        """Probability of each class, as scikit-learn computes it: features are compared in single precision."""
        x = x.astype(np.float32)
        node = np.repeat(self.root[None], len(x), axis=0)
        rows = np.arange(len(x))[:, None]
        while ((feature := self.feature[node]) != LEAF).any():
            goes_left = x[rows, feature] <= self.threshold[node]
            node = np.where(feature == LEAF, node, np.where(goes_left, self.left[node], self.right[node]))
        total = np.zeros((len(x), self.share.shape[1]))
        for tree in node.T:
            total += self.share[tree]
        return total / len(self.root)

    def arrays(self, prefix: str = "") -> dict[str, NDArray[Any]]:
        """The arrays by name, for :meth:`from_arrays`."""
        return {prefix + name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], features: int, classes: int, prefix: str = "") -> Forest:
        """Trees from a file.

        Args:
            arrays: of :meth:`arrays`.
            features: that a row has.
            classes: to tell apart.
            prefix: of the names.

        Raises:
            InputError: the arrays do not fit each other, or trees would not end.
        """
        root, feature, threshold, left, right, share = (
            np.asarray(arrays[prefix + name]) for name in cls.__dataclass_fields__
        )
        count, inner, number = feature.size, feature != LEAF, np.arange(feature.size)
        if (
            any(part.ndim != 1 or part.dtype.kind != "i" for part in (root, feature, left, right))
            or any(part.shape != (count,) for part in (left, right, threshold))
            or not threshold.dtype.kind == share.dtype.kind == "f"
            or share.shape != (count, classes)
            or not len(root)
            or not all(((part >= 0) & (part < count)).all() for part in (root, left, right))
            or not ((feature[inner] >= 0) & (feature[inner] < features)).all()
            or not ((left > number) & (right > number))[inner].all()
            or not ((share >= 0) & (share <= 1)).all()
        ):
            raise InputError("its trees do not fit each other")
        return cls(root, feature, threshold, left, right, share)
