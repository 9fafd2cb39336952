"""Files of limits of either rule: the paper's, or of the fit rule with a tolerance for every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax.encoding.rules import AnyLimits
from rcbht_jax.encoding.thresholds import GradientThresholds, check_rows, read_rows, write_rows, write_thresholds
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
    """Write limits of either rule: ``[axis, 4]``, and by the fit rule tolerances ``[axis]``.

    Other arguments and errors are those of :func:`rcbht_jax.encoding.thresholds.write_thresholds`.

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
    if isinstance(limits, FitLimits):
        check_rows(np.asarray(limits.gradients, np.float64), path, axes)
        write_rows(path, limits.stacked(), provenance, axes, units)
    else:
        write_thresholds(path, limits, provenance, axes, units)


def read_limits(
    path: Path | str, axes: Sequence[str] = AXES, units: Sequence[str] = (), rule: str = "paper"
) -> tuple[AnyLimits, dict[str, Any]]:
    """Limits of some axes, by name, and their provenance: GradientThresholds, or FitLimits of a file of the fit rule.

    Arguments and errors are those of :func:`rcbht_jax.encoding.thresholds.read_thresholds`. ``rule`` is what the limits
    are for: by the fit rule, limits of single windows at rest are an InputError.
    """
    limits, tolerance, provenance = read_rows(path, axes, units)
    if tolerance is None:
        if rule == "fit" and provenance.get("method") == "rest":
            raise InputError(
                f"{path} has limits of single windows at rest, which are for --rule paper; choose that, or make the "
                "file with --rule fit."
            )
        return GradientThresholds(limits), provenance
    found = FitLimits(limits, tolerance)
    try:
        found.stacked()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return found, provenance


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
    measured = rule == "fit" and not tolerance
    if measured and thresholds:
        measured = not isinstance(read_limits(thresholds, (), rule=rule)[0], FitLimits)
    return ["thresholds"] * learned + ["tolerances"] * measured
