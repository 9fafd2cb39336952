"""The store: a Zarr v3 group with one row per recording, readable by ``xarray.open_zarr``.

Layout (dimensions in brackets): ``wrench [trial, time, axis]`` float32, zero beyond ``length [trial]``;
``dt`` (scalar and attribute); ``onset``, ``onset_harmonised [trial, state]``; ``deviation [trial, pose]``;
the string variables ``trial_name``, ``arm``, ``source``, ``session``, ``outcome``, ``failure_type``, ``note``
``[trial]``; the coordinate ``axis``; label tracks in ``labels/<name>/<layer>/`` (``rcbht_jax.io.label_store``);
what a simulation knows besides in ``simulation/``, every array ``[trial, ...]``.
The dimension "trial" counts recordings: one arm of one trial.

Every chunk carries a CRC-32C and the group a SHA-256 of its content: truncation and loss show on reading.
Writes go to a temporary sibling and are renamed when complete: an interrupted one never looks whole.
Source: design page "architecture", section "Store".
"""

from __future__ import annotations

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
from rcbht_jax.errors import InputError
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.labels import AXES
from rcbht_jax.types import Recordings

with needs_extra("store"):
    import zarr

FORMAT, FORMAT_VERSION = "rcbht-recordings", 1
OUTCOMES = ("success", "failure", "unknown")
SIMULATION = "simulation"

# Variable of the store -> (field of Recordings, dimensions, dtype, attributes).
VARIABLES: dict[str, tuple[str, tuple[str, ...], str, dict[str, str]]] = {
    "wrench": ("wrench", ("trial", "time", "axis"), "float32", {"units": "N (forces), N m (moments)"}),
    "length": ("length", ("trial",), "int32", {"units": "samples"}),
    "onset": ("onset", ("trial", "state"), "float64", {"units": "s"}),
    "onset_harmonised": ("onset_harmonised", ("trial", "state"), "float64", {"units": "s"}),
    "deviation": ("deviation", ("trial", "pose"), "float64", {"units": "m (x, y), rad (roll)"}),
    "trial_name": ("trial", ("trial",), "string", {}),
    "arm": ("arm", ("trial",), "string", {}),
    "source": ("source", ("trial",), "string", {}),
    "session": ("session", ("trial",), "string", {}),
    "outcome": ("outcome", ("trial",), "string", {}),
    "failure_type": ("failure_type", ("trial",), "string", {}),
    "note": ("note", ("trial",), "string", {}),
}


def check_target(path: Path, overwrite: bool) -> None:
    """Check that a store may be written at ``path``, before the work is done.

    Raises:
        InputError: the parent folder does not exist, or something is there that ``overwrite`` does not allow
            to replace; only a store is ever replaced.
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

    Args:
        path: folder to create; by custom it ends in ``.zarr``.
        recordings: what to write.
        attrs: provenance (JSON values), kept beside version, creation date and content hash.
        overwrite: replace an existing store, once the new one is complete.
        created: what to keep as creation date; default now. With a fixed text, equal content gives equal bytes.
        simulation: arrays ``[trial, ...]`` kept in the group ``simulation/``; text as NumPy strings.

    Raises:
        InputError: the recordings contradict themselves, ``path`` is taken, or ``attrs`` is not JSON.
    """
    check_target(path, overwrite)
    validate(recordings)
    arrays = {variable: getattr(recordings, spec[0]) for variable, spec in VARIABLES.items()}
    own: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds") if created is None else created,
        "dt": recordings.dt,
        "content_sha256": content_hash([*arrays.values(), np.float64(recordings.dt)]),
    }
    with atomic_folder(path) as draft:
        group = zarr_io.create_group(draft, {**attrs, **own})
        for variable, (_, dimensions, dtype, attributes) in VARIABLES.items():
            zarr_io.write_array(group, variable, arrays[variable], dimensions, dtype, attributes)
        zarr_io.write_array(group, "dt", np.float64(recordings.dt), (), "float64", {"units": "s"})
        zarr_io.write_array(group, "axis", np.array(AXES), ("axis",), "string", {})
        if simulation is not None:
            _write_simulation(group, simulation, len(recordings))
        zarr_io.consolidate(draft)


def read_recordings(path: Path) -> Recordings:
    """Read and check a whole store.

    Raises:
        InputError: nothing there, not a store of this format, or damaged (a chunk missing, cut or altered).
    """
    group = open_store(path)
    with zarr_io.reading(path):
        arrays = {variable: zarr_io.read_array(group, variable, spec[2]) for variable, spec in VARIABLES.items()}
        dt = float(zarr_io.read_array(group, "dt", "float64")[()])
        expected = group.attrs["content_sha256"]
    if content_hash([*arrays.values(), np.float64(dt)]) != expected:
        raise InputError(f"{path} is damaged: its content does not match its checksum. Import or copy it again.")
    recordings = Recordings(dt=dt, **{spec[0]: arrays[variable] for variable, spec in VARIABLES.items()})
    try:
        validate(recordings)
    except InputError as error:
        raise InputError(f"{path} holds contradictory recordings: {error}") from error
    return recordings


def _write_simulation(group: zarr.Group, arrays: Mapping[str, NDArray[Any]], count: int) -> None:
    sub = group.create_group(SIMULATION, attributes={"content_sha256": _simulation_hash(arrays)})
    for name, values in arrays.items():
        if len(values) != count:
            raise InputError(f"{SIMULATION}/{name} has {len(values)} rows; expected {count}, one per recording.")
        dimensions = ("trial", *(f"{name}_{i}" for i in range(1, values.ndim)))
        dtype = "string" if values.dtype.kind == "U" else str(values.dtype)
        zarr_io.write_array(sub, name, values, dimensions, dtype, {})


def read_simulation(path: Path) -> dict[str, NDArray[Any]]:
    """What a simulation kept beside its recordings: arrays ``[trial, ...]`` by name; see ``sim_mjx.synthesis.pipeline``.

    Raises:
        InputError: no such store, it was not simulated, or it is damaged.
    """
    sub = open_store(path).get(SIMULATION)
    if not isinstance(sub, zarr.Group):
        raise InputError(f'{path} holds no simulation; expected a store made by "rcbht simulate".')
    with zarr_io.reading(path):
        kinds = {name: None if array.dtype.kind in "biuf" else "string" for name, array in sub.arrays()}
        arrays = {name: zarr_io.read_array(sub, name, kind) for name, kind in kinds.items()}
        expected = sub.attrs["content_sha256"]
    if _simulation_hash(arrays) != expected:
        raise InputError(f"{path} is damaged: its simulation does not match its checksum. Simulate or copy it again.")
    return arrays


def _simulation_hash(arrays: Mapping[str, NDArray[Any]]) -> str:
    return content_hash(arrays[name] for name in sorted(arrays))


def read_attrs(path: Path) -> dict[str, Any]:
    """The store's attributes: provenance, ``dt``, ``import_report`` and so on.

    Raises:
        InputError: nothing there, or not a store of this format.
    """
    return dict(open_store(path).attrs)


def open_store(path: Path) -> zarr.Group:
    """Open the store's group for reading.

    Raises:
        InputError: nothing there, or not a store of this format and version.
    """
    group = zarr_io.open_group(path)
    if group.attrs.get("format") != FORMAT:
        raise InputError(f'{path} is not a store of recordings; expected one made by "rcbht import" or "simulate".')
    if group.attrs.get("format_version") != FORMAT_VERSION:
        raise InputError(
            f"{path} has format version {group.attrs.get('format_version')}; expected {FORMAT_VERSION}. "
            "Import it again with this version of rcbht."
        )
    return group


def count_recordings(path: Path) -> int:
    """Number of recordings in a store.

    Raises:
        InputError: nothing there, not a store of this format, or damaged.
    """
    group = open_store(path)
    with zarr_io.reading(path):
        return len(zarr_io.read_array(group, "length", "int32"))


def validate(recordings: Recordings) -> None:
    """Check that the fields of recordings agree with each other.

    Raises:
        InputError: no recording, a wrong shape or dtype, a length outside the array, a value that is not
            finite within it or not zero beyond it, or an unknown arm or outcome.
    """
    wrench = np.asarray(recordings.wrench)
    if wrench.ndim != 3 or wrench.shape[2] != 6 or 0 in wrench.shape:
        raise InputError(f"wrench has shape {wrench.shape}; expected [recordings, samples, 6], none of them 0.")
    _check_shapes(recordings, len(wrench))
    if not (np.isfinite(recordings.dt) and recordings.dt > 0):
        raise InputError(f"dt is {recordings.dt}; expected a positive number of seconds.")
    for row, samples in enumerate(recordings.length):
        where = f"recording {row} ({recordings.trial[row]})"
        if not 1 <= samples <= wrench.shape[1]:
            raise InputError(f"{where}: length is {samples}; expected 1 to {wrench.shape[1]} samples.")
        if not np.isfinite(wrench[row, :samples]).all():
            raise InputError(f"{where}: the wrench is not finite everywhere; expected numbers.")
        if wrench[row, samples:].any():
            raise InputError(f"{where}: the wrench beyond its length is not zero; expected zero padding.")
    _check_words("arm", recordings.arm, ("R", "L"))
    _check_words("outcome", recordings.outcome, OUTCOMES)


def _check_shapes(recordings: Recordings, count: int) -> None:
    width = {"state": (4,), "pose": (3,), "time": recordings.wrench.shape[1:]}
    for name, dimensions, dtype, _ in VARIABLES.values():
        array = np.asarray(getattr(recordings, name))
        shape = (count, *(width[dimensions[1]] if len(dimensions) > 1 else ()))
        kind = array.dtype.kind == "U" if dtype == "string" else array.dtype == dtype
        if array.shape != shape or not kind:
            raise InputError(f"{name} is {array.dtype} of shape {array.shape}; expected {dtype} of shape {shape}.")


def _check_words(name: str, values: NDArray[np.str_], allowed: tuple[str, ...]) -> None:
    wrong = [str(value) for value in values if value not in allowed]
    if wrong:
        raise InputError(f"{name} is {wrong[0]!r}; expected one of {', '.join(allowed)}.")
