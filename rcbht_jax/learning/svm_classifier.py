"""The project's support vector machine as a scikit-learn estimator of feature matrices.

Parameters are fields and are checked in ``fit``, as in :mod:`rcbht_jax.learning.estimators`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.selection import group_numbers
from rcbht_jax._util.signals import numbers_of
from rcbht_jax._util.values import positive
from rcbht_jax.errors import InputError
from rcbht_jax.learning.probability import FOLDS, ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec, fit, pairs

with needs_extra("learn"):
    from sklearn.base import BaseEstimator, ClassifierMixin
    from sklearn.exceptions import NotFittedError
    from sklearn.utils import check_consistent_length, column_or_1d
    from sklearn.utils.metaestimators import available_if
    from sklearn.utils.multiclass import check_classification_targets
    from sklearn.utils.validation import check_is_fitted, validate_data


@dataclass(kw_only=True, eq=False, repr=False)
class SvmClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """One-versus-one support vector machine, with probabilities by pairwise coupling.

    Args:
        kernel: ``"linear"``, ``"poly"`` (degree 3) or ``"rbf"``.
        cost: C, positive.
        scaling: standardise the features by mean and standard deviation of the training data.
        ranks: scale by ranks among the training data instead; needs ``scaling``.
        gamma: of the kernel: ``"auto"`` = 1 / features, ``"scale"`` = 1 / (features x variance).
        balanced: weigh classes by the inverse of their frequency.
        floor: smallest standard deviation to divide by when scaling.
        feature_weight: positive factors ``[feature]`` of the scaled features; None = ones.
        probability: also fit Platt sigmoids on held-out groups, which ``predict_proba`` needs.
        cv: number of folds for the sigmoids, or a scikit-learn splitter that tests every sample once.
        random_state: seed of these folds.

    Attributes:
        classes_: sorted classes.
        n_features_in_: number of features.
        model_: the fitted :class:`SvmModel`; plain arrays that need NumPy only.

    Example:
        >>> from sklearn.datasets import load_iris
        >>> x, y = load_iris(return_X_y=True)
        >>> machine = SvmClassifier(probability=True).fit(x, y, groups=np.arange(150) // 2)
        >>> machine.score(x, y) > 0.95
        True
        >>> machine.predict_proba(x[:2]).sum(axis=1).round(6).tolist()
        [1.0, 1.0]
    """

    kernel: Any = "rbf"
    cost: Any = 1.0
    scaling: Any = True
    ranks: Any = False
    gamma: Any = "auto"
    balanced: Any = False
    floor: Any = 0.0
    feature_weight: Any = None
    probability: Any = False
    cv: Any = FOLDS
    random_state: Any = 0

    def fit(
        self, X: Any, y: Any, groups: ArrayLike | None = None, sample_weight: ArrayLike | None = None
    ) -> SvmClassifier:
        """Train on ``[sample, feature]`` with one class per sample.

        Args:
            X: features, finite.
            y: classes.
            groups: trial of each sample; samples of one trial stay together when probabilities are fitted. None = each
                sample is a trial of its own.
            sample_weight: how often each sample counts, not negative; 0 leaves it out, None = once. It affects the
                cost, the scaling (except ranks) and the sigmoids, but not the default folds of these: with
                ranks or probabilities, whole numbers do not have the effect of repeated samples.

        Raises:
            InputError: fewer than two classes, bad parameters, feature weights that are not positive, sample weights
                that are negative, a wrong number of weights, or too few groups for probabilities.
        """
        X, y = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        check_classification_targets(y)
        groups = np.arange(len(y)) if groups is None else column_or_1d(groups)
        check_consistent_length(X, groups)
        group_numbers(groups)  # which refuses those without an order
        counted = None if sample_weight is None else _checked(sample_weight, len(y))
        if counted is not None:
            kept = counted > 0
            X, y, groups, counted = X[kept], y[kept], groups[kept], counted[kept]
        classes, code = np.unique(y, return_inverse=True)
        spec = SvmSpec(
            self.kernel, self.cost, self.scaling, self.gamma, self.balanced, floor=self.floor, ranks=self.ranks
        )
        names = [str(name) for name in classes]
        given = self.feature_weight
        weight = None if given is None else numbers_of(given, "feature_weight").astype(np.float64)
        if weight is not None and not (weight.shape == (X.shape[1],) and positive(weight)):
            raise InputError(f"feature_weight has the shape {weight.shape}; expected {X.shape[1]} positive numbers.")
        sigmoid = None
        if self.probability:
            machine = fit_probabilistic(X, code, groups, names, spec, self.random_state, self.cv, weight, counted)
            model, sigmoid = machine.svm, machine.sigmoid
        else:
            model = fit(X, code, names, spec, weight, counted)
        self.model_, self.sigmoid_, self.classes_ = model, sigmoid, classes  # a fit that fails changes nothing
        return self

    def predict(self, X: Any) -> NDArray[Any]:
        """Class of each sample, by majority of the pairwise votes; ties go to the earlier class."""
        x = self._features(X)
        return self.classes_[self.model_.predict_index(x)]

    def decision_function(self, X: Any) -> Float[np.ndarray, " sample"] | Float[np.ndarray, "sample class"]:
        """Two classes: positive for the second. More: votes plus a fraction of the decision values, as in ``SVC``."""
        x = self._features(X)
        decision = self.model_.decision(x)
        if len(self.classes_) == 2:
            return -decision[:, 0]
        first, second = (np.eye(len(self.classes_))[side] for side in pairs(len(self.classes_)))
        votes = np.where(decision > 0, 1.0, 0.0) @ first + np.where(decision > 0, 0.0, 1.0) @ second
        confidence = decision @ (first - second)
        return votes + confidence / (3 * (np.abs(confidence) + 1))

    @available_if(lambda self: self.probability)  # type: ignore[untyped-decorator]
    def predict_proba(self, X: Any) -> Float[np.ndarray, "sample class"]:
        """Class probabilities; only with ``probability=True``, also in :meth:`fit`."""
        x = self._features(X)
        if self.sigmoid_ is None:
            raise NotFittedError("This SvmClassifier was fitted without probability; set it and call fit again.")
        return ProbabilisticSvm(self.model_, self.sigmoid_).probability(x)

    def _features(self, X: Any) -> Float[np.ndarray, "sample feature"]:
        check_is_fitted(self, "classes_")
        return validate_data(self, X, dtype=np.float64, reset=False)


def _checked(sample_weight: ArrayLike, samples: int) -> NDArray[np.float64]:
    weight = numbers_of(sample_weight, "sample_weight").astype(np.float64)
    if weight.shape != (samples,) or not (np.isfinite(weight) & (weight >= 0)).all():
        raise InputError(
            f"sample_weight has the shape {weight.shape}, its least value is {weight.min(initial=0)}; "
            f"expected {samples} finite numbers, none of them negative."
        )
    if not weight.any():
        raise InputError("Every sample_weight is zero; give some samples a positive weight.")
    return weight
