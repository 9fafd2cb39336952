"""Files of limits of either rule: the paper's, or of the fit rule with a tolerance for every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax.encoding.rules import AnyLimits
from rcbht_jax.encoding.thresholds import (
    FIT_VERSION,
    FORMAT_VERSION,
    LIMITS,
    TOLERANCE,
    GradientThresholds,
    check_rows,
    limits_of,
    read_rows,
    write_rows,
    write_thresholds,
)
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES


def write_limits(
    path: Path | str,
    limits: AnyLimits,
    provenance: Mapping[str, Any],
    axes: Sequence[str] = AXES,
    units: Sequence[str] = (),
) -> None:
    """Write limits ``[axis, 4]``, and the tolerances ``[axis]`` of the fit rule, as a whole file or not at all.

    Args:
        path: file to write; an existing one is replaced.
        limits: of either rule.
        provenance: how they were found; JSON values.
        axes: their names.
        units: of the axes, such as Nmm; "" = not stated, () = none is.

    Raises:
        InputError: wrong shape, not in order, not positive, another number of units, or the folder does not exist.

    Example:
        >>> import tempfile
        >>> limits = FitLimits(np.array([[70.0, 46.0, 23.0, 1.0]]), np.array([0.5]))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_limits(Path(folder) / "fit.json", limits, {"method": "rest"}, ["Fz"])
        ...     found, provenance = read_limits(Path(folder) / "fit.json", ["Fz"])
        >>> found.tolerance.tolist(), provenance
        ([0.5], {'method': 'rest'})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_limits(Path(folder) / "fit.json", limits, {}, ["My"], ["Nmm"])
        ...     read_limits(Path(folder) / "fit.json", ["My"], ["Nm"])[0].tolerance.tolist()
        [0.0005]
    """
    if not isinstance(limits, FitLimits):
        write_thresholds(path, GradientThresholds(limits_of(limits)), provenance, axes, units)
        return
    gradients = np.asarray(limits.gradients, np.float64)
    check_rows(gradients, path, axes)
    columns = dict(zip((*LIMITS, TOLERANCE), limits.stacked().T, strict=True))
    write_rows(path, FIT_VERSION, axes, columns, provenance, units, rule="fit")


def read_limits(
    path: Path | str, axes: Sequence[str] = AXES, units: Sequence[str] = (), rule: str = "paper"
) -> tuple[AnyLimits, dict[str, Any]]:
    """Limits of some axes, by name, and their provenance: GradientThresholds, or FitLimits of a file of the fit rule.

    Args:
        path: the file.
        axes: names of those to read.
        units: of the axes; what the file has in other units is converted. "" = as in the file, () = all are.
        rule: that they are for.

    Raises:
        InputError: not such a file, its numbers are not positive and in order for each of the axes, a unit that cannot
            be converted, or limits of single windows at rest for the fit rule.
    """
    version, columns, provenance = read_rows(path, axes, units)
    limits = np.stack([columns[name] for name in LIMITS], axis=-1)
    check_rows(limits, path, axes)
    if version == FORMAT_VERSION:
        if rule == "fit" and provenance.get("method") == "rest":
            raise InputError(
                f"{path} has limits of single windows at rest, which are for --rule paper; choose that, or make the "
                "file with --rule fit."
            )
        return GradientThresholds(limits), provenance
    found = FitLimits(limits, columns[TOLERANCE])
    try:
        found.stacked()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return found, provenance


def has_tolerances(path: Path | str) -> bool:
    """Whether a file of limits that the fit rule can use has tolerances; errors as of :func:`read_limits`."""
    return isinstance(read_limits(path, (), rule="fit")[0], FitLimits)


def taken_from_start(rule: str, robot: str, thresholds: Path | str | None, tolerance: object = None) -> list[str]:
    """Which limits of a stream come from its first readings: "thresholds", "tolerances", both or none.

    Args:
        rule: of the words.
        robot: preset of the thresholds; auto = from readings at rest.
        thresholds: file in place of the preset; None or "" = none.
        tolerance: of the fit rule; None, zero or empty = from readings.

    Raises:
        InputError: as of :func:`read_limits`.

    >>> taken_from_start("paper", "auto", None), taken_from_start("fit", "hiro", None)
    (['thresholds'], ['tolerances'])
    """
    learned = not thresholds and robot == "auto"
    measured = rule == "fit" and not tolerance and not (thresholds and has_tolerances(thresholds))
    return ["thresholds"] * learned + ["tolerances"] * measured
