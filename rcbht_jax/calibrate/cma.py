"""CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", 2016) for the unit cube, smallest useful form.

Maximises. Pure: the next state is a function of the state and of the values of its samples, which are a function
of the state and the seed, so a run can be replayed from its values alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cma:
    """State of the strategy in ``d`` dimensions."""

    mean: Floats  # [d]
    sigma: float
    covariance: Floats  # [d, d]
    path: Floats  # [d] evolution path of the covariance
    path_sigma: Floats  # [d] evolution path of the step size
    generation: int = 0

    @staticmethod
    def start(mean: Floats, sigma: float) -> Cma:
        """Round, of width ``sigma``, at a point of the cube."""
        zero = np.zeros_like(mean)
        return Cma(mean, sigma, np.eye(mean.size), zero, zero)

    def sample(self, count: int, seed: int) -> Floats:
        """Points ``[count, d]`` of this generation, inside the cube."""
        normal = np.random.default_rng([seed, self.generation]).standard_normal((count, self.mean.size))
        return np.clip(self.mean + self.sigma * normal @ self._root().T, 0.0, 1.0)

    def _root(self) -> Floats:
        values, vectors = np.linalg.eigh(self.covariance)
        return (vectors * np.sqrt(np.maximum(values, 1e-14))) @ vectors.T

    def update(self, points: Floats, values: Floats) -> Cma:
        """The next generation, from the points sampled and their values (larger is better; ties to the earlier)."""
        d, parents = self.mean.size, len(points) // 2
        weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
        weights /= weights.sum()
        mass = 1 / np.square(weights).sum()
        c_sigma = (mass + 2) / (d + mass + 5)
        damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (d + 1)) - 1) + c_sigma
        c_path = (4 + mass / d) / (d + 4 + 2 * mass / d)
        c_one = 2 / ((d + 1.3) ** 2 + mass)
        c_many = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((d + 2) ** 2 + mass))
        length = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d * d))  # of a standard normal vector

        steps = (points[np.argsort(-values, kind="stable")[:parents]] - self.mean) / self.sigma
        step = weights @ steps
        white = np.linalg.solve(self._root(), step)
        path_sigma = (1 - c_sigma) * self.path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mass) * white
        size = np.linalg.norm(path_sigma)
        stalled = size / np.sqrt(1 - (1 - c_sigma) ** (2 * self.generation + 2)) >= (1.4 + 2 / (d + 1)) * length
        path = (1 - c_path) * self.path + (not stalled) * np.sqrt(c_path * (2 - c_path) * mass) * step
        rank_one = np.outer(path, path) + stalled * c_path * (2 - c_path) * self.covariance
        covariance = (1 - c_one - c_many) * self.covariance + c_one * rank_one
        covariance += c_many * (steps.T * weights) @ steps
        sigma = self.sigma * np.exp(c_sigma / damping * (size / length - 1))
        mean = np.clip(self.mean + self.sigma * step, 0.0, 1.0)
        return Cma(mean, float(sigma), covariance, path, path_sigma, self.generation + 1)
