"""Features on a common scale: by mean and deviation, or by ranks among the training items.

Attributes of words have long tails: one snap is a hundred times as steep as the next, and a mean and a deviation
follow the snap. Ranks do not; beyond the training items they stay at the lowest and highest rank.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

KNOTS = 21  # quantiles between which ranks are interpolated
SPREAD = 12**0.5  # gives uniformly spread ranks the deviation 1

Matrix = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Scale:
    """How features are scaled, learnt from training items only."""

    center: NDArray[np.float64]  # [feature] subtracted first
    width: NDArray[np.float64]  # [feature] divided by second
    knots: NDArray[np.float64]  # [knot, feature] increasing quantiles: ranks instead of values; [0, feature] = none

    def __call__(self, x: Matrix) -> NDArray[np.float64]:
        """Scaled features ``[item, feature]``."""
        values = ranks(x, self.knots) if len(self.knots) else x
        return np.asarray((values - self.center) / self.width, np.float64)


def fit_scale(
    x: Matrix,
    scaling: bool,
    floor: float = 0.0,
    ranked: bool = False,
    weight: NDArray[np.float64] | None = None,
    sample_weight: NDArray[np.float64] | None = None,
) -> Scale:
    """The scale of training items ``[item, feature]``.

    Args:
        x: training items.
        scaling: False = leave the features as they are.
        floor: least deviation to divide by.
        ranked: by ranks instead of mean and deviation.
        weight: positive ``[feature]``, multiplied by last, so that many features do not outvote few.
        sample_weight: ``[item]``, how often each counts in mean and deviation (in ranks once); None = once.
    """
    center, width, knots = np.zeros(x.shape[1]), np.ones(x.shape[1]), np.zeros((0, x.shape[1]))
    if scaling and ranked:
        knots = np.quantile(x, np.linspace(0, 1, KNOTS), axis=0).astype(np.float64)
    elif scaling:
        center, deviation = x.mean(0, dtype=np.float64), x.std(0, dtype=np.float64)
        if sample_weight is not None:
            center = np.average(x, 0, sample_weight)
            deviation = np.sqrt(np.average((x - center) ** 2, 0, sample_weight))
        varies = (np.ptp(x, 0) > 0) & (deviation > 0)  # rounding gives some constants a deviation of 1e-17
        width = np.where(varies, np.maximum(deviation, floor), 1.0)
    return Scale(center, width if weight is None else width / weight, knots)


def ranks(x: Matrix, knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks ``[item, feature]`` between -SPREAD / 2 and SPREAD / 2: lines between knots, the middle of a step on it."""
    total = np.zeros(x.shape)
    for low, high in itertools.pairwise(knots):
        gap = high - low
        ramp = np.clip((x - low) / np.where(gap > 0, gap, 1), 0, 1)
        total += np.where(gap > 0, ramp, ((x > low).astype(float) + (x >= low)) / 2)
    return (total / (len(knots) - 1) - 0.5) * SPREAD
