"""Black-box search for a handful of physical parameters: CMA-ES, a whole population per evaluation, resumable.

The search (``rcbht_jax._util.cma``) runs in the unit cube spanned by the bounds; a candidate beyond a bound is
mirrored back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from rcbht_jax._util import checkpoint as checkpoint_file
from rcbht_jax._util import cma
from rcbht_jax._util.cma import State
from rcbht_jax.errors import InputError

Points = Float64[np.ndarray, "_candidate _parameter"]
Losses = Float64[np.ndarray, " candidate"]  # NaN = worse than any number
Values = dict[str, float]
Objective = Callable[[list[Values]], Losses]  # of a population


class Bound(NamedTuple):
    """Range of one parameter."""

    low: float
    high: float
    log: bool = False  # search its logarithm: for what varies by factors


@dataclass(frozen=True)
class Search:
    """How to search. Everything here decides the result, and nothing else does."""

    bounds: dict[str, Bound]
    population: int = 16  # candidates per generation
    generations: int = 40
    seed: int = 0
    start: Values = field(default_factory=dict)  # first mean; the middle of its range where a parameter has none
    spread: float = 0.25  # first standard deviation, in widths of the ranges
    about: dict[str, Any] = field(default_factory=dict)  # what the objective is (JSON): a resumed one must be the same


class Generation(NamedTuple):
    """Outcome of one generation."""

    number: int  # from 1
    best: float  # lowest loss in it
    median: float  # of its finite losses
    step: float  # of the search, in widths of the ranges


@dataclass(frozen=True)
class Fit:
    """A finished or interrupted search."""

    values: Values  # the best parameters
    loss: float
    generations: list[Generation]


def fit(
    objective: Objective,
    search: Search,
    *,
    checkpoint: Path | None = None,
    progress: Callable[[Generation, Fit], None] | None = None,
) -> Fit:
    """Search for the parameters of the lowest loss.

    Args:
        objective: losses of a population; called once per generation.
        search: bounds and settings.
        checkpoint: file that is replaced after every generation; an existing one is resumed, and the outcome is
            that of a search without interruption.
        progress: called after every generation.

    Raises:
        InputError: impossible settings, or the checkpoint is damaged or belongs to another search.
    """
    check(search)
    state, best = cma.start(point_of(search), search.spread), Fit({}, math.inf, [])
    if checkpoint is not None:
        state, best = _load(checkpoint, search) or (state, best)
    for number in range(len(best.generations) + 1, search.generations + 1):
        points = _ask(state, search, number)
        candidates = [values_of(point, search.bounds) for point in _mirrored(points)]
        losses = np.asarray(objective(candidates), np.float64)
        if losses.shape != (search.population,):
            raise ValueError(f"the objective gave {losses.shape} losses for {search.population} candidates")
        state = cma.update(state, points, losses, number)
        finite = losses[np.isfinite(losses)] if np.isfinite(losses).any() else np.array([math.inf])
        generation = Generation(number, float(finite.min()), float(np.median(finite)), state.step)
        best = _better(best, candidates, losses, generation)
        if checkpoint is not None:
            _save(checkpoint, search, state, best)
        if progress is not None:
            progress(generation, best)
    if not best.values:
        raise InputError("No candidate of the search had a finite loss; widen the bounds.")
    return best


def check(search: Search) -> None:
    """Check the settings of a search.

    Raises:
        InputError: no parameters, an empty range, too small a population, or a start outside its range.
    """
    if not search.bounds:
        raise InputError("bounds is empty; expected those of at least one parameter.")
    if search.population < 4 or search.generations < 1 or not 0.0 < search.spread <= 1.0:
        raise InputError(
            f"population is {search.population}, generations {search.generations} and spread {search.spread}; expected "
            "at least 4, at least 1, and above 0 up to 1."
        )
    for name, (low, high, log) in search.bounds.items():
        if not (math.isfinite(low) and math.isfinite(high) and low < high and (low > 0 or not log)):
            raise InputError(f"The range of {name} is {low} to {high}; expected it increasing, and positive if log.")
    for name, value in search.start.items():
        if name not in search.bounds or not search.bounds[name].low <= value <= search.bounds[name].high:
            raise InputError(f"The search starts at {name} = {value}; expected a value within its range.")


def point_of(search: Search) -> Float64[np.ndarray, " _parameter"]:
    """Where a search begins, in the unit cube."""
    return np.array(
        [_share(search.start[name], b) if name in search.start else 0.5 for name, b in search.bounds.items()]
    )


def _share(value: float, bound: Bound) -> float:
    low, high, at = (math.log(x) if bound.log else x for x in (bound.low, bound.high, value))
    return (at - low) / (high - low)


def values_of(point: Float64[np.ndarray, " _parameter"], bounds: Mapping[str, Bound]) -> Values:
    """Parameters of a point of the unit cube."""
    out = {}
    for share, (name, (low, high, log)) in zip(point.tolist(), bounds.items(), strict=True):
        at = low * (high / low) ** share if log else low + (high - low) * share
        out[name] = min(max(at, low), high)
    return out


def _mirrored(points: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    """Points folded into the unit cube."""
    folded = np.mod(points, 2.0)
    return np.where(folded > 1.0, 2.0 - folded, folded)


def _ask(state: State, search: Search, number: int) -> Points:
    """A population, not yet mirrored; each generation has its own random stream."""
    spread, turn = np.linalg.eigh(state.covariance)
    normal = np.random.default_rng((search.seed, number)).normal(size=(search.population, len(state.mean)))
    return state.mean + state.step * (normal * np.sqrt(np.maximum(spread, 0.0))) @ turn.T


def _better(best: Fit, candidates: list[Values], losses: Losses, generation: Generation) -> Fit:
    history = [*best.generations, generation]
    if not generation.best < best.loss:
        return Fit(best.values, best.loss, history)
    return Fit(candidates[int(np.nanargmin(losses))], generation.best, history)


def _settings(search: Search) -> dict[str, Any]:
    """What must be the same when resuming, as JSON values; more generations may be added."""
    settings = asdict(search)
    settings.pop("generations")
    settings["bounds"] = {name: list(bound) for name, bound in search.bounds.items()}
    return settings


def _save(path: Path, search: Search, state: State, best: Fit) -> None:
    arrays = {name: np.asarray(value).tolist() for name, value in state._asdict().items()}
    checkpoint_file.save(path, _settings(search), {"fit": asdict(best), "state": arrays})


def _load(path: Path, search: Search) -> tuple[State, Fit] | None:
    """State and best fit of an interrupted search; None if there is none."""
    content = checkpoint_file.load(path, _settings(search))
    if content is None:
        return None
    arrays = {name: np.array(value) for name, value in content["state"].items()}
    history = [Generation(*row) for row in content["fit"]["generations"]]
    return State(**arrays | {"step": content["state"]["step"]}), Fit(**content["fit"] | {"generations": history})
