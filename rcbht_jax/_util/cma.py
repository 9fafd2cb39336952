"""CMA-ES: covariance matrix adaptation with rank-one and rank-mu updates and cumulative step-size control.

Pure functions: the caller draws the points and evaluates them, or uses :class:`CubeCma`. Source: N. Hansen, The CMA
Evolution Strategy: A Tutorial, arXiv:1604.00772, Table 1 and Appendix A, whose default strategy parameters are used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, " n"]


class State(NamedTuple):
    """The search distribution of n parameters."""

    mean: Vector
    step: float  # sigma
    covariance: Float[np.ndarray, "n n"]
    step_path: Vector  # p_sigma
    path: Vector  # p_c


def start(mean: Vector, step: float) -> State:
    """A round distribution of width ``step`` about ``mean``."""
    zero = np.zeros_like(mean)
    return State(mean, step, np.eye(mean.size), zero, zero)


def update(
    state: State, points: Float[np.ndarray, "population n"], losses: Float[np.ndarray, " population"], number: int
) -> State:
    """The distribution after a generation; tutorial, equations (numbers of Table 1) 37 to 47.

    Args:
        state: distribution from which the points were drawn.
        points: as drawn, or as moved into the bounds.
        losses: smaller is better, NaN is worst; the earlier of equal points ranks first.
        number: of the generation, from 1.
    """
    n, count = len(state.mean), len(points)
    weights = math.log((count + 1) / 2) - np.log(np.arange(1, count // 2 + 1))
    weights /= weights.sum()
    mass = 1.0 / float((weights**2).sum())  # variance-effective selection mass
    cs, cc = (mass + 2) / (n + mass + 5), (4 + mass / n) / (n + 4 + 2 * mass / n)
    c1 = 2 / ((n + 1.3) ** 2 + mass)
    cmu = min(1 - c1, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    damping = 1 + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1) + cs
    expected = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))  # length of a standard normal vector

    order = np.argsort(np.where(np.isnan(losses), np.inf, losses), kind="stable")
    moves = (points[order[: len(weights)]] - state.mean) / state.step
    move = weights @ moves
    variances, basis = np.linalg.eigh(state.covariance)
    whitened = basis @ ((basis.T @ move) / np.sqrt(np.maximum(variances, 1e-20)))
    step_path = (1 - cs) * state.step_path + math.sqrt(cs * (2 - cs) * mass) * whitened
    length = float(np.linalg.norm(step_path))
    # a fast-growing path would stretch the covariance while the step still adapts
    steady = length / math.sqrt(1 - (1 - cs) ** (2 * number)) < (1.4 + 2 / (n + 1)) * expected
    path = (1 - cc) * state.path + steady * math.sqrt(cc * (2 - cc) * mass) * move
    decay = 1 - c1 - cmu + (1 - steady) * c1 * cc * (2 - cc)
    covariance = decay * state.covariance + c1 * np.outer(path, path) + cmu * (moves.T * weights) @ moves
    step = state.step * math.exp(min(1.0, cs / damping * (length / expected - 1)))
    return State(state.mean + state.step * move, step, covariance, step_path, path)


@dataclass(frozen=True)
class CubeCma:
    """The strategy in the unit cube of ``n`` dimensions, maximising, with its own draws.

    The next state is a function of the state and of the values of its samples, and these are a function of the state
    and the seed, so that a run can be replayed from its values alone.
    """

    state: State
    generation: int = 0

    @property
    def mean(self) -> Vector:
        """``[n]``, the middle of the distribution."""
        return self.state.mean

    def sample(self, count: int, seed: int) -> Float[np.ndarray, "population n"]:
        """Points ``[count, n]`` of this generation, clipped to the cube."""
        normal = np.random.default_rng([seed, self.generation]).standard_normal((count, self.mean.size))
        values, vectors = np.linalg.eigh(self.state.covariance)
        root = (vectors * np.sqrt(np.maximum(values, 1e-14))) @ vectors.T
        return np.clip(self.mean + self.state.step * normal @ root.T, 0.0, 1.0)

    def update(self, points: Float[np.ndarray, "population n"], values: Float[np.ndarray, " population"]) -> CubeCma:
        """The next generation, from the points and their values ``[count]``: larger is better, ties go to the first."""
        after = update(self.state, points, -values, self.generation + 1)
        return CubeCma(after._replace(mean=np.clip(after.mean, 0.0, 1.0)), self.generation + 1)
