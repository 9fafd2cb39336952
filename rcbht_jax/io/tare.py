"""Subtraction of a sensor's bias, measured while nothing touches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.types import Recordings


def bias_of(samples: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Mean ``[axis]`` of samples ``[time, axis]`` in rest.

    Its sum is in double precision: in single, that of a minute's samples is wrong by a part in ten thousand.
    """
    return samples.mean(0, dtype=np.float64).astype(samples.dtype)


def tare(recordings: Recordings, samples: int) -> Recordings:
    """The recordings, each minus the mean wrench of its first samples; padding stays zero.

    Args:
        recordings: that begin in free space.
        samples: to average; shorter recordings use all of theirs.

    Raises:
        InputError: ``samples`` is less than one.
    """
    if samples < 1:
        raise InputError(f"a tare over {samples} samples is impossible; expected at least one.")
    wrench = recordings.wrench.copy()
    for row, length in enumerate(recordings.length):
        wrench[row, :length] -= bias_of(wrench[row, : min(samples, length)])
    return replace(recordings, wrench=wrench)
