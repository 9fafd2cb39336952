"""Files of nominal monitors: arrays and one JSON text. Loading runs no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.untrusted import checked_fields, checked_texts
from rcbht_jax._util.url_path import as_path
from rcbht_jax._util.values import positive
from rcbht_jax.encoding.choices import plain
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.neighbours import FARTHEST, Bank
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.learning.model_io import reading, write_archive

FORMAT = "rcbht-monitor-1"
_ARRAYS = ("described", "scale", "reference")
_NUMBERS = ("reach", "slack", "drift", "neighbours")


@dataclass(frozen=True)
class MonitorFile:
    """A fitted monitor, with the axes and the selection of its training recordings."""

    monitor: NominalMonitor
    axes: tuple[str, ...]  # names
    where: tuple[str, ...]  # selection of the training recordings, COLUMN=VALUE each
    units: tuple[str, ...] = ()  # of the axes, "" = not stated; none in files written before units were kept
    arm: str = ""  # whose wrench it learned; "" = the last by name, as the right one


def save(path: Path | str, file: MonitorFile) -> None:
    """Write a fitted monitor.

    Raises:
        InputError: it cannot be written there.
    """
    bank = file.monitor.bank_
    meta = {
        "format": FORMAT,
        "version": rcbht_jax.__version__,
        **{name: getattr(file, name) for name in ("axes", "units", "where", "arm")},
        "parameters": {name: plain(value) for name, value in file.monitor.get_params().items()},
        "levels": file.monitor.levels_,
        **{name: plain(getattr(bank, name)) for name in _NUMBERS},
    }
    write_archive(path, meta, {"peaks": file.monitor.peaks_, **{name: getattr(bank, name) for name in _ARRAYS}})


def load(path: Path | str) -> MonitorFile:
    """Read what :func:`save` wrote.

    Raises:
        InputError: missing, damaged, or not a monitor.
    """
    path = as_path(path)
    with reading(path, FORMAT, gaps=("described",)) as (meta, archive):
        arrays: dict[str, Any] = {name: archive[name] for name in _ARRAYS}
        bank = Bank(**arrays, **checked_fields(Bank, {name: meta[name] for name in _NUMBERS}))
        monitor = NominalMonitor(**meta["parameters"])
        # Older files hold no found levels: theirs are those of the parameters.
        levels = tuple(int(level) for level in meta.get("levels", monitor.levels))
        axes, where = checked_texts("its axes", meta["axes"]), checked_texts("its groups", meta["where"])
        units = checked_texts("its units", meta.get("units", []))
        if not set(levels) <= set(range(len(axes))) or len(units) not in (0, len(axes)):
            raise InputError(f"it has {len(axes)} axes, {len(units)} units and the levels {levels}")
        monitor.restore(len(axes), levels, bank, archive["peaks"])
        _check(monitor)
        (arm,) = checked_texts("its arm", [meta.get("arm", "")])
        return MonitorFile(monitor, axes, where, units, arm)


def _check(monitor: NominalMonitor) -> None:
    """Raise an error for arrays that do not fit together, or numbers that no fit makes."""
    bank, peaks = monitor.bank_, monitor.peaks_
    channels, kinds = monitor.n_features_in_ + len(monitor.levels_), 1 + len(monitor.lags)
    moments, recordings = len(bank.described) - 2 * bank.reach, (*bank.described.shape, 0)[1]
    expected = {
        "described": (bank.described, np.float32, (moments + 2 * bank.reach, recordings, channels, kinds)),
        "scale": (bank.scale, np.float64, (channels, kinds)),
        "reference": (bank.reference, np.float64, (moments, channels)),
        "peaks": (peaks, np.float64, (peaks.size,)),
    }
    for name, (values, dtype, shape) in expected.items():
        if values.dtype != dtype or values.shape != shape or not values.size:
            raise InputError(f"{name} is {values.dtype} {values.shape}; expected {np.dtype(dtype)} {shape}")
    early, late = np.split(bank.described, [bank.reach])
    if not ((early == np.inf).all() and (np.abs(late) <= FARTHEST).all()):
        raise InputError("described has other gaps than before the beginning, or too large numbers")
    if not (positive(bank.scale) and positive(bank.reference)):
        raise InputError("a scale or a usual distance is no positive number that single precision holds")
    for name, least in {"reach": 0, "slack": 0, "drift": 0, "neighbours": 1}.items():
        if not least <= getattr(bank, name) <= 1e9:
            raise InputError(f"{name} is {getattr(bank, name)}; expected {least} to 1e+09")
