"""Estimators for aeon's collections of time series ``[n, axis, time]``; needs the extra ``aeon``.

Thin adapters of :mod:`rcbht_jax.learning.estimators`, with the same parameters but for the layout.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.learning.estimators import StateClassifier, WrenchFeatures

with needs_extra("aeon"):
    from aeon.classification import BaseClassifier
    from aeon.transformations.collection import BaseCollectionTransformer
    from sklearn.base import clone

_TAGS = {
    "X_inner_type": ["np-list", "numpy3D"],
    "capability:multivariate": True,
    "capability:unequal_length": True,
}


class AeonWrenchFeatures(BaseCollectionTransformer):  # type: ignore[misc]
    """:class:`WrenchFeatures` as an aeon transformer: collection -> table ``[n, feature]``."""

    _tags = {**_TAGS, "output_data_type": "Tabular"}  # noqa: RUF012  # aeon wants a plain class attribute

    @no_type_check  # so that the import hook of the tests leaves the signature as aeon reads it
    def __init__(
        self,
        *,
        rate: Any = 200.0,
        window: Any = 5,
        thresholds: Any = "hiro",
        features: Any = None,
        config: Any = None,
    ) -> None:
        self.rate = rate
        self.window = window
        self.thresholds = thresholds
        self.features = features
        self.config = config
        super().__init__()

    def _fit(self, X: Any, y: Any = None) -> AeonWrenchFeatures:
        self.features_ = WrenchFeatures(**self.get_params(deep=False), layout="axis-time").fit(X)
        return self

    def _transform(self, X: Any, y: Any = None) -> NDArray[np.float32]:
        return np.asarray(self.features_.transform(X))


class AeonStateClassifier(BaseClassifier):  # type: ignore[misc]
    """:class:`StateClassifier` as an aeon classifier.

    ``classifier`` is one of feature matrices; None = ``SvmClassifier()``, whose ``predict_proba`` is 1 for the
    predicted class, as aeon has it for classifiers without probabilities.
    """

    _tags = {**_TAGS, "algorithm_type": "feature"}  # noqa: RUF012  # aeon wants a plain class attribute

    @no_type_check  # so that the import hook of the tests leaves the signature as aeon reads it
    def __init__(
        self,
        *,
        rate: Any = 200.0,
        window: Any = 5,
        thresholds: Any = "hiro",
        features: Any = None,
        config: Any = None,
        classifier: Any = None,
    ) -> None:
        self.rate = rate
        self.window = window
        self.thresholds = thresholds
        self.features = features
        self.config = config
        self.classifier = classifier
        super().__init__()

    def _fit(self, X: Any, y: Any) -> AeonStateClassifier:
        parameters = self.get_params(deep=False)
        self.chain_ = clone(StateClassifier(**parameters, layout="axis-time")).fit(X, y)
        return self

    def _predict(self, X: Any) -> NDArray[Any]:
        return self.chain_.predict(X)

    def _predict_proba(self, X: Any) -> NDArray[np.float64]:
        if hasattr(self.chain_, "predict_proba"):
            return self.chain_.predict_proba(X)
        return (self.chain_.predict(X)[:, None] == self.classes_).astype(np.float64)
