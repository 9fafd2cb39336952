"""GradientThresholds as a JSON file with their provenance: written by ``rcbht calibrate``, read wherever labels are made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.encoding.thresholds import GradientThresholds, validate
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES

FORMAT, FORMAT_VERSION = "rcbht-thresholds", 1
LIMITS = ("impulse", "big", "medium", "small")


def write_thresholds(path: Path, thresholds: GradientThresholds, provenance: Mapping[str, Any]) -> None:
    """Write thresholds ``[6, 4]`` in N/s and Nm/s, as a whole file or not at all.

    Args:
        path: file to write; an existing one is replaced.
        thresholds: what to write.
        provenance: how they were found; JSON values.

    Raises:
        InputError: wrong shape, or the folder does not exist.
    """
    limits = np.asarray(thresholds.limits, np.float64)
    _check(limits, path)
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder; make it, or choose another file.")
    rows = {axis: dict(zip(LIMITS, row, strict=True)) for axis, row in zip(AXES, limits.tolist(), strict=True)}
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "units": "N/s (forces), Nm/s (moments)",
        "limits": rows,
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "provenance": dict(provenance),
    }
    with atomic_write(path) as draft:
        draft.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")


def read_thresholds(path: Path) -> tuple[GradientThresholds, dict[str, Any]]:
    """GradientThresholds ``[6, 4]`` and their provenance.

    Raises:
        InputError: not such a file, or its limits are not ordered positive numbers for six axes.
    """
    try:
        content = json.loads(path.read_text())
        if content["format"] != FORMAT or content["format_version"] != FORMAT_VERSION:
            raise InputError(f"{path} is not a file of thresholds of version {FORMAT_VERSION}.")
        rows, provenance = content["limits"], dict(content["provenance"])
        limits = np.array([[float(rows[axis][name]) for name in LIMITS] for axis in AXES])
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; expected a file of thresholds.") from None
    except (ValueError, KeyError, TypeError, UnicodeDecodeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f'{path} is not a file of thresholds, as "rcbht calibrate" writes them.') from None
    _check(limits, path)
    return GradientThresholds(limits), provenance


def _check(limits: np.ndarray[Any, np.dtype[np.float64]], path: Path) -> None:
    if limits.shape != (len(AXES), len(LIMITS)):
        raise InputError(f"GradientThresholds for {path} have shape {limits.shape}; expected [6, 4].")
    try:
        validate(limits)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
