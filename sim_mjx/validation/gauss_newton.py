"""Least squares for physical parameters: Levenberg and Marquardt's steps, many of them tried at once.

Where residuals change with the parameters without jumps, their derivatives lead to the least sum of squares in far
fewer simulations than a search that only compares losses (:mod:`sim_mjx.validation.system_id`). A simulator that runs a
batch in the time of one run gets all differences in one batch, and a ladder of dampings in the next: from the plain
Gauss-Newton step to short ones down the slope, of which the best is taken.

Source: Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear Parameters", 1963.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from sim_mjx.validation.system_id import Search, Values, check, point_of, values_of

Residuals = Float64[np.ndarray, "candidate residual"]
Jacobian = Float64[np.ndarray, "residual parameter"]  # by shares of the ranges
Point = Float64[np.ndarray, " parameter"]  # of the unit cube that the bounds span
Objective = Callable[[list[Values]], Residuals]  # of some candidates, simulated together
INSIDE = 1e-3  # share of a range by which the first point keeps away from its ends
DAMPINGS = np.array([1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0])  # times the diagonal of the Gauss-Newton matrix
FLAT = 1e-6  # share of the largest entry of that diagonal that a parameter without effect counts with
LEAST_GAIN = 1e-3  # share of the loss; less is no progress
UNSEEN = 1e-12  # square of a parameter's part in what the residuals do not see; less is rounding
FINEST = 1e-3  # step of the differences below which the search ends


class Iteration(NamedTuple):
    """A point at which derivatives were taken."""

    candidates: int  # simulated so far
    loss: float  # sum of squares
    step: float  # of the differences, in widths of the ranges


@dataclass(frozen=True)
class LeastSquares:
    """A finished fit."""

    values: Values
    loss: float  # sum of squares
    candidates: int  # that were simulated, those of the differences among them
    iterations: list[Iteration]
    jacobian: Jacobian  # at the last point at which derivatives were taken
    at_bound: list[str]


def fit(
    objective: Objective,
    search: Search,
    *,
    iterations: int = 20,
    step: float = 0.02,
    progress: Callable[[Iteration, Values], None] | None = None,
) -> LeastSquares:
    """Find the parameters of the least sum of squares.

    Args:
        objective: residuals of candidates; called twice an iteration, for all differences and for all dampings.
        search: bounds and start; population, generations, spread and seed are not used.
        iterations: most points at which derivatives are taken.
        step: of the first differences, in widths of the ranges: wide enough to bridge the begin of single contacts.
            Whenever no damping lowers the loss enough, it is halved and its sign changes.
        progress: called with each point at which derivatives are taken.

    Raises:
        InputError: impossible bounds, start, step or number of iterations, or the start cannot be simulated.

    Example:
        >>> from sim_mjx.validation.system_id import Bound
        >>> line = lambda candidates: np.array([[v["slope"] * t + v["offset"] - 3 * t - 1 for t in (0.0, 1.0, 2.0)]
        ...                                     for v in candidates])
        >>> found = fit(line, Search({"slope": Bound(0.0, 10.0), "offset": Bound(-5.0, 5.0)}))
        >>> {name: round(value, 2) for name, value in found.values.items()}
        {'slope': 3.0, 'offset': 1.0}
    """
    report = None if progress is None else lambda _, at, values: progress(at, values)
    return fit_together(objective, [search], iterations=iterations, step=step, progress=report)[0]


def fit_together(
    objective: Objective,
    searches: Sequence[Search],
    *,
    iterations: int = 20,
    step: float = 0.02,
    progress: Callable[[int, Iteration, Values], None] | None = None,
) -> list[LeastSquares]:
    """Several fits at once, for example from several starts; their candidates share one batch at each step.

    Each result is that of :func:`fit` alone, if candidates of a batch do not depend on each other.

    Args:
        objective, iterations, step: as of :func:`fit`. searches: one per fit.
        progress: as of :func:`fit`, with the number of the fit as first argument.

    Raises:
        InputError: as of :func:`fit`, or no search is given.

    Example:
        >>> from sim_mjx.validation.system_id import Bound
        >>> from_two = [Search({"x": Bound(-2.0, 2.0)}, start={"x": x}) for x in (-1.5, 1.5)]
        >>> two_minima = lambda candidates: np.array([[v["x"] ** 2 - 1, 0.1 * (v["x"] - 1)] for v in candidates])
        >>> [round(found.values["x"], 1) for found in fit_together(two_minima, from_two)]
        [-1.0, 1.0]
    """
    if not searches:
        raise InputError("searches is empty; expected at least one search.")
    if iterations < 1 or not FINEST <= step <= 0.5:
        raise InputError(f"iterations is {iterations} and step {step}; expected at least 1, and {FINEST} to 0.5.")
    report = progress or (lambda *_: None)
    running = [_fit(search, iterations, step, partial(report, at)) for at, search in enumerate(searches)]
    done: dict[int, LeastSquares] = {}
    asked = {at: next(one) for at, one in enumerate(running)}
    while asked:
        batch = [values for at in asked for values in asked[at]]
        ends = np.cumsum([len(candidates) for candidates in asked.values()])
        found = np.split(np.asarray(objective(batch), np.float64), ends[:-1])
        answers, asked = dict(zip(asked, found, strict=True)), {}
        for at, residuals in answers.items():
            try:
                asked[at] = running[at].send(residuals)
            except StopIteration as end:
                done[at] = end.value
    return [done[at] for at in range(len(searches))]


def _fit(
    search: Search, iterations: int, step: float, progress: Callable[[Iteration, Values], None]
) -> Generator[list[Values], Residuals, LeastSquares]:
    """One fit: yields candidates and is sent their residuals."""
    check(search)
    point = np.clip(point_of(search), INSIDE, 1 - INSIDE)
    (here,) = yield [values_of(point, search.bounds)]
    if not np.isfinite(here).all():
        raise InputError("The simulation of the start gives no finite residuals; begin elsewhere.")
    count, width, sign, history = 1, step, 1.0, []
    jacobian = np.zeros((len(here), len(point)))
    for _ in range(iterations):
        history.append(Iteration(count, float(here @ here), width))
        progress(history[-1], values_of(point, search.bounds))
        forward = point + sign * width
        ahead = np.where((forward >= 0.0) & (forward <= 1.0), sign * width, -sign * width)
        beside = yield [values_of(one, search.bounds) for one in point + np.diag(ahead)]
        jacobian = ((beside - here) / ahead[:, None]).T
        tried = _steps(point, jacobian, here)
        found = yield [values_of(one, search.bounds) for one in tried]
        count += len(point) + len(tried)
        losses = np.where(np.isfinite(found).all(1), (found**2).sum(1), np.inf)
        best = int(np.argmin(losses))
        enough = losses[best] < (1 - LEAST_GAIN) * float(here @ here)
        if losses[best] < here @ here:
            point, here = tried[best], found[best]
        if not enough:
            width, sign = width / 2, -sign
            if width < FINEST:
                break
    ends = zip(search.bounds, point.tolist(), strict=True)
    at_bound = [name for name, share in ends if not INSIDE < share < 1 - INSIDE]
    return LeastSquares(values_of(point, search.bounds), float(here @ here), count, history, jacobian, at_bound)


def _steps(
    point: Point, jacobian: Jacobian, here: Float64[np.ndarray, " residual"]
) -> Float64[np.ndarray, "candidate parameter"]:
    """Points that the dampings lead to, in the cube: a parameter that would leave it stops at its end."""
    matrix, slope = jacobian.T @ jacobian, jacobian.T @ here
    scale = np.maximum(np.diag(matrix), FLAT * max(float(np.diag(matrix).max()), 1e-300))
    out = []
    for damping in DAMPINGS:
        free = np.ones(len(point), np.bool_)
        move = np.zeros(len(point))
        for _ in point:  # those that leave are held at their ends, and the others solved for again
            rest = slope + matrix[:, ~free] @ move[~free]
            damped = matrix[np.ix_(free, free)] + np.diag(damping * scale[free])
            move[free] = np.linalg.solve(damped, -rest[free])
            left = free & ((point + move < 0.0) | (point + move > 1.0))
            if not left.any():
                break
            move[left] = np.clip(point + move, 0.0, 1.0)[left] - point[left]
            free &= ~left
            if not free.any():
                break
        out.append(np.clip(point + move, 0.0, 1.0))
    return np.stack(out)


def identifiability(jacobian: Jacobian, names: list[str], loss: float, samples: float) -> dict[str, Any]:
    """How well the residuals determine the parameters, in shares of their ranges, from the Gauss-Newton matrix.

    Args:
        jacobian: of residuals whose squares sum to ``loss``. names: of its columns.
        loss: the remaining sum of squares.
        samples: number of independent residuals: an estimate, since those of neighbouring samples depend on each other.

    Returns:
        ``spectrum`` singular values, largest first; ``deviation`` the standard deviation that the residuals leave each
        parameter, None where they do not determine it; ``weakest`` the direction that they determine least, as its
        largest components.

    Example:
        >>> found = identifiability(np.array([[1.0, 1.0], [1.0, 1.0], [0.5, 0.0]]), ["a", "b"], 0.01, 10.0)
        >>> [round(value, 2) for value in found["spectrum"]], found["weakest"]
        ([2.03, 0.35], {'b': 0.73, 'a': -0.68})
    """
    wide = len(jacobian) < len(names)  # of many residuals, the full left vectors would fill the memory
    _, found, turned = np.linalg.svd(jacobian, full_matrices=wide)
    spectrum = np.concatenate([found, np.zeros(len(names) - len(found))])  # of fewer residuals than parameters
    seen = spectrum > np.finfo(np.float64).eps * max(jacobian.shape) * spectrum[0]
    noise = loss / max(samples - len(names), 1.0)
    variance = noise * (turned[seen] ** 2 / spectrum[seen, None] ** 2).sum(0)
    variance[(turned[~seen] ** 2).sum(0) > UNSEEN] = np.inf
    last = turned[-1] * np.sign(turned[-1][np.argmax(np.abs(turned[-1]))])
    order = np.argsort(-np.abs(last))[:5]
    return {
        "spectrum": spectrum.tolist(),
        "deviation": {
            name: float(np.sqrt(value)) if np.isfinite(value) else None
            for name, value in zip(names, variance.tolist(), strict=True)
        },
        "weakest": {names[i]: round(float(last[i]), 2) for i in order if abs(last[i]) >= 0.1},
    }
