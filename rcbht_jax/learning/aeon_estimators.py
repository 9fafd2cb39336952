"""Estimators for aeon's collections of time series ``[n, axis, time]``; needs the extra ``aeon``.

Thin adapters of :mod:`rcbht_jax.learning.estimators`, with the same parameters but for the layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.learning.estimators import Description, StateClassifier, WrenchFeatures

with needs_extra("aeon"):
    from aeon.classification import BaseClassifier
    from aeon.transformations.collection import BaseCollectionTransformer
    from sklearn.base import clone

_TAGS = {
    "X_inner_type": ["np-list", "numpy3D"],
    "capability:multivariate": True,
    "capability:unequal_length": True,
}


@dataclass(kw_only=True, eq=False, repr=False)
class AeonWrenchFeatures(Description, BaseCollectionTransformer):  # type: ignore[misc]
    """:class:`WrenchFeatures` as an aeon transformer: collection -> table ``[n, feature]``."""

    _tags = {**_TAGS, "output_data_type": "Tabular"}  # noqa: RUF012  # aeon wants a plain class attribute

    def __post_init__(self) -> None:
        BaseCollectionTransformer.__init__(self)

    def _fit(self, X: Any, y: Any = None) -> AeonWrenchFeatures:
        self.features_ = WrenchFeatures(**self.get_params(deep=False), layout="axis-time").fit(X)
        return self

    def _transform(self, X: Any, y: Any = None) -> NDArray[np.float32]:
        return np.asarray(self.features_.transform(X))


@dataclass(kw_only=True, eq=False, repr=False)
class AeonStateClassifier(Description, BaseClassifier):  # type: ignore[misc]
    """:class:`StateClassifier` as an aeon classifier.

    ``classifier`` takes feature matrices; None = ``SvmClassifier()``, whose ``predict_proba`` is 1 for the
    predicted class, as aeon has it for classifiers without probabilities.
    """

    _tags = {**_TAGS, "algorithm_type": "feature"}  # noqa: RUF012  # aeon wants a plain class attribute

    classifier: Any = None

    def __post_init__(self) -> None:
        BaseClassifier.__init__(self)

    def _fit(self, X: Any, y: Any) -> AeonStateClassifier:
        self.chain_ = clone(StateClassifier(**self.get_params(deep=False), layout="axis-time")).fit(X, y)
        return self

    def _predict(self, X: Any) -> NDArray[Any]:
        return self.chain_.predict(X)

    def _predict_proba(self, X: Any) -> NDArray[np.float64]:
        if hasattr(self.chain_, "predict_proba"):
            return self.chain_.predict_proba(X)
        return (self.chain_.predict(X)[:, None] == self.classes_).astype(np.float64)
