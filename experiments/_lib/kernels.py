"""Kernels of several encoders on the same items: averaged, or weighted by how well each agrees with the classes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped

from rcbht_jax.learning.scaling import fit_scale
from rcbht_jax.learning.svm import grouped_folds, solved


def rank_kernel(
    x: Float[np.ndarray, "item feature"],
    train: Int[np.ndarray, " train"],
    weight: Float[np.ndarray, " feature"] | None = None,
) -> Float[np.ndarray, "item item"]:
    """Linear kernel of the weighted ranks of features among the training items, its diagonal about 1; float32.

    Features that are constant in training are left out.
    """
    varies = np.ptp(x[train], axis=0) > 0
    weight = None if weight is None else weight[varies]
    z = fit_scale(x[train][:, varies], True, ranked=True, weight=weight)(x[:, varies])
    return (z @ z.T / z.shape[1]).astype(np.float32)


def alignment_weights(
    kernels: Float[np.ndarray, "kernel item item"], y: Int[np.ndarray, " item"]
) -> Float[np.ndarray, " kernel"]:
    """Weights with sum 1 by centred alignment with the classes (Cortes, Mohri and Rostamizadeh 2012, section 3.1).

    Kernels are those of the training items, ``y`` their class indices. The weighted sum is
    ``np.tensordot(weights, kernels, 1)``.

    >>> y = np.array([0, 0, 1, 1])
    >>> same = (y[:, None] == y).astype(float)
    >>> alignment_weights(np.stack([same, np.eye(4)]), y).round(2)
    array([0.63, 0.37])
    """
    middle = np.eye(len(y)) - 1 / len(y)
    ideal = middle @ (y[:, None] == y).astype(np.float64) @ middle
    centred = [middle @ kernel @ middle for kernel in kernels]
    value = np.array([max(0.0, (kernel * ideal).sum() / np.linalg.norm(kernel)) for kernel in centred])
    return value / value.sum()


def predict_kernel(
    kernel: Float[np.ndarray, "item item"],
    y: Int[np.ndarray, " item"],
    train: Int[np.ndarray, " train"],
    test: Int[np.ndarray, " test"],
    cost: float,
) -> Int[np.ndarray, " test"]:
    """Class index of the test items, by an SVM with this kernel."""
    model = solved(kernel[np.ix_(train, train)], y[train], "precomputed", cost)
    return model.predict(kernel[np.ix_(test, train)]).astype(np.int64)


def cost_scores(
    kernel: Float[np.ndarray, "item item"],
    y: Int[np.ndarray, " item"],
    groups: Shaped[np.ndarray, " item"],
    costs: Sequence[float],
    folds: int,
    repeats: int,
    seed: int,
) -> tuple[Float[np.ndarray, "cost fold"], Float[np.ndarray, "cost fold"]]:
    """Accuracy and mean margin of grouped folds of three classes or more; the margin of an item is clipped at 1.

    Raises:
        InputError: a class has fewer groups than there are folds.
    """
    splits = [split for repeat in range(repeats) for split in grouped_folds(y, groups, folds, seed + repeat)]
    accuracy, margin = np.zeros((2, len(costs), len(splits)))
    for column, (a, b) in enumerate(splits):
        for row, cost in enumerate(costs):
            model = solved(kernel[np.ix_(a, a)], y[a], "precomputed", cost)
            decision = model.decision_function(kernel[np.ix_(b, a)])
            own = np.arange(decision.shape[1]) == y[b, None]
            accuracy[row, column] = (decision.argmax(1) == y[b]).mean()
            margin[row, column] = np.minimum(decision[own] - np.where(own, -np.inf, decision).max(1), 1).mean()
    return accuracy, margin
