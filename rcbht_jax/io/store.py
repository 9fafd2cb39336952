"""The store: a Zarr v3 group with one row per recording, readable by ``xarray.open_zarr``.

Layout of version 2 (dimensions in brackets): ``wrench [trial, time, axis]`` float32, zero beyond ``length [trial]``;
the coordinates ``trial`` (names), ``time`` (s) and ``axis`` (names; their units in the attribute ``axis_units``);
the string variables ``arm``, ``source``, ``session``, ``outcome``, ``note`` ``[trial]``; ``dt`` (scalar and attribute);
further columns ``[trial]`` in ``columns/``; the table of annotations in ``annotations/`` (``recording``, ``track``,
``label``, ``start``, ``end`` ``[interval]``); label tracks in ``labels/<name>/<layer>/``
(``rcbht_jax.io.label_store``); parameters and ground truth of a simulation in ``simulation/``, every array
``[trial, ...]``. The dimension "trial" counts recordings: one arm of one trial. Version 1 is read as well
(:mod:`rcbht_jax.io.store_v1`).

Every chunk carries a CRC-32C and the group a SHA-256 of its content, so that reading detects truncation and loss.
Stores are written atomically (:mod:`rcbht_jax._util.atomic`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import store_v1
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.types import Recordings

with needs_extra("store"):
    import zarr

FORMAT, FORMAT_VERSION = "rcbht-recordings", 2
SIMULATION, COLUMNS, ANNOTATIONS = "simulation", "columns", "annotations"

# Variable of the store -> (field of Recordings, dimensions, dtype, attributes).
VARIABLES: dict[str, tuple[str, tuple[str, ...], str, dict[str, str]]] = {
    "wrench": ("wrench", ("trial", "time", "axis"), "float32", {}),
    "length": ("length", ("trial",), "int32", {"units": "samples"}),
    "trial": ("trial", ("trial",), "string", {}),
    "arm": ("arm", ("trial",), "string", {}),
    "source": ("source", ("trial",), "string", {}),
    "session": ("session", ("trial",), "string", {}),
    "outcome": ("outcome", ("trial",), "string", {}),
    "note": ("note", ("trial",), "string", {}),
}
SHORTEST, LONGEST = 1e-9, 1e6  # s between samples: beyond these it is another unit
LARGEST = 1e30  # in any unit: sums over hours stay far from the largest single precision number
NAME = re.compile(r"[^\W\d][\w.-]*")  # of a column
INTERVALS = {"recording": "int32", "track": "string", "label": "string", "start": "float64", "end": "float64"}


def check_target(path: Path, overwrite: bool) -> None:
    """Check that a store can be written at ``path``, before the work is done.

    Raises:
        InputError: the parent folder does not exist, or ``path`` exists and ``overwrite`` is false or it is not a
            store; nothing else is ever replaced.
    """
    zarr_io.check_target(path, FORMAT, overwrite)


def write_recordings(
    path: Path,
    recordings: Recordings,
    attrs: Mapping[str, Any],
    overwrite: bool = False,
    *,
    created: str | None = None,
    simulation: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Write recordings as a store, atomically.

    >>> write_recordings(Path("trials.zarr"), recordings, {"importer": "my-robot"})  # doctest: +SKIP

    Args:
        path: folder to create, by convention ending in ``.zarr``.
        recordings: wrenches in N and Nm with their metadata.
        attrs: provenance (JSON values), stored with the version, the creation date and the content hash.
        overwrite: replace an existing store once the new one is complete.
        created: creation date to store; default now. With a fixed text, equal content gives equal bytes.
        simulation: arrays ``[recording, ...]`` for the group ``simulation/``; text as NumPy strings.

    Raises:
        InputError: the recordings contradict themselves, ``path`` exists, or ``attrs`` is not JSON.
    """
    check_target(path, overwrite)
    validate(recordings)
    arrays = {variable: getattr(recordings, spec[0]) for variable, spec in VARIABLES.items()}
    intervals = _intervals(recordings.annotations)
    header: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds") if created is None else created,
        "dt": recordings.dt,
        "axis_units": list(recordings.units),
        "annotation_labels": {track: list(names) for track, names in recordings.annotations.labels.items()},
        "content_sha256": _hash(recordings, arrays, intervals),
    }
    with atomic_folder(path) as draft:
        group = zarr_io.create_group(draft, {**attrs, **header})
        for variable, (_, dimensions, dtype, attributes) in VARIABLES.items():
            zarr_io.write_array(group, variable, arrays[variable], dimensions, dtype, attributes)
        zarr_io.write_array(group, "dt", np.float64(recordings.dt), (), "float64", {"units": "s"})
        zarr_io.write_array(group, "axis", np.array(recordings.axes), ("axis",), "string", {})
        time = np.arange(recordings.wrench.shape[1]) * recordings.dt
        zarr_io.write_array(group, "time", time, ("time",), "float64", {"units": "s"})
        sub = group.create_group(COLUMNS)
        for name, values in recordings.columns.items():
            zarr_io.write_array(sub, name, values, ("trial",), _dtype(values), {})
        sub = group.create_group(ANNOTATIONS)
        for name, dtype in INTERVALS.items():
            zarr_io.write_array(sub, name, intervals[name], ("interval",), dtype, {})
        if simulation is not None:
            _write_simulation(group, simulation, len(recordings))
        zarr_io.consolidate(draft)


def read_recordings(path: Path | str) -> Recordings:
    """Read and check a whole store.

    >>> recordings = read_recordings(Path("trials.zarr"))  # doctest: +SKIP
    >>> recordings.wrench.shape  # [recording, time, axis]  # doctest: +SKIP
    (21, 3354, 6)

    Raises:
        InputError: ``path`` does not exist, is not a store of this format, or is damaged (a chunk is missing,
            truncated or altered).
    """
    path = Path(path)
    group = open_store(path)
    with zarr_io.reading(path):
        read = store_v1.read if group.attrs["format_version"] == 1 else _read
        recordings, digest = read(group)
        expected = group.attrs["content_sha256"]
    if digest != expected:
        raise InputError(f"{path} is damaged: its content does not match its checksum. Import or copy it again.")
    try:
        validate(recordings)
    except InputError as error:
        raise InputError(f"{path} holds contradictory recordings: {error}") from error
    return recordings


def _read(group: zarr.Group) -> tuple[Recordings, str]:
    """Recordings and digest of a store of version 2."""
    arrays = {variable: zarr_io.read_array(group, variable, spec[2]) for variable, spec in VARIABLES.items()}
    sub = zarr_io.subgroup(group, COLUMNS)
    columns = {
        name: zarr_io.read_array(sub, name, None if array.dtype.kind in "biuf" else "string")
        for name, array in sorted(sub.arrays())
    }
    sub = zarr_io.subgroup(group, ANNOTATIONS)
    intervals = {name: zarr_io.read_array(sub, name, dtype) for name, dtype in INTERVALS.items()}
    try:
        marks = Annotations.from_table(intervals, dict(group.attrs["annotation_labels"]))  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(f"{group.store_path} is damaged: {error} Import or copy it again.") from error
    recordings = Recordings(
        dt=float(zarr_io.read_array(group, "dt", "float64")[()]),
        annotations=marks,
        columns=columns,
        axes=tuple(zarr_io.read_array(group, "axis", "string").tolist()),
        units=tuple(map(str, group.attrs["axis_units"])),  # type: ignore[arg-type]
        **{spec[0]: arrays[variable] for variable, spec in VARIABLES.items()},
    )
    return recordings, _hash(recordings, arrays, intervals)


def _hash(recordings: Recordings, arrays: Mapping[str, Any], intervals: Mapping[str, Any]) -> str:
    names = np.array([*recordings.axes, *recordings.units, *sorted(recordings.columns)], np.str_)
    order = [[track, *labels] for track, labels in recordings.annotations.labels.items()]
    texts = np.array([label for labels in order for label in [str(len(labels)), *labels]], np.str_)
    columns = [recordings.columns[name] for name in sorted(recordings.columns)]
    return content_hash([*arrays.values(), np.float64(recordings.dt), names, texts, *intervals.values(), *columns])


def _intervals(annotations: Annotations) -> dict[str, NDArray[Any]]:
    """The table of annotations as columns, with names in place of codes."""
    tracks = np.array(annotations.tracks, np.str_)
    track = tracks[annotations.track] if len(annotations) else np.zeros(0, np.str_)
    rest = {name: getattr(annotations, name) for name in ("recording", "start", "end")}
    return {name: ({"track": track, "label": annotations.names()} | rest)[name] for name in INTERVALS}


def _dtype(values: NDArray[Any]) -> str:
    return "string" if values.dtype.kind == "U" else str(values.dtype)


def _write_simulation(group: zarr.Group, arrays: Mapping[str, NDArray[Any]], count: int) -> None:
    sub = group.create_group(SIMULATION, attributes={"content_sha256": _simulation_hash(arrays)})
    for name, values in arrays.items():
        if len(values) != count:
            raise InputError(f"{SIMULATION}/{name} has {len(values)} rows; expected {count}, one per recording.")
        dimensions = ("trial", *(f"{name}_{i}" for i in range(1, values.ndim)))
        zarr_io.write_array(sub, name, values, dimensions, _dtype(values), {})


def read_simulation(path: Path) -> dict[str, NDArray[Any]]:
    """Parameters and ground truth of simulated recordings: arrays ``[recording, ...]`` by name.

    Raises:
        InputError: ``path`` is not a store, holds no simulation, or is damaged.
    """
    sub = open_store(path).get(SIMULATION)
    if not isinstance(sub, zarr.Group):
        raise InputError(f'{path} holds no simulation; expected a store made by "rcbht simulate".')
    with zarr_io.reading(path):
        dtypes = {name: None if array.dtype.kind in "biuf" else "string" for name, array in sub.arrays()}
        arrays = {name: zarr_io.read_array(sub, name, dtype) for name, dtype in dtypes.items()}
        expected = sub.attrs["content_sha256"]
    if _simulation_hash(arrays) != expected:
        raise InputError(f"{path} is damaged: its simulation does not match its checksum. Simulate or copy it again.")
    return arrays


def _simulation_hash(arrays: Mapping[str, NDArray[Any]]) -> str:
    return content_hash(arrays[name] for name in sorted(arrays))


def read_attrs(path: Path) -> dict[str, Any]:
    """The store's attributes: provenance, ``dt``, ``import_report`` and so on.

    Raises:
        InputError: ``path`` does not exist or is not a store of this format.
    """
    return dict(open_store(path).attrs)


def open_store(path: Path) -> zarr.Group:
    """Open the store's group for reading.

    Raises:
        InputError: ``path`` does not exist or is not a store of this format and version.
    """
    group = zarr_io.open_group(path)
    if group.attrs.get("format") != FORMAT:
        raise InputError(f'{path} is not a store of recordings; expected one made by "rcbht import" or "simulate".')
    if group.attrs.get("format_version") not in range(1, FORMAT_VERSION + 1):
        raise InputError(
            f"{path} has format version {group.attrs.get('format_version')}; expected 1 to {FORMAT_VERSION}. "
            "Import it again with this version of rcbht."
        )
    return group


def count_recordings(path: Path) -> int:
    """Number of recordings in a store.

    Raises:
        InputError: ``path`` does not exist, is not a store of this format, or is damaged.
    """
    group = open_store(path)
    with zarr_io.reading(path):
        return len(zarr_io.read_array(group, "length", "int32"))


def validate(recordings: Recordings) -> None:
    """Check that the fields of recordings agree with each other.

    Raises:
        InputError: there is no recording, a shape or dtype is wrong, a length exceeds the array, a sample is not
            finite within the length or not zero beyond it, or an annotation is about no recording.
    """
    wrench = np.asarray(recordings.wrench)
    if wrench.ndim != 3 or 0 in wrench.shape:
        raise InputError(f"wrench has shape {wrench.shape}; expected [recordings, samples, axes], none of them 0.")
    _check_shapes(recordings, len(wrench))
    if not SHORTEST <= recordings.dt <= LONGEST:
        raise InputError(f"dt is {recordings.dt}; expected {SHORTEST:g} to {LONGEST:g} s.")
    axes = (recordings.axes, recordings.units)
    if any(len(names) != wrench.shape[2] for names in axes) or len(set(recordings.axes)) < wrench.shape[2]:
        raise InputError(
            f"axes {axes[0]} have units {axes[1]}; expected {wrench.shape[2]} different names, with units."
        )
    for row, samples in enumerate(recordings.length):
        where = f"recording {row} ({recordings.trial[row]})"
        if not 1 <= samples <= wrench.shape[1]:
            raise InputError(f"{where}: length is {samples}; expected 1 to {wrench.shape[1]} samples.")
        if not (np.abs(wrench[row, :samples]) <= LARGEST).all():  # NaN compares as false
            raise InputError(
                f"{where}: the wrench is not finite everywhere, or beyond {LARGEST:g}; expected numbers whose sums are "
                "finite in single precision."
            )
        if wrench[row, samples:].any():
            raise InputError(f"{where}: the wrench beyond its length is not zero; expected zero padding.")
    _check_annotations(recordings)


def _check_annotations(recordings: Recordings) -> None:
    marks = recordings.annotations
    if len(marks) and not (marks.recording.min() >= 0 and marks.recording.max() < len(recordings)):
        raise InputError(
            f"annotations are about recordings {marks.recording.min()} to {marks.recording.max()}; there are "
            f"{len(recordings)}, from 0."
        )
    if not np.isfinite(marks.start).all() or np.isinf(marks.end).any():
        raise InputError("an annotation has no finite start or an infinite end; expected seconds.")


def _check_shapes(recordings: Recordings, count: int) -> None:
    for name, _, dtype, _ in VARIABLES.values():
        array = np.asarray(getattr(recordings, name))
        shape = recordings.wrench.shape if name == "wrench" else (count,)
        matches = array.dtype.kind == "U" if dtype == "string" else array.dtype == dtype
        if array.shape != shape or not matches:
            raise InputError(f"{name} is {array.dtype} of shape {array.shape}; expected {dtype} of shape {shape}.")
    for name, values in recordings.columns.items():
        if np.shape(values) != (count,) or np.asarray(values).dtype.kind not in "Ubiuf":
            raise InputError(
                f"column {name} is {values.dtype} of shape {values.shape}; expected text or numbers [{count}]."
            )
        if not NAME.fullmatch(name) or name in VARIABLES:
            raise InputError(f"{name!r} is not a name for a column; expected letters, digits and _ - . only.")
