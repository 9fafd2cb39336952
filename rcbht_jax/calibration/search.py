"""Search for thresholds: Sobol points, successive halving over the trials, CMA-ES around the best.

Evaluations are numbered, and the candidates depend only on the options and on earlier scores. The scores are written to
a checkpoint; an interrupted search replays it and resumes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.stats import qmc

import rcbht_jax
from rcbht_jax._util import checkpoint as files
from rcbht_jax._util import cma
from rcbht_jax._util.devices import in_turn
from rcbht_jax._util.digest import content_hash
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.label_durations import AXES, LABELS, label_durations
from rcbht_jax.calibration.objective import SCORES, Objective, scores
from rcbht_jax.calibration.rest import RestSlopes
from rcbht_jax.calibration.rest_runs import RANGE, RestRuns
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, gradients_of
from rcbht_jax.encoding.thresholds import GradientThresholds, preset, validate
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

Floats = NDArray[np.float64]
Scores = NDArray[np.float32]
TOLERANCES = (float(RANGE[0]), float(RANGE[-1]))  # least and largest of a search, in tolerances of its base
# Candidates x recordings encoded at once, which fit the cache of a core or fill a GPU, ...
_TOGETHER = {"cpu": (128, 1), "gpu": (4096, 8)}
_MOST = {"cpu": 2**28, "gpu": 2**31}  # ... and the memory limit for the times of a chunk of candidates, bytes


@dataclass(frozen=True)
class SearchSpace:
    """Ordered limits between multiples of a base, per axis or group of axes.

    By the fit rule, whose base is FitLimits, tolerances as well: between multiples (:data:`TOLERANCES`) of the base's.

    Raises:
        InputError: the groups are not six numbers counted from 0, the base is not ``[6, 4]`` and ordered, or not
            0 < low < high.

    Example:
        >>> space = SearchSpace(groups=(0, 0, 0, 1, 1, 1))
        >>> space.thresholds(np.full((2, space.dimensions), 0.5)).limits.shape
        (2, 6, 4)
        >>> space = SearchSpace(FitLimits(preset().limits, np.full(6, 0.5)), (0,) * 6)
        >>> space.dimensions, space.thresholds(np.full((2, 5), 0.5)).tolerance.shape
        (5, (2, 6))
    """

    base: AnyLimits = field(default_factory=preset)  # [6, 4]
    groups: tuple[int, ...] = (0, 1, 2, 3, 4, 5)  # axes with the same number share their position
    low: float = 0.05  # smallest limit / the base's small limit
    high: float = 4.0  # largest limit / the base's impulse limit

    def __post_init__(self) -> None:
        numbers = sorted(set(self.groups))
        if len(self.groups) != 6 or numbers != list(range(len(numbers))):
            raise InputError(f"The groups {self.groups} are not six numbers counted from 0, one for each axis.")
        if self.base_limits.shape != (6, 4) or not 0 < self.low < self.high:
            raise InputError(
                f"The base has limits {self.base_limits.shape}, low is {self.low} and high {self.high}; expected "
                "(6, 4) and 0 < low < high."
            )
        validate(self.base_limits)

    @property
    def base_limits(self) -> Float[np.ndarray, "6 4"]:
        """Gradient limits of the base, float64."""
        return np.asarray(gradients_of(self.base), np.float64)

    @property
    def dimensions(self) -> int:
        """Four for each group, by the fit rule five."""
        return self._each * (max(self.groups) + 1)

    @property
    def _each(self) -> int:
        return 5 if isinstance(self.base, FitLimits) else 4

    def thresholds(self, points: Float[np.ndarray, "candidate dimension"]) -> AnyLimits:
        """Candidates ``[candidate, 6, 4]`` at points of the unit cube; at the base's own point the base as it is."""
        place = points.reshape(len(points), -1, self._each)[:, self.groups]
        position = -np.sort(-place[..., :4], axis=-1)
        bottom, top = self._logarithms()
        limits = np.asarray(np.exp(bottom + position * (top - bottom)), np.float64)
        limits[(points == self.point(self.base)).all(1)] = self.base_limits  # whose axes may differ within a group
        if not isinstance(self.base, FitLimits):
            return GradientThresholds(limits)
        low, high = self._tolerances()
        return FitLimits(limits, np.asarray(np.exp(low + place[..., 4] * (high - low)), np.float64))

    def point(self, thresholds: AnyLimits) -> Float[np.ndarray, " dimension"]:
        """The point nearest to limits of six axes: the mean over the axes of a group."""
        bottom, top = self._logarithms()
        position = (np.log(gradients_of(thresholds)) - bottom) / (top - bottom)
        if isinstance(thresholds, FitLimits):
            low, high = self._tolerances()
            position = np.concatenate([position, ((np.log(thresholds.tolerance) - low) / (high - low))[:, None]], 1)
        position = np.clip(position, 0, 1)
        return np.concatenate(
            [position[np.array(self.groups) == group].mean(0) for group in range(max(self.groups) + 1)]
        )

    def _tolerances(self) -> list[Floats]:
        """Logarithms of the smallest and of the largest tolerance, ``[6]``."""
        assert isinstance(self.base, FitLimits)
        return [np.log(np.broadcast_to(self.base.tolerance, 6) * factor) for factor in TOLERANCES]

    def _logarithms(self) -> list[Floats]:
        """Of the lowest and of the highest limit, ``[6, 1]``."""
        return [np.log(self.base_limits[:, k] * factor)[:, None] for k, factor in ((3, self.low), (0, self.high))]


@dataclass(frozen=True)
class SearchOptions:
    """Space, objective and budget of a search."""

    space: SearchSpace = field(default_factory=SearchSpace)
    objective: Objective = field(default_factory=Objective)
    candidates: int = 4096  # Sobol points, of which the base replaces the first
    rungs: tuple[float, ...] = (1.0,)  # fraction of the trials in each round of successive halving, increasing to 1
    keep: float = 0.25  # fraction of the candidates that survives a round
    generations: int = 0  # of CMA-ES around the best point
    population: int = 32
    sigma: float = 0.1  # first step of CMA-ES, in the unit cube
    seed: int = 0

    def __post_init__(self) -> None:
        rungs = self.rungs
        if not rungs or rungs[-1] != 1.0 or list(rungs) != sorted(set(rungs)) or rungs[0] <= 0:
            raise InputError(f"The rungs are {rungs}; expected positive fractions that increase to 1.")
        if self.candidates < 1 or self.generations < 0 or self.population < 4 or not 0 < self.keep <= 1:
            raise InputError(
                f"The search has candidates {self.candidates}, generations {self.generations}, population "
                f"{self.population} and keep {self.keep}; expected at least 1, 0 and 4, and a fraction in (0, 1]."
            )

    def points(self) -> Float[np.ndarray, "candidate dimension"]:
        """The base, then scrambled Sobol points."""
        power = max(0, int(np.ceil(np.log2(self.candidates))))
        points = qmc.Sobol(self.space.dimensions, rng=self.seed).random_base2(power)[: self.candidates]
        points[0] = self.space.point(self.space.base)
        return points


@dataclass(frozen=True)
class SearchResult:
    """The best thresholds of a search."""

    thresholds: AnyLimits  # [6, 4]
    value: float  # weighted sum of the scores, less the penalty of rest
    scores: dict[str, float]  # by name, see SCORES
    start_value: float  # value of the base
    start_scores: dict[str, float]  # of the base
    evaluations: int
    history: list[tuple[int, float, float]]  # evaluations, seconds, best value so far on all trials


def score_candidates(
    data: CalibrationData,
    config: AnyConfig,
    thresholds: AnyLimits,
    *,
    chunk: int | None = None,
    group: int | None = None,
    devices: Sequence[jax.Device] | None = None,
    progress: Callable[[int, Scores], None] | None = None,
) -> Float[np.ndarray, "candidate score"]:
    """Scores of candidate thresholds, float32 in the order of :data:`rcbht_jax.calibration.objective.SCORES`.

    Args:
        data: sentences and their classes.
        config: static configuration of the encoder; its type chooses the rule.
        thresholds: candidates ``[candidate, 6, 4]``, of the fit rule FitLimits.
        chunk: candidates encoded at once, which bounds memory; the result does not depend on it.
        group: recordings encoded at once; the result does not depend on it.
        devices: that take turns with the chunks, all of one kind; the result does not depend on how many there are.
            None = where the data are, or JAX's default device.
        progress: called after each chunk with the index of its first candidate and its scores.

    Raises:
        InputError: a candidate is not ordered, positive and finite.
    """
    limits = checked_limits(config, thresholds)
    backend = "cpu" if jax.default_backend() == "cpu" else "gpu"
    given, places = (data.signal(config), data.edges, data.y), devices or (None,)
    turns = [(place, *jax.device_put(given, place)) for place in places]
    # a power of two, so that few sizes are compiled
    chunk = min(chunk or _chunk(backend, data), 1 << (-(-len(limits) // len(turns)) - 1).bit_length())
    group = group or min(max(1, math.prod(_TOGETHER[backend]) // chunk), len(data))
    dtype = data.windows.slope.dtype

    def scored(start: int, place: jax.Device | None, signal: Any, edges: Array, y: Array) -> Scores:
        """Scores of one chunk, by a device."""
        some = limits[start : start + chunk].astype(dtype)
        padded = np.concatenate([some, np.repeat(some[-1:], chunk - len(some), 0)])
        times = label_durations(config, jax.device_put(padded, place), signal, edges, group=group)
        return scores(times, y, len(data.classes))[: len(some)]

    starts = range(0, len(limits), chunk)
    tasks = [partial(scored, start, *turns[number % len(turns)]) for number, start in enumerate(starts)]
    out = list[Scores]()
    for start, found in zip(starts, in_turn(tasks, len(turns)), strict=True):
        out.append(found)
        if progress is not None:
            progress(start, found)
    return np.concatenate(out)


def _chunk(backend: str, data: CalibrationData) -> int:
    """Candidates at once, a power of two, whose times fit the memory limit."""
    bytes_each = 4 * data.y.size * AXES * LABELS
    return min(_TOGETHER[backend][0], 1 << max(0, (_MOST[backend] // bytes_each).bit_length() - 1))


@dataclass
class _Run:
    """Numbered evaluations, whose scores come from the checkpoint where it has them."""

    data: CalibrationData
    config: AnyConfig
    options: SearchOptions
    stored: ScoreCheckpoint
    chunk: int | None
    devices: Sequence[jax.Device] | None
    rest: RestSlopes | RestRuns | None
    progress: Callable[[int], None] | None
    number: int = 0
    history: list[tuple[int, float, float]] = field(default_factory=list)
    start: float = field(default_factory=time.perf_counter)

    def __call__(self, points: Floats, trials: float = 1.0) -> tuple[Scores, Floats]:
        """Scores and objectives of points, on a fraction of the trials."""
        known = self.stored.read(self.number, len(points))
        done = len(known)
        if self.progress is not None and done:
            self.progress(done)
        if done < len(points):
            part = self.data if trials == 1 else self.data.take(self._rows(trials))
            candidates = self.options.space.thresholds(points[done:])
            new = score_candidates(
                part, self.config, candidates, chunk=self.chunk, devices=self.devices, progress=self._keep
            )
            known = np.concatenate([known, new])
        self.number += len(points)
        return known, self._values(known, points)

    def _rows(self, trials: float) -> NDArray[np.int64]:
        shuffled = np.random.default_rng(self.options.seed).permutation(len(self.data))
        rows = np.sort(shuffled[: max(2, round(trials * len(shuffled)))])
        if len(np.unique(jax.device_get(self.data.y)[rows])) < 2:
            raise InputError(
                f"The {len(rows)} trials of the rung {trials:g} have a single class, by which nothing can be "
                "chosen; use a larger rung, or another seed."
            )
        return rows

    def _keep(self, _: int, new: Scores) -> None:
        self.stored.write(new)
        if self.progress is not None:
            self.progress(len(new))

    def _values(self, scores: Scores, points: Floats) -> Floats:
        """Weighted sum less the penalty, rounded so that ties do not depend on the last bit of a device."""
        value = scores.astype(np.float64) @ self.options.objective.weights()
        if self.rest is not None:
            value = value - self.rest.penalty(self.options.space.thresholds(points))
        return np.asarray(value.round(6))

    def note(self, best: float) -> None:
        self.history.append((self.number, time.perf_counter() - self.start, best))


def search(
    data: CalibrationData,
    config: AnyConfig,
    options: SearchOptions,
    *,
    chunk: int | None = None,
    devices: Sequence[jax.Device] | None = None,
    checkpoint: Path | None = None,
    progress: Callable[[int], None] | None = None,
    rest: RestSlopes | RestRuns | None = None,
) -> SearchResult:
    """The thresholds with the highest objective; ties go to the candidate evaluated first.

    Objectives are compared to six digits. They are sums in single precision, whose sixth digit depends on the order of
    the trials: the same trials in another order may choose another of the candidates that are as good.

    Args:
        data: training trials only.
        config: static configuration of the encoder.
        options: space, objective and budget.
        chunk: candidates encoded at once; the result does not depend on it.
        devices: that share the work, see :func:`score_candidates`.
        checkpoint: file for the scores, from which a search with the same data and options resumes.
        progress: called with the number of candidates done since the last call.
        rest: its penalty is subtracted from the objective of a candidate that does not label rest as constant.

    Raises:
        InputError: the checkpoint is damaged or belongs to another search, or there are fewer than two classes, in all
            trials or in those of a rung.
    """
    if len(np.unique(jax.device_get(data.y))) < 2:
        raise InputError("Thresholds can only be searched on sentences of at least two classes.")
    made_by = None if checkpoint is None else _made_by(data, config, options, rest)
    run = _Run(data, config, options, ScoreCheckpoint(checkpoint, made_by), chunk, devices, rest, progress)
    points = options.points()
    for rung in options.rungs:
        scores, values = run(points, rung)
        if rung < 1:
            survivors = np.sort(np.argsort(-values, kind="stable")[: max(1, int(len(points) * options.keep))])
            points = points[np.union1d([0], survivors)]  # the base stays, for comparison
    start, index = (float(values[0]), scores[0]), int(values.argmax())
    best = points[index], scores[index], values[index]
    run.note(float(best[2]))
    state = cma.CubeCma(cma.start(best[0], options.sigma))
    for _ in range(options.generations):
        points = state.sample(options.population, options.seed)
        scores, values = run(points)
        state = state.update(points, values)
        index = int(values.argmax())
        if values[index] > best[2]:
            best = points[index], scores[index], values[index]
        run.note(float(best[2]))
    return SearchResult(
        thresholds=jax.tree.map(lambda leaf: leaf[0], options.space.thresholds(best[0][None])),
        value=float(best[2]),
        scores=dict(zip(SCORES, best[1].tolist(), strict=True)),
        start_value=start[0],
        start_scores=dict(zip(SCORES, start[1].tolist(), strict=True)),
        evaluations=run.number,
        history=run.history,
    )


def _made_by(
    data: CalibrationData, config: AnyConfig, options: SearchOptions, rest: RestSlopes | RestRuns | None
) -> dict[str, Any]:
    """Everything that the scores depend on, and which candidates are scored."""
    plain: dict[str, Any] = asdict(options)
    base = options.space.base
    plain["space"]["base"] = checked_limits(config, base).tolist()
    version = rcbht_jax.__version__  # of the encoder and the scores
    made = {"data": data.fingerprint(), "encoder": asdict(config), "options": plain, "version": version}
    return made if rest is None else made | {"rest": content_hash([np.asarray(x) for x in vars(rest).values()])}


class ScoreCheckpoint:
    """Scores ``[evaluation, score]`` in order; in memory only when there is no path.

    Args:
        path: file to resume from and to write, JSON.
        made_by: everything that the scores depend on (JSON value).

    Raises:
        InputError: the file is no checkpoint or belongs to another search.
    """

    def __init__(self, path: Path | None, made_by: Any = None) -> None:
        self._path, self._made_by = path, made_by
        self._scores = np.zeros((0, len(SCORES)), np.float32)
        if stored := None if path is None else files.load(path, made_by):
            try:
                self._scores = np.concatenate([self._scores, np.array(stored, np.float32)])
            except (TypeError, ValueError):
                raise InputError(f"{path} has no scores of a search; delete it to start again.") from None

    def read(self, first: int, count: int) -> Scores:
        """Known scores of evaluations ``first`` and following, at most ``count``."""
        return self._scores[first : first + count]

    def write(self, scores: Scores) -> None:
        """Append scores of evaluations."""
        self._scores = np.concatenate([self._scores, scores])
        if self._path is not None:
            files.save(self._path, self._made_by, self._scores.tolist())
