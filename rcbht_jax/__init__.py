"""rcbht-jax: wrench signals into words, words into statements about what a robot is doing.

    >>> import numpy as np, rcbht_jax as rj
    >>> wrench = np.zeros((400, 6))  # Fx Fy Fz Mx My Mz at 200 Hz
    >>> wrench[:, 2] = np.clip(20 * (np.arange(400) / 200 - 1), 0, 10)  # a push along z
    >>> rj.encode(wrench, rate=200).words("Fz")
    ['FX', 'PS', 'FX']

Names of this package cover what most users need; each is imported when it is first used. The modules below it hold the
pure functions (:mod:`rcbht_jax.encoding.encoder`) and everything else.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

_FACE = {
    "encoding.arrays": ("encode",),
    "encoding.encoder": ("EncoderConfig",),
    "encoding.stream": ("Encoder",),
    "encoding.thresholds": ("GradientThresholds", "preset", "read_thresholds", "write_thresholds"),
    "errors": ("InputError",),
    "features": ("FeatureSpec",),
    "features.recipes": ("recipes",),  # the module itself
    "introspection.fault_monitor": ("FaultMonitor",),
    "introspection.introspector": ("Introspector",),
    "introspection.nominal": ("NominalMonitor",),
    "introspection.snaps": ("SnapDetector",),
    "io.label_store": ("read_tracks", "write_tracks"),
    "io.store": ("read_recordings", "write_recordings"),
    "learning.estimators": ("StateClassifier", "WrenchFeatures"),
    "learning.svm_classifier": ("SvmClassifier",),
    "learning.evaluation": ("evaluate",),
    "learning.fitting": ("train",),
    "learning.predict": ("classify",),
    "learning.tasks": ("TaskSpec", "extract_features", "labelled_intervals"),
    "types": ("LabelTracks", "Recordings"),
}
_HOME = {name: module for module, names in _FACE.items() for name in names}

__all__ = [  # written out for type checkers; a test holds it against the table above
    "Encoder", "EncoderConfig", "FaultMonitor", "FeatureSpec", "GradientThresholds", "InputError", "Introspector",
    "LabelTracks", "NominalMonitor", "Recordings", "SnapDetector", "StateClassifier", "SvmClassifier", "TaskSpec",
    "WrenchFeatures", "classify", "encode", "evaluate", "extract_features", "labelled_intervals", "preset",
    "read_recordings", "read_thresholds", "read_tracks", "recipes", "train", "write_recordings", "write_thresholds",
    "write_tracks",
]  # fmt: skip

if TYPE_CHECKING:
    from rcbht_jax.encoding.arrays import encode
    from rcbht_jax.encoding.encoder import EncoderConfig
    from rcbht_jax.encoding.stream import Encoder
    from rcbht_jax.encoding.thresholds import GradientThresholds, preset, read_thresholds, write_thresholds
    from rcbht_jax.errors import InputError
    from rcbht_jax.features import FeatureSpec, recipes
    from rcbht_jax.introspection.fault_monitor import FaultMonitor
    from rcbht_jax.introspection.introspector import Introspector
    from rcbht_jax.introspection.nominal import NominalMonitor
    from rcbht_jax.introspection.snaps import SnapDetector
    from rcbht_jax.io.label_store import read_tracks, write_tracks
    from rcbht_jax.io.store import read_recordings, write_recordings
    from rcbht_jax.learning.estimators import StateClassifier, WrenchFeatures
    from rcbht_jax.learning.evaluation import evaluate
    from rcbht_jax.learning.fitting import train
    from rcbht_jax.learning.predict import classify
    from rcbht_jax.learning.svm_classifier import SvmClassifier
    from rcbht_jax.learning.tasks import TaskSpec, extract_features, labelled_intervals
    from rcbht_jax.types import LabelTracks, Recordings


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_HOME[name]}")
    return module if _HOME[name].endswith(f".{name}") else getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
