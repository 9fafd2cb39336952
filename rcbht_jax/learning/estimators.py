"""scikit-learn estimators: label features of wrenches, support vector machines, and both in one.

``WrenchFeatures`` turns recordings into a feature matrix, ``StateClassifier`` chains it with ``SvmClassifier``. They
follow scikit-learn's conventions: ``clone``, ``Pipeline``, ``GridSearchCV`` over any parameter, ``set_output``, and
groups and weights of samples by ``fit(X, y, groups=..., sample_weight=...)`` or metadata routing.
Parameters are fields, from which ``dataclass`` makes the ``__init__`` that scikit-learn inspects. They are checked in
``fit``, as scikit-learn expects, and therefore annotated as ``Any``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from inspect import signature
from typing import Any

import numpy as np
from jaxtyping import Float, Float32
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.signals import check_learned, period
from rcbht_jax._util.values import usable
from rcbht_jax.encoding.arrays import read_signals
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import AnyConfig, config_of, limits_for
from rcbht_jax.encoding.thresholds import host_limits, preset, validate
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.features import Features, FeatureSpec, Intervals, interval_features
from rcbht_jax.learning.svm_classifier import SvmClassifier
from rcbht_jax.types import LabelTrack, LabelTracks, axis_names

with needs_extra("learn"):
    from sklearn import get_config
    from sklearn.base import BaseEstimator, ClassifierMixin, TransformerMixin, clone
    from sklearn.utils.metadata_routing import get_routing_for_object
    from sklearn.utils.metaestimators import available_if
    from sklearn.utils.validation import check_is_fitted

LAYOUTS = ("time-axis", "axis-time")


@dataclass(kw_only=True, eq=False, repr=False)
class Description:
    """Parameters of the features that estimators make of recordings; see :class:`WrenchFeatures`."""

    rate: Any = 200.0
    window: Any = 5
    thresholds: Any = "hiro"
    features: Any = None
    config: Any = None
    rule: Any = "paper"
    tolerance: Any = "auto"


@dataclass(kw_only=True, eq=False, repr=False)
class WrenchFeatures(Description, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Label features of whole recordings.

    Each recording is encoded into labels and described by one row of features. ``fit`` learns nothing from the values
    except the tolerance of the fit rule, if it is "auto".

    Args:
        rate: samples per second.
        window: samples per straight-line fit, at least 2.
        thresholds: gradient thresholds: a robot's name, :class:`GradientThresholds`, limits ``[axis, 4]``, or
            limits ``[4]`` of every axis, N/s or Nm/s. A robot's name gives limits of forces or moments by the names
            of the axes, as :func:`rcbht_jax.preset` does; six axes without names are Fx to Mz. For the fit rule also
            :class:`FitLimits`, whose tolerance is used for "auto". Recordings are in N and Nm: units in names of
            columns or in attributes of pandas and xarray convert nothing.
        features: which features; None = ``FeatureSpec()``.
        config: other options of the encoder, whose ``window`` and ``dt`` are replaced: EncoderConfig, or FitConfig for
            the fit rule; None = its defaults.
        rule: ``"paper"``; or ``"fit"``, where a word is a run of windows that one straight line explains
            (docs/fit_rule.md).
        tolerance: for the fit rule, N and Nm: a number, or one for each axis; ``"auto"`` = from the recordings of
            ``fit``.
        layout: ``"time-axis"`` for arrays ``[n, time, axis]`` or lists of ``[time, axis]``; ``"axis-time"`` for aeon's
            ``[n, axis, time]`` or lists of ``[axis, time]``. Recordings in a list may differ in length. In pandas, and
            in xarray with a dimension "time" or "axis", names give the layout; see :func:`rcbht_jax.encode` for time.

    Attributes:
        n_features_in_: axes of a recording.
        feature_names_in_: names of the axes ``[axis]``, only where pandas or xarray gave them to ``fit``.
        thresholds_: limits ``[axis, 4]`` that are used.
        tolerance_: tolerances ``[axis]`` that are used; None by the paper's rule.
        feature_weight_: weights of the columns where ``features.balance`` is set, else None; StateClassifier uses them.

    Example:
        >>> import numpy as np
        >>> push = np.zeros((400, 6))  # 2 s at 200 Hz
        >>> push[:, 2] = np.clip(np.arange(400) / 200 - 1, 0, 0.5) * 20  # Fz, N
        >>> encoder = WrenchFeatures(features=FeatureSpec(("histogram",), layers=("llb",)))
        >>> table = encoder.set_output(transform="pandas").fit_transform([push, push[:300]])
        >>> table["histogram.llb.Fz.time.PS"].astype(float).round(2).tolist()
        [0.25, 0.33]
    """

    layout: Any = "time-axis"

    def fit(self, X: Any, y: Any = None) -> WrenchFeatures:
        """Learn the number of axes and, for the fit rule, the tolerance; check the parameters.

        Raises:
            InputError: wrong shapes, values that are not finite, an unknown layout, robot or rule, features that are
                not a FeatureSpec, thresholds or tolerances that do not fit the axes, or a tolerance or configuration of
                the other rule.
        """
        wrench, length, names = self._read(X)
        if not usable(wrench):
            raise InputError("Recordings hold values that are not finite numbers; remove or interpolate them.")
        axes = wrench.shape[2]
        fitted = isinstance(self.thresholds, FitLimits)
        gradients = _limits(self.thresholds.gradients if fitted else self.thresholds, names or axis_names(axes))
        limits = FitLimits(gradients, self.thresholds.tolerance) if fitted else gradients
        encoding = limits_for(self._encoder_config(), limits, self.tolerance, wrench, length)
        described = _describe(_no_labels(axes), np.array([1]), 1.0, self.features, names or ())
        self.thresholds_, self._encoding, self.n_features_in_ = gradients, encoding, axes
        self.tolerance_ = np.asarray(encoding.tolerance) if isinstance(encoding, FitLimits) else None
        keep_names(self, names)
        self._names = np.array(described.names, object)
        self.feature_weight_ = described.weights(self.features or FeatureSpec())
        return self

    def transform(self, X: Any) -> Float32[np.ndarray, "recording feature"]:
        """One row of features per recording.

        Raises:
            InputError: wrong shapes, another number of axes than in ``fit``, other names of axes or another order, or
                values that are not finite.
        """
        check_is_fitted(self)
        wrench, length, names = self._read(X)
        if wrench.shape[2] != self.n_features_in_:
            raise InputError(f"recordings have {wrench.shape[2]} axes; fit had {self.n_features_in_}.")
        check_learned(names, self, "recordings")
        config = self._encoder_config()
        tracks = encode_batch(config, self._encoding, wrench, length)
        return _describe(tracks, length, config.dt, self.features).values

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[Any]:
        """Names of the columns, ``family.layer.axis.what``."""
        check_is_fitted(self)
        return self._names

    def _read(self, X: Any) -> tuple[NDArray[np.float32], NDArray[np.int32], tuple[str, ...] | None]:
        if self.layout not in LAYOUTS:
            raise InputError(f"layout is {self.layout!r}; expected one of {', '.join(LAYOUTS)}.")
        return read_signals(X, self._encoder_config().dt, axis_first=self.layout == "axis-time")

    def _encoder_config(self) -> AnyConfig:
        dt = period(self.rate)
        plain = config_of(self.rule, self.window, dt)
        if self.config is None:
            return plain
        if type(self.config) is not type(plain):
            raise InputError(
                f"The rule is {self.rule!r} and takes {type(plain).__name__}; config is a {type(self.config).__name__}."
            )
        return replace(self.config, window=self.window, dt=dt)

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "thresholds_")

    def __sklearn_tags__(self) -> Any:
        return _of_recordings(super().__sklearn_tags__())


def _of_recordings(tags: Any) -> Any:
    """Tags of scikit-learn, for three dimensions in place of two."""
    tags.input_tags.two_d_array, tags.input_tags.three_d_array = False, True
    return tags


def keep_names(estimator: Any, names: tuple[str, ...] | None) -> None:
    """Names of axes as scikit-learn has names of features: an attribute where there are some."""
    vars(estimator).pop("feature_names_in_", None)
    if names:
        estimator.feature_names_in_ = np.array(names, object)


def _limits(thresholds: Any, names: tuple[str, ...]) -> Float[np.ndarray, "axis 4"]:
    axes = len(names)
    if isinstance(thresholds, str):
        thresholds = preset(thresholds, names)
    limits = np.array(host_limits(thresholds), np.float64)  # a copy, which no caller can change
    limits = np.tile(limits, (axes, 1)) if limits.ndim == 1 else limits
    validate(limits)
    if limits.shape != (axes, 4):
        raise InputError(f"Thresholds have shape {limits.shape}; expected [{axes}, 4] for recordings of {axes} axes.")
    return limits


def _describe(tracks: LabelTracks, length: NDArray[Any], dt: float, spec: Any, names: tuple[str, ...] = ()) -> Features:
    if not isinstance(spec, FeatureSpec | None):
        raise InputError(f'features is {spec!r}; expected a FeatureSpec, such as FeatureSpec(("histogram",)).')
    rows = np.arange(len(length))
    return interval_features(tracks, Intervals(rows, np.zeros_like(rows), length, dt), spec or FeatureSpec(), names)


def _no_labels(axes: int) -> LabelTracks:
    """One recording without labels: names and families of features do not depend on labels."""
    code, value = np.zeros((1, axes, 1), np.int32), np.zeros((1, axes, 1))
    track = LabelTrack(code, code, code, code, value, value, value, value)
    return LabelTracks(track, track, track)


def _passes_on(classifier: Any) -> bool:
    """Whether fit takes any parameters, for the estimators that a classifier is made of."""
    return any(one.kind is one.VAR_KEYWORD for one in signature(classifier.fit).parameters.values())


def _takes(classifier: Any, name: str) -> bool:
    """Whether fit takes groups, or sample_weight, for itself or for the estimators that a classifier is made of."""
    if (named := name in signature(classifier.fit).parameters) or not _passes_on(classifier):
        return named
    if get_config()["enable_metadata_routing"]:
        return name in get_routing_for_object(classifier).consumes("fit", [name])
    parameters = classifier.get_params(deep=False)
    if "error_score" in parameters:  # a search
        return name == "groups" or _takes(parameters["estimator"], name)
    return name == "sample_weight" and "estimators" in parameters  # voting and stacking


def _has(chain: StateClassifier, method: str) -> bool:
    given = SvmClassifier() if chain.classifier is None else chain.classifier  # an unfitted ensemble has no truth value
    return hasattr(getattr(chain, "classifier_", given), method)


@dataclass(kw_only=True, eq=False, repr=False)
class StateClassifier(Description, ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """Classifier of recordings: wrench -> labels -> features -> support vector machine.

    Args:
        rate, window, thresholds, features, config, rule, tolerance, layout: as of :class:`WrenchFeatures`.
        classifier: of feature matrices; None = ``SvmClassifier()``.

    Attributes:
        classes_: sorted classes.
        n_features_in_: axes of a recording.
        feature_names_in_: names of the axes, where ``fit`` had some.
        features_: the fitted :class:`WrenchFeatures`.
        classifier_: the fitted classifier.

    Example:
        Choose the window by cross-validation that keeps trials together:

        >>> import numpy as np
        >>> from sklearn.model_selection import GridSearchCV, GroupKFold
        >>> rng = np.random.default_rng(0)
        >>> noise = rng.normal(size=(12, 300, 6)) * 0.02
        >>> push = np.clip(np.arange(300) / 200 - 0.5, 0, 0.5)[:, None] * 20  # N and Nm
        >>> y = np.repeat(["push", "rest"], 6)
        >>> wrench = noise + np.where(y == "push", 1, 0)[:, None, None] * push
        >>> search = GridSearchCV(StateClassifier(), {"window": [5, 10]}, cv=GroupKFold(3))
        >>> search = search.fit(wrench, y, groups=np.arange(12) // 2)
        >>> float(search.best_score_), search.predict(wrench[[0, -1]]).tolist()
        (1.0, ['push', 'rest'])
    """

    layout: Any = "time-axis"
    classifier: Any = None

    def fit(
        self, X: Any, y: Any, groups: ArrayLike | None = None, sample_weight: ArrayLike | None = None
    ) -> StateClassifier:
        """Train on recordings with one class each; see :class:`WrenchFeatures` for their shapes.

        Args:
            X: recordings.
            y: classes.
            groups: trial of each recording, for a classifier whose own ``fit`` takes groups, a search, or one that
                requests them by metadata routing; others, such as a Pipeline without routing, are fitted without.
            sample_weight: weight of each recording for the classifier; a tolerance "auto" ignores it.

        Raises:
            InputError: as both parts raise, weights for a classifier that takes none, such as a Pipeline without
                metadata routing, or features with balance for one that cannot weigh features.
        """
        described = {field.name: getattr(self, field.name) for field in fields(WrenchFeatures)}
        features = WrenchFeatures(**described).fit(X)
        classifier = SvmClassifier() if self.classifier is None else clone(self.classifier)
        kind = type(classifier).__name__
        if features.feature_weight_ is not None:
            if "feature_weight" not in classifier.get_params(deep=False):
                raise InputError(f"{kind} takes no weights of features; choose features without balance.")
            classifier.set_params(feature_weight=features.feature_weight_)
        given = {"groups": groups, "sample_weight": sample_weight}
        given = {name: one for name, one in given.items() if one is not None and _takes(classifier, name)}
        if sample_weight is not None and "sample_weight" not in given:
            hint = ", or enable metadata routing and call set_fit_request(sample_weight=True) of its steps"
            raise InputError(f"{kind} takes no sample_weight; fit without it{hint if _passes_on(classifier) else ''}.")
        classifier.fit(features.transform(X), y, **given)
        self.features_, self.classifier_, self.classes_ = features, classifier, classifier.classes_
        self.n_features_in_ = features.n_features_in_
        keep_names(self, tuple(getattr(features, "feature_names_in_", ())))
        return self

    def predict(self, X: Any) -> NDArray[Any]:
        """Class of each recording."""
        check_is_fitted(self)
        return self.classifier_.predict(self.features_.transform(X))

    @available_if(lambda self: _has(self, "decision_function"))  # type: ignore[untyped-decorator]
    def decision_function(self, X: Any) -> NDArray[Any]:
        """Decision values of the classifier."""
        check_is_fitted(self)
        return self.classifier_.decision_function(self.features_.transform(X))

    @available_if(lambda self: _has(self, "predict_proba"))  # type: ignore[untyped-decorator]
    def predict_proba(self, X: Any) -> NDArray[Any]:
        """Class probabilities, if the classifier has them: for example ``SvmClassifier(probability=True)``."""
        check_is_fitted(self)
        return self.classifier_.predict_proba(self.features_.transform(X))

    def __sklearn_tags__(self) -> Any:
        return _of_recordings(super().__sklearn_tags__())
