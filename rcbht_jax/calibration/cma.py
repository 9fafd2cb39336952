"""The evolution strategy in the unit cube, as the search for thresholds uses it: it maximises and keeps inside.

Pure: the next state is a function of the state and of the values of its samples, which are a function of the state
and the seed, so a run can be replayed from its values alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util import cma

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cma:
    """State of the strategy in ``d`` dimensions."""

    state: cma.State
    generation: int = 0

    @staticmethod
    def start(mean: Floats, sigma: float) -> Cma:
        """Round, of width ``sigma``, at a point of the cube."""
        return Cma(cma.start(mean, sigma))

    @property
    def mean(self) -> Floats:
        """``[d]``, the middle of the distribution."""
        return self.state.mean

    def sample(self, count: int, seed: int) -> Floats:
        """Points ``[count, d]`` of this generation, inside the cube."""
        normal = np.random.default_rng([seed, self.generation]).standard_normal((count, self.mean.size))
        values, vectors = np.linalg.eigh(self.state.covariance)
        root = (vectors * np.sqrt(np.maximum(values, 1e-14))) @ vectors.T
        return np.clip(self.mean + self.state.step * normal @ root.T, 0.0, 1.0)

    def update(self, points: Floats, values: Floats) -> Cma:
        """The next generation, from the points sampled and their values (larger is better; ties to the earlier)."""
        after = cma.update(self.state, points, -values, self.generation + 1)
        return Cma(after._replace(mean=np.clip(after.mean, 0.0, 1.0)), self.generation + 1)
