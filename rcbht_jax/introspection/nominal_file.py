"""Files of nominal monitors: arrays and one JSON text. Loading runs no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.untrusted import checked_texts
from rcbht_jax._util.url_path import as_path
from rcbht_jax.encoding.choices import plain
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.neighbours import Bank
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
    arm: str = ""  # whose wrench it learned, as it was named; "" = the last by name, as the right one


def save(path: Path | str, file: MonitorFile) -> None:
    """Write a fitted monitor.

    Raises:
        InputError: it cannot be written there.
    """
    bank = file.monitor.bank_
    meta = {
        "format": FORMAT,
        "version": rcbht_jax.__version__,
        "axes": file.axes,
        "units": file.units,
        "where": file.where,
        "arm": file.arm,
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
        numbers: dict[str, Any] = {name: meta[name] for name in _NUMBERS}
        bank = Bank(**arrays, **numbers)
        monitor = NominalMonitor(**meta["parameters"])
        # Older files hold no found levels: theirs are those of the parameters.
        levels = tuple(int(level) for level in meta.get("levels", monitor.levels))
        axes, peaks = checked_texts("its axes", meta["axes"]), archive["peaks"]
        moments, channels = bank.reference.shape
        if (
            bank.described.ndim != 4
            or len(bank.described) != moments + 2 * bank.reach
            or bank.scale.shape != bank.described.shape[2:]
            or bank.described.shape[2] != channels
            or channels != len(axes) + len(levels)
            or not set(levels) <= set(range(len(axes)))
            or len(meta.get("units", [])) not in (0, len(axes))
            or not np.isfinite(peaks).all()
        ):
            raise InputError(f"{path} is damaged: its arrays do not fit each other.")
        where, units = checked_texts("its groups", meta["where"]), checked_texts("its units", meta.get("units", []))
        (arm,) = checked_texts("its arm", [meta.get("arm", "")])
        return MonitorFile(monitor.restore(len(axes), levels, bank, peaks), axes, where, units, arm)
