"""Gradient thresholds per axis: robot presets, the ordered parametrisation used by calibration, and JSON files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.columns import is_moment, unit_factor
from rcbht_jax._util.signals import distinct, numbers_of, texts
from rcbht_jax._util.untrusted import checked_number, load_json
from rcbht_jax._util.url_path import as_path
from rcbht_jax._util.values import ByValue, expect, positive
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.types import Array

# Impulse, big, medium, small limits for forces, N/s, from the authors' programs.
_FORCE_LIMITS = {
    "hiro": (70.0, 46.0, 23.0, 1.0),
    "baxter": (70.0, 46.0, 23.0, 1.0),
    "pa10": (1000.0, 100.0, 10.0, 1.0),
}
ROBOTS = tuple(_FORCE_LIMITS)
MOMENT_SCALE = 10.0  # moments of a hand-sized lever are about a tenth of the forces


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GradientThresholds(ByValue):
    """Gradient limits, largest first; negative slopes use the same limits, mirrored (paper, section III-A).

    A plain pytree: ``jax.grad``, ``jax.tree.map`` and ``jax.device_get`` return another one. The constructor checks
    nothing; encoders, files and models check the limits that they are given (:meth:`validate`). Two of them are equal
    if all their limits are.

    Attributes:
        limits: float ``[..., axis, 4]``, impulse >= big >= medium >= small > 0, N/s for forces, Nm/s for moments.

    Example:
        >>> import numpy as np
        >>> force, moment = [120.0, 60.0, 25.0, 2.0], [6.0, 3.0, 1.2, 0.1]
        >>> GradientThresholds(np.array([force] * 3 + [moment] * 3)).validate().limits.shape
        (6, 4)
    """

    limits: Float[Array, "*batch axis 4"]

    def validate(self) -> GradientThresholds:
        """Return these thresholds if they are valid.

        Raises:
            InputError: wrong shape, not finite, not positive or not ordered.
        """
        validate(host_limits(self))
        return self


Thresholds = GradientThresholds | Float[Array, "*batch axis 4"]  # what encoders take: the object, or its limits


def host_limits(thresholds: Any) -> NDArray[Any]:
    """The limits of a thresholds object, or of an array or list, as numbers on the host.

    Raises:
        InputError: they are no numbers.
    """
    return numbers_of(getattr(thresholds, "limits", thresholds), "A table of limits")


def limits_of(thresholds: Thresholds) -> Float[Array, "*batch axis 4"]:
    """The array of limits of a thresholds object; an array stays as it is. Safe inside jit, vmap and grad."""
    return thresholds.limits if isinstance(thresholds, GradientThresholds) else thresholds


def by_lane(limits: Array, number: int, lanes: tuple[int, ...], dtype: jax.typing.DTypeLike) -> Array:
    """Limits ``[axis, number]`` or ``[*lanes, number]`` as ``[number, *lanes]``, inside jit, vmap and grad too.

    Raises:
        InputError: they are of other axes, or another number of them.
    """
    limits = jnp.asarray(of_lanes(limits, number, lanes), dtype)
    return jnp.moveaxis(jnp.broadcast_to(limits, (*lanes, number)), -1, 0)


def of_lanes(limits: Array, number: int, lanes: tuple[int, ...]) -> Array:
    """The limits as they are, if they are ``[axis, number]`` or ``[*lanes, number]``.

    Raises:
        InputError: they are of other axes, be it a single one, or another number of them.
    """
    shape, wide = jnp.shape(limits), (*lanes, number)
    if shape not in (wide, wide[-2:]):
        expected = " or ".join(str([*one]) for one in sorted({wide, wide[-2:]}, key=len))
        raise InputError(f"Thresholds have shape {shape}; expected {expected}.")
    return limits


def validate(limits: NDArray[np.floating]) -> None:
    """Check a host array of limits ``[..., axis, 4]``.

    Raises:
        InputError: wrong shape, not finite in single precision, not positive or not ordered.
    """
    if limits.ndim < 2 or limits.shape[-1] != 4:
        raise InputError(f"Thresholds have shape {limits.shape}; expected [..., axis, 4].")
    if not positive(limits):
        raise InputError(
            f"Thresholds are {limits.min():g} to {limits.max():g}; expected positive numbers of 1.2e-38 to 3.4e38, "
            "which single precision holds."
        )
    if (wrong := (limits[..., :-1] < limits[..., 1:]).any(-1)).any():
        raise InputError(
            f"The thresholds of an axis are {limits[wrong][0].tolist()}; they must be ordered: impulse >= big >= "
            "medium >= small."
        )


def preset(robot: str = "hiro", axes: Sequence[str] = AXES, units: Sequence[str] = ()) -> GradientThresholds:
    """Hand-set thresholds of the authors for a robot, ``[axis, 4]``; moments are a tenth of the forces.

    Args:
        robot: one of ``ROBOTS``.
        axes: their names. The last force or moment in a name decides, such as ``Fx``, ``force_x``, ``mx`` or
            ``torque_z``; without one, names that begin with M or T are moments, all others forces.
        units: of the axes, to which the limits are converted; "" = N or Nm, by the name; () = none is stated.

    Raises:
        InputError: unknown robot, no axes, axes that are not names, or a unit that is of no force and no moment.

    Example:
        >>> preset("hiro", ["Fz", "My"]).limits.tolist()
        [[70.0, 46.0, 23.0, 1.0], [7.0, 4.6, 2.3, 0.1]]
        >>> preset("hiro", ["mx", "wrist.torque.z", "mass", "TCP_Fz"]).limits[:, 0].tolist()
        [7.0, 7.0, 70.0, 70.0]
        >>> preset("hiro", ["Fz", "My"], ["N", "Nmm"]).limits.tolist()
        [[70.0, 46.0, 23.0, 1.0], [7000.0, 4600.0, 2300.0, 100.0]]
    """
    if robot not in ROBOTS:
        raise InputError(f"Robot {robot!r} has no thresholds; expected one of {', '.join(ROBOTS)}.")
    names = texts(axes)
    pairs = zip(names, units_of(names, units), strict=True)
    return GradientThresholds(np.stack([_preset_of(robot, axis, unit) for axis, unit in pairs]))


def _preset_of(robot: str, axis: str, unit: str) -> NDArray[np.float64]:
    moment = is_moment(axis, unit)
    if not (factor := unit_factor("Nm" if moment else "N", unit)):
        raise InputError(
            f"The thresholds of {robot} are for forces and moments, and {axis} is in {unit}; choose thresholds from "
            "recordings or a file."
        )
    return np.array(_FORCE_LIMITS[robot]) / (MOMENT_SCALE if moment else 1.0) * factor


def units_of(axes: Sequence[str], units: Sequence[str]) -> Sequence[str]:
    """The unit of each axis, "" = not stated, which all are where none are given.

    Raises:
        InputError: another number of units than of axes.
    """
    if units and len(units) != len(axes):
        raise InputError(f"There are {len(units)} units for {len(axes)} axes; expected one for each.")
    return units or ("",) * len(axes)


def from_free(free: Array) -> GradientThresholds:
    """Thresholds from unconstrained numbers ``[..., axis, 4]``: log of the small limit, then log of each step up.

    Any real input gives ordered, positive limits; the inverse is :func:`to_free`.
    """
    steps = jnp.exp(free)
    return GradientThresholds(jnp.cumsum(steps, axis=-1)[..., ::-1])


def to_free(thresholds: GradientThresholds) -> Array:
    """Unconstrained parametrisation of strictly ordered thresholds (inverse of :func:`from_free`)."""
    ascending = jnp.asarray(thresholds.limits)[..., ::-1]
    steps = jnp.diff(ascending, axis=-1, prepend=jnp.zeros_like(ascending[..., :1]))
    return jnp.log(steps)


FORMAT, FORMAT_VERSION = "rcbht-thresholds", 1
FIT_VERSION = 2  # with tolerances: a program that knows only the paper's rule must not take the limits alone
LIMITS = ("impulse", "big", "medium", "small")
TOLERANCE = "tolerance"
COLUMNS = {FORMAT_VERSION: LIMITS, FIT_VERSION: (*LIMITS, TOLERANCE)}


def write_thresholds(
    path: Path | str,
    thresholds: Any,
    provenance: Mapping[str, Any],
    axes: Sequence[str] = AXES,
    units: Sequence[str] = (),
) -> None:
    """Write thresholds ``[axis, 4]``, in units of the axes per second, to a file, atomically.

    Args:
        path: file to write; an existing one is replaced.
        thresholds: GradientThresholds, or limits ``[axis, 4]``.
        provenance: how they were found; JSON values.
        axes: their names.
        units: of the axes, such as Nmm; "" = not stated, () = none is.

    Raises:
        InputError: wrong shape, not in order, limits of the fit rule, axes that are not different names, another
            number of units, provenance that is not JSON, or the folder does not exist.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_thresholds(Path(folder) / "hiro.json", preset("hiro"), {"from": "the authors"})
        ...     read_thresholds(Path(folder) / "hiro.json")[1]
        {'from': 'the authors'}
    """
    if hasattr(thresholds, "tolerance"):
        raise InputError("These limits have tolerances; write them with rcbht_jax.encoding.limit_files.write_limits.")
    limits = host_limits(thresholds).astype(np.float64)
    check_rows(limits, path, axes)
    write_rows(path, limits, provenance, axes, units)


def write_rows(
    path: Path | str,
    numbers: NDArray[np.float64],
    provenance: Mapping[str, Any],
    axes: Sequence[str],
    units: Sequence[str],
) -> None:
    """Write limits ``[axis, 4]``, or ``[axis, 5]`` with the tolerance last; errors as of :func:`write_thresholds`."""
    version = FORMAT_VERSION if numbers.shape[1] == len(LIMITS) else FIT_VERSION
    path, axes = as_path(path), distinct(axes)
    expect("The provenance", provenance, Mapping)
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder; make it, or choose another file.")
    rows: dict[str, dict[str, Any]] = {}
    for axis, unit, row in zip(axes, units_of(axes, units), numbers.tolist(), strict=True):
        rows[axis] = dict(zip(COLUMNS[version], row, strict=True)) | ({"unit": unit} if unit else {})
    content = {
        "format": FORMAT,
        "format_version": version,
        **({"rule": "fit"} if version == FIT_VERSION else {}),
        "units": "limits: unit of the axis per second; tolerance: unit of the axis",
        "limits": rows,
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "provenance": provenance,
    }
    try:
        text = json.dumps(content, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"The provenance cannot be stored as JSON: {error}.") from None
    with atomic_write(path) as draft:
        draft.write_text(text + "\n")


def read_thresholds(
    path: Path | str, axes: Sequence[str] = AXES, units: Sequence[str] = ()
) -> tuple[GradientThresholds, dict[str, Any]]:
    """Read thresholds ``[axis, 4]`` of the named axes, and their provenance.

    Args:
        path: the file.
        axes: names of those to read.
        units: of the axes; limits that the file has in other units are converted. "" = as in the file, () = all are.

    Raises:
        InputError: not a file of thresholds, one of the fit rule (see
            :func:`rcbht_jax.encoding.limit_files.read_limits`), its limits are not ordered positive numbers for each
            of the axes, or a unit that cannot be converted.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_thresholds(Path(folder) / "hiro.json", preset("hiro"), {})
        ...     read_thresholds(Path(folder) / "hiro.json")[0].limits[0].tolist()
        [70.0, 46.0, 23.0, 1.0]
    """
    limits, tolerance, provenance = read_rows(path, axes, units)
    if tolerance is not None:
        raise InputError(f"{path} holds limits of the fit rule, with tolerances; the paper's rule cannot use them.")
    return GradientThresholds(limits), provenance


def read_rows(
    path: Path | str, axes: Sequence[str], units: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, dict[str, Any]]:
    """Limits ``[axis, 4]``, tolerances ``[axis]`` of the fit rule, provenance; errors as of :func:`read_thresholds`."""
    axes = texts(axes) if axes else ()  # none: only the version is asked for
    with _file_of_thresholds(path) as (version, rows, provenance):
        if missing := [axis for axis in axes if axis not in rows]:
            raise InputError(f"{path} has no thresholds for {', '.join(missing)}; it has {', '.join(rows)}.")
        pairs = zip(axes, units_of(axes, units), strict=True)
        factors = np.array([_factor(path, axis, _unit(path, axis, rows[axis]), unit) for axis, unit in pairs])
        names = COLUMNS[version]
        found = [[checked_number(f"{path}: {name} of {axis}", rows[axis][name]) for name in names] for axis in axes]
        numbers = np.reshape(found, (len(axes), len(names))) * factors[:, None]
    limits, tolerance = numbers[:, : len(LIMITS)], numbers[:, -1] if version == FIT_VERSION else None
    check_rows(limits, path, axes)
    return limits, tolerance, provenance


def units_in(path: Path | str) -> dict[str, str]:
    """Units of the axes in a file of thresholds by their names, in the order of the file; "" = not stated.

    Raises:
        InputError: not such a file.
    """
    with _file_of_thresholds(path) as (_, rows, _):
        return {axis: _unit(path, axis, row) for axis, row in rows.items()}


@contextmanager
def _file_of_thresholds(path: Path | str) -> Iterator[tuple[int, Mapping[str, Any], dict[str, Any]]]:
    """Version, rows by axis, and provenance; what is wrong with them, also in the body, becomes one sentence."""
    try:
        content = load_json(as_path(path))
        version = content["format_version"]
        if content["format"] != FORMAT or version not in COLUMNS:
            raise InputError(f"{path} is not a file of thresholds of version {' or '.join(map(str, COLUMNS))}.")
        rows = dict(content["limits"])
        for axis, row in rows.items():
            expect(f"{path}: what it has for {axis}", row, dict)
        yield version, rows, dict(content["provenance"])
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; expected a file of thresholds.") from None
    except (ValueError, KeyError, TypeError, UnicodeDecodeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f'{path} is not a file of thresholds, as "rcbht calibrate" writes them.') from None


def _unit(path: Path | str, axis: str, row: Mapping[str, Any]) -> str:
    expect(f"{path}: unit of {axis}", unit := row.get("unit", ""), str)
    return str(unit)


def _factor(path: Path | str, axis: str, stated: str, unit: str) -> float:
    if not (factor := unit_factor(stated, unit)):
        raise InputError(f"{path} has thresholds for {axis} in {stated}; it is in {unit} here, and no factor is known.")
    return factor


def check_rows(limits: NDArray[np.float64], path: Path | str, axes: Sequence[str]) -> None:
    """Refuse limits of a file that are not ``[axis, 4]``, not positive or out of order; the message names the file."""
    if limits.shape != (len(axes), len(LIMITS)):
        raise InputError(f"Thresholds for {path} have shape {limits.shape}; expected [{len(axes)}, 4].")
    try:
        validate(limits)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
