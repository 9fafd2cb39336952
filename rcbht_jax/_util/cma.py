"""CMA-ES: covariance matrix adaptation with rank-one and rank-mu updates and cumulative step-size control.

Pure: whoever searches draws the points and judges them. Source: N. Hansen, The CMA Evolution Strategy: A Tutorial,
arXiv:1604.00772, Table 1 and Appendix A, whose default strategy parameters are used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class State(NamedTuple):
    """The search distribution of n parameters."""

    mean: Floats  # [n]
    step: float
    covariance: Floats  # [n, n]
    step_path: Floats  # [n] p_sigma
    path: Floats  # [n] p_c


def start(mean: Floats, step: float) -> State:
    """Round, of width ``step``, about ``mean [n]``."""
    zero = np.zeros_like(mean)
    return State(mean, step, np.eye(mean.size), zero, zero)


def update(state: State, points: Floats, losses: Floats, number: int) -> State:
    """The distribution after a generation; tutorial, equations (numbers of Table 1) 37 to 47.

    Args:
        state: that the points were drawn from.
        points: population ``[population, n]``, as drawn or as moved into what is allowed.
        losses: ``[population]``, smaller is better, NaN worst; ties go to the earlier point.
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
    usual = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))  # length of a standard normal vector

    order = np.argsort(np.where(np.isnan(losses), np.inf, losses), kind="stable")
    moves = (points[order[: len(weights)]] - state.mean) / state.step
    move = weights @ moves
    spread, turn = np.linalg.eigh(state.covariance)
    whitened = turn @ ((turn.T @ move) / np.sqrt(np.maximum(spread, 1e-20)))
    step_path = (1 - cs) * state.step_path + math.sqrt(cs * (2 - cs) * mass) * whitened
    length = float(np.linalg.norm(step_path))
    # a path that grows fast would stretch the covariance while the step still adapts
    steady = length / math.sqrt(1 - (1 - cs) ** (2 * number)) < (1.4 + 2 / (n + 1)) * usual
    path = (1 - cc) * state.path + steady * math.sqrt(cc * (2 - cc) * mass) * move
    kept = 1 - c1 - cmu + (1 - steady) * c1 * cc * (2 - cc)
    covariance = kept * state.covariance + c1 * np.outer(path, path) + cmu * (moves.T * weights) @ moves
    step = state.step * math.exp(min(1.0, cs / damping * (length / usual - 1)))
    return State(state.mean + state.step * move, step, covariance, step_path, path)
