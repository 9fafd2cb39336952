"""The columns that the two ensembles of a segmenter read, and how often."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from rcbht_jax._util.values import Copyable
from rcbht_jax.features.trailing import Accumulated, TrailingStatistics, with_norms
from rcbht_jax.labels import LAYERS

PERIOD = 0.025  # s between decisions; a label stays until the next one
WINDOWS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)  # s
BELIEF_WINDOWS = (0.1, 0.3, 1.0, 3.0)  # s


class Course(Copyable):
    """Beliefs of the first ensemble until each decision, as the second one reads them; in pieces of any size."""

    def __init__(self) -> None:
        self._statistics = TrailingStatistics(PERIOD, BELIEF_WINDOWS)
        self._largest, self._total = Accumulated(np.maximum), Accumulated(np.add)

    def push(self, belief: Float[np.ndarray, "moment class"]) -> Float[np.ndarray, "moment column"]:
        """Columns of new beliefs."""
        largest, total = self._largest.push(belief), self._total.push(belief)
        return np.concatenate([belief, self._statistics.push(belief), largest, total * PERIOD], 1)


def columns_of(units: Sequence[str], classes: int, words: bool) -> tuple[int, int]:
    """Columns that the first and the second ensemble of a causal segmenter read.

    >>> columns_of(("N",), 2, words=False)
    (43, 91)
    """
    channels = len(with_norms(np.zeros((1, len(units))), units)[0])
    first = channels * (1 + 5 * len(WINDOWS) + 2) + words * len(LAYERS) * len(units) * 4
    return first, first + classes * (4 + 5 * len(BELIEF_WINDOWS))


def decision_period(dt: float) -> int:
    """Samples between two decisions."""
    return max(1, round(PERIOD / dt))
