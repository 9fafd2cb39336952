"""Checks of numbers that are data or parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SINGLE = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)  # sizes with all digits in float32
LARGEST = 1e30  # of a sample in any unit: sums over hours stay far from the largest single precision number


def usable(samples: NDArray[np.floating]) -> bool:
    """Whether all samples are finite numbers, and none is beyond ``LARGEST``.

    >>> usable(np.array([0.0, -5.0])), usable(np.array([0.0, np.nan])), usable(np.array([3e38]))
    (True, False, False)
    """
    return bool((np.abs(samples) <= LARGEST).all())  # NaN compares as false


def positive(values: NDArray[np.floating]) -> bool:
    """Whether all values are positive numbers that single precision holds with all its digits.

    >>> positive(np.array([0.1, 70.0])), positive(np.array([0.0])), positive(np.array([1e300]))
    (True, False, False)
    """
    return bool(((values >= SINGLE[0]) & (values <= SINGLE[1])).all())  # NaN compares as false
