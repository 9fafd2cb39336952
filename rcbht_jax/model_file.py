"""Model files: one compressed archive of plain arrays and one JSON text. Loading runs no code.

Next to the SVM the file holds what is needed to use it on a new stream: the feature specification, the
names of the features, the encoder's configuration and thresholds, and where it came from.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax.classify import SvmModel, SvmSpec
from rcbht_jax.errors import InputError
from rcbht_jax.grammar import FeatureSpec

FORMAT = "rcbht-model-1"

_ARRAYS = ("center", "width", "support", "support_count", "dual", "intercept")


@dataclass(frozen=True)
class TrainedModel:
    """A classifier with everything a stream needs to be described the way the training data was."""

    svm: SvmModel
    feature_spec: FeatureSpec
    feature_names: tuple[str, ...]  # [feature]
    task: dict[str, Any]  # what was learnt: JSON values
    encoder: dict[str, Any]  # how the labels were made, thresholds included: JSON values
    data_hash: str  # of the training data
    version: str = rcbht_jax.__version__
    extra: dict[str, Any] = field(default_factory=dict)  # anything else worth keeping: JSON values


def save(path: Path, model: TrainedModel) -> None:
    """Write ``model`` to ``path`` (a single file, any suffix).

    Raises:
        InputError: the folder does not exist, or a description is not JSON.
    """
    meta = {
        "format": FORMAT,
        "spec": asdict(model.svm.spec),
        "gamma": model.svm.gamma,
        "classes": model.svm.classes,
        "feature_spec": asdict(model.feature_spec),
        **{k: getattr(model, k) for k in ("feature_names", "task", "encoder", "data_hash", "version", "extra")},
    }
    try:
        text = json.dumps(meta, allow_nan=False)
        with path.open("wb") as out:
            arrays = {name: getattr(model.svm, name) for name in _ARRAYS}
            np.savez_compressed(out, allow_pickle=False, meta=np.array(text), **arrays)
    except (OSError, TypeError, ValueError) as error:
        raise InputError(f"the model cannot be written to {path}: {error}.") from error


def load(path: Path) -> TrainedModel:
    """Read a file written by ``save``.

    Raises:
        InputError: the file is missing, damaged, or not a model of this format.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            meta = json.loads(str(archive["meta"]))
            if meta["format"] != FORMAT:
                raise InputError(f"{path} has the format {meta['format']}; this version reads {FORMAT}.")
            arrays = {name: archive[name] for name in _ARRAYS}
        svm = SvmModel(
            spec=SvmSpec(**meta["spec"]), gamma=float(meta["gamma"]), classes=tuple(meta["classes"]), **arrays
        )
        rest = {k: meta[k] for k in ("task", "encoder", "data_hash", "version", "extra")}
        names = tuple(meta["feature_names"])
        _check(svm, names, path)
        return TrainedModel(svm, FeatureSpec.from_dict(meta["feature_spec"]), names, **rest)
    except InputError:
        raise
    except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path} is not a readable model file: {error}.") from error


def _check(svm: SvmModel, names: tuple[str, ...], path: Path) -> None:
    """Refuse arrays that do not fit together, which would otherwise broadcast into nonsense."""
    classes, features, vectors = len(svm.classes), len(names), int(svm.support_count.sum())
    expected = {
        "center": (features,),
        "width": (features,),
        "support": (vectors, features),
        "support_count": (classes,),
        "dual": (classes - 1, vectors),
        "intercept": (classes * (classes - 1) // 2,),
    }
    for name, shape in expected.items():
        if getattr(svm, name).shape != shape:
            raise InputError(f"{path} is damaged: {name} has the shape {getattr(svm, name).shape}, not {shape}.")
