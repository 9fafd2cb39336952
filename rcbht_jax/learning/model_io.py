"""Model files: one compressed archive of plain arrays and one JSON text. Loading runs no code.

Next to the SVM the file holds what is needed to use it on a new stream: the feature specification, the
names of the features, the encoder's configuration and thresholds, and where it came from.
"""

from __future__ import annotations

import json
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.atomic import DISK_FULL, atomic_write
from rcbht_jax._util.untrusted import checked_fields, checked_number, checked_texts, parse_json, read_arrays
from rcbht_jax._util.url_path import as_path
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.scaling import KNOTS
from rcbht_jax.learning.svm import SvmModel, SvmSpec

FORMAT = "rcbht-model-1"
MAKERS = {
    FORMAT: "rcbht train",
    "rcbht-introspection-1": "rcbht train-online",
    "rcbht-monitor-1": "rcbht monitor fit",
    "rcbht-segmenter-1": "rcbht segment --write-model",
}
CHAIN = "chain.json"  # in archives of "rcbht export-model"

_ARRAYS = ("center", "width", "knots", "support", "support_count", "dual", "intercept")
_PLAIN, _SIGNAL = ("task", "encoder", "data_hash", "version", "extra"), ("axes", "units")
NO_DIGESTS = np.zeros((0, 32), np.uint8)  # older files


@dataclass(frozen=True)
class TrainedModel:
    """A classifier, with everything that is needed to compute its features on a stream."""

    svm: SvmModel
    feature_spec: FeatureSpec
    feature_names: tuple[str, ...]  # [feature]
    task: dict[str, Any]  # what was learnt: JSON values
    encoder: dict[str, Any]  # how the labels were made, thresholds included: JSON values
    data_hash: str  # of the training data
    version: str = rcbht_jax.__version__
    extra: dict[str, Any] = field(default_factory=dict)  # anything else worth keeping: JSON values
    digests: NDArray[np.uint8] = field(default_factory=lambda: NO_DIGESTS)  # [recording, byte] of the training set
    axes: tuple[str, ...] = ()  # names of those of the training set; none in older files
    units: tuple[str, ...] = ()  # of the axes, "" = not stated


def save(path: Path | str, model: TrainedModel) -> None:
    """Write ``model`` to ``path`` (a single file, any suffix).

    Raises:
        InputError: the folder does not exist, or a description is not JSON.
    """
    arrays, described = svm_members(model.svm)
    meta = {"format": FORMAT, **described, "feature_spec": asdict(model.feature_spec)}
    rest = {k: getattr(model, k) for k in ("feature_names", *_PLAIN, *_SIGNAL)}
    write_archive(path, meta | rest, {**arrays, "digests": model.digests})


def load(path: Path | str) -> TrainedModel:
    """Read a file written by ``save``; one of an older version that does not state its axes gives a warning.

    Raises:
        InputError: the file is missing, damaged, or not a model of this format.
    """
    path = as_path(path)
    with reading(path, FORMAT) as (meta, archive):
        names = checked_texts("its features", meta["feature_names"])
        check_objects(meta, "task", "encoder", "extra")
        checked_texts("its digest and version", [meta["data_hash"], meta["version"]])
        svm = read_svm(meta, archive, len(names))
        rest = {k: meta[k] for k in _PLAIN}
        axes, units = (checked_texts(f"its {name}", meta.get(name, [])) for name in _SIGNAL)
        if len(axes) != len(units):
            raise InputError(f"it has {len(axes)} axes and {len(units)} units")
        spec, digests = FeatureSpec.from_dict(meta["feature_spec"]), read_digests(archive)
        model = TrainedModel(svm, spec, names, **rest, digests=digests, axes=axes, units=units)
        several = "+" in svm.spec.features  # label tracks, each with how it was made
        check_objects(model.encoder, *(model.encoder if several else ()))
        for made in model.encoder.values() if several else [model.encoder]:
            check_objects({"config": {}, "thresholds_from": {}} | made, "config", "thresholds_from")
    if not axes:
        warnings.warn(
            f"{path}, of an older version, does not state its axes; those of a store are not checked.", stacklevel=2
        )
    return model


def read_digests(archive: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Digests of a model's training recordings ``[recording, byte]``; none in an older file.

    Raises:
        InputError: not 32 bytes for each recording.
    """
    digests = archive.get("digests", NO_DIGESTS)
    if digests.ndim != 2 or digests.shape[1] != 32 or digests.dtype != np.uint8:
        raise InputError(f"its digests have the shape {digests.shape}; expected 32 bytes for each recording")
    return digests


def check_objects(meta: Mapping[str, Any], *names: str) -> None:
    """Refuse values of a model's JSON text that are no objects.

    Raises:
        InputError: names the first.
    """
    for name in names:
        if not isinstance(meta[name], dict):
            raise InputError(f"{name} is {str(meta[name])[:40]!r}; expected an object")


def svm_members(svm: SvmModel, prefix: str = "") -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """An SVM as arrays (their names begin with ``prefix``) and JSON values."""
    arrays = {prefix + name: getattr(svm, name) for name in _ARRAYS}
    return arrays, {"spec": asdict(svm.spec), "gamma": svm.gamma, "classes": svm.classes}


def read_svm(meta: Mapping[str, Any], archive: Mapping[str, NDArray[Any]], features: int, prefix: str = "") -> SvmModel:
    """Undo :func:`svm_members`.

    Raises:
        InputError: the arrays do not fit each other or the number of features.
    """
    arrays = {name: archive[prefix + name] for name in _ARRAYS if prefix + name in archive}
    arrays.setdefault("knots", np.zeros((0, features)))  # files written before there were ranks
    svm = SvmModel(
        spec=SvmSpec(**checked_fields(SvmSpec, meta["spec"])),
        gamma=checked_number("gamma", meta["gamma"]),
        classes=checked_texts("its classes", meta["classes"], different=True),
        **arrays,
    )
    _check(svm, features)
    return svm


def write_archive(path: Path | str, meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a JSON text and arrays as one compressed archive, whole or not at all.

    Raises:
        InputError: the folder does not exist, or ``meta`` is not JSON.
        OSError: the disk is full.
    """
    path = as_path(path)
    try:
        text = json.dumps(meta, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"the model cannot be written to {path}: {error}.") from error
    try:
        with atomic_write(path) as draft, draft.open("wb") as out:
            np.savez_compressed(out, allow_pickle=False, meta=np.array(text), **arrays)
    except OSError as error:
        if error.errno in DISK_FULL:
            raise
        raise InputError(f"the model cannot be written to {path}: {error.strerror or error}.") from error


@contextmanager
def reading(
    path: Path, kind: str, gaps: tuple[str, ...] = ()
) -> Iterator[tuple[dict[str, Any], Mapping[str, NDArray[Any]]]]:
    """Open an archive of format ``kind``: its JSON text and its arrays, finite but for those named in ``gaps``.

    Raises:
        InputError: missing, damaged, of another format, or whatever goes wrong with its content in the block.
    """
    try:
        archive = read_arrays(path)
        meta = parse_json(str(archive.pop("meta")))
        if meta["format"] != kind:  # first: a file of another kind is not damaged
            if {kind, meta["format"]} <= MAKERS.keys():
                raise _made_by(path, MAKERS[meta["format"]], kind)
            raise InputError(f"{path} has the format {meta['format']}; this version reads {kind} here.")
        for name, values in archive.items():
            check_finite(name, values[:0] if name in gaps else values)
        yield meta, archive
    except InputError as error:
        if str(error).startswith(f"{path} "):
            raise
        raise InputError(f"{path} is damaged: {str(error).rstrip('.')}.") from error
    except Exception as error:  # a damaged archive can fail in any way inside zipfile, NumPy and json
        if _is_chain(path):
            raise _made_by(path, "rcbht export-model", kind) from error
        detail = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise InputError(f"{path} is not a readable model file: {detail}.") from error


def _made_by(path: Path, maker: str, kind: str) -> InputError:
    return InputError(f'{path} was made by "{maker}"; this needs a file of "{MAKERS[kind]}".')


def _is_chain(path: Path) -> bool:
    with suppress(Exception), zipfile.ZipFile(path) as archive:
        return CHAIN in archive.namelist()
    return False


def _check(svm: SvmModel, features: int) -> None:
    """Raise an error for arrays that do not fit together or are not finite."""
    classes, vectors = len(svm.classes), int(svm.support_count.sum())
    expected = {
        "center": (features,),
        "width": (features,),
        "knots": (KNOTS if svm.spec.ranks else 0, features),
        "support": (vectors, features),
        "support_count": (classes,),
        "dual": (classes - 1, vectors),
        "intercept": (classes * (classes - 1) // 2,),
    }
    for name, shape in expected.items():
        if getattr(svm, name).shape != shape:
            raise InputError(f"{name} has the shape {getattr(svm, name).shape}, not {shape}")
    if svm.support_count.dtype.kind not in "iu" or (vectors and svm.support_count.min() < 0):
        raise InputError(f"support_count is {svm.support_count.dtype}; expected counts")
    if not 0 < svm.gamma < np.inf:
        raise InputError(f"gamma is {svm.gamma}; expected a positive number")


def check_finite(name: str, values: NDArray[Any]) -> None:
    """Refuse an array of a model that is no array of finite real numbers.

    Raises:
        InputError: names the array.
    """
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise InputError(f"{name} is not finite everywhere; expected numbers")
