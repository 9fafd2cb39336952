"""Symbolic representations of other libraries, turned back into a signal.

Every function takes one axis ``y [time]``. Of SAX and 1d-SAX, which name all windows, a run of equal words counts as
one word. SFA of aeon is left out: it divides every window by its own deviation, so that its words do not contain the
size of the signal.

Sources: SAX (Lin et al. 2007) and 1d-SAX (Malinowski et al. 2013) of tslearn; fABBA (Chen and Güttel 2022) of fABBA,
its first step being that of ABBA (Elsworth and Güttel 2020).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments._lib.arrays import Floats
from experiments._lib.piecewise import Approximation
from rcbht_jax.errors import InputError

LETTERS = 16  # for the mean, and for the slope


def sax(y: Floats, samples: int, mean: float, deviation: float, slopes: bool = False) -> Approximation:
    """A letter for the mean of every window, and with ``slopes`` (1d-SAX) one for its slope, by tslearn.

    The last sample is repeated until the windows are full; mean and deviation are those of all recordings.
    """
    piecewise = _imported("tslearn.piecewise")
    count = -(-len(y) // samples)
    full = np.append(y, np.full(count * samples - len(y), y[-1]))
    if slopes:
        machine = piecewise.OneD_SymbolicAggregateApproximation(count, LETTERS, LETTERS)
    else:
        machine = piecewise.SymbolicAggregateApproximation(count, LETTERS)
    letters = machine.fit_transform(((full - mean) / deviation)[None, :, None])
    values = machine.inverse_transform(letters).ravel()[: len(y)] * deviation + mean
    changes = (np.diff(letters[0], axis=0) != 0).any(axis=1)
    return Approximation(values, 1 + int(changes.sum()))


def abba_chain(y: Floats, tolerance: float) -> Approximation:
    """The polygon through samples of ABBA's compression, before its pieces become symbols."""
    if len(y) < 2:
        return Approximation(y, 1)
    pieces = np.array(_imported("fABBA").compress(y, tol=tolerance**2))
    corners = np.append(0, pieces[:, 0].cumsum())
    heights = np.append(y[0], y[0] + pieces[:, 1].cumsum())
    return Approximation(np.interp(np.arange(len(y)), corners, heights), len(pieces))


def fabba(y: Floats, tolerance: float, alpha: float) -> Approximation:
    """The signal from the symbols of fABBA, which stand for groups of pieces within ``alpha`` of each other."""
    if len(y) < 2:
        return Approximation(y, 1)
    machine = _imported("fABBA").fABBA(tol=tolerance**2, alpha=alpha, verbose=0)
    symbols = machine.fit_transform(y)
    values = np.asarray(machine.inverse_transform(symbols, y[0]), float)
    values = np.append(values, np.full(max(len(y) - len(values), 0), values[-1]))  # lengths are rounded
    return Approximation(values[: len(y)], len(symbols))


def _imported(name: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"this row needs {name}; run it in the environment of the peers (make peers).") from error
