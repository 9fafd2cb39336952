"""Search for thresholds: Sobol points, successive halving over the trials, CMA-ES around the best.

Every evaluation has a number, and what is evaluated depends only on the options and on earlier scores. The
scores are kept in a ledger; an interrupted search replays it and goes on where it stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from rcbht_jax._util import checkpoint
from rcbht_jax.calibration.cma import Cma
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.label_durations import AXES, LABELS, label_durations
from rcbht_jax.calibration.objective import SCORES, Objective, scores
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError

Floats = NDArray[np.float64]
# Candidates x recordings encoded at once: as much as fits a core's cache, or fills a GPU; ...
_TOGETHER = {"cpu": (128, 1), "gpu": (4096, 8)}
_MOST = {"cpu": 2**28, "gpu": 2**31}  # ... and bytes that the times of a chunk of candidates may take


@dataclass(frozen=True)
class SearchSpace:
    """Where thresholds are looked for: ordered limits between multiples of a base, per axis or group of axes."""

    base: Floats = field(default_factory=lambda: np.asarray(preset().limits, np.float64))  # [6, 4]
    groups: tuple[int, ...] = (0, 1, 2, 3, 4, 5)  # axes with the same number share their position
    low: float = 0.05  # smallest limit, times the base's small one
    high: float = 4.0  # largest limit, times the base's impulse one

    def __post_init__(self) -> None:
        numbers = sorted(set(self.groups))
        if len(self.groups) != 6 or numbers != list(range(len(numbers))):
            raise InputError(f"the groups {self.groups} are not six numbers counted from 0, one for each axis.")
        if self.base.shape != (6, 4) or not 0 < self.low < self.high:
            raise InputError("a search needs base limits [6, 4] and factors with 0 < low < high.")

    @property
    def dimensions(self) -> int:
        """Four for each group."""
        return 4 * (max(self.groups) + 1)

    def limits(self, points: Floats) -> Floats:
        """GradientThresholds ``[candidate, 6, 4]`` of points ``[candidate, dimensions]`` in the unit cube."""
        position = -np.sort(-points.reshape(len(points), -1, 4), axis=-1)[:, self.groups]
        bottom, top = (np.log(self.base[:, k] * f)[:, None] for k, f in ((3, self.low), (0, self.high)))
        return np.asarray(np.exp(bottom + position * (top - bottom)), np.float64)

    def point(self, limits: Floats) -> Floats:
        """The point ``[dimensions]`` nearest to thresholds ``[6, 4]``: the mean over the axes of a group."""
        bottom, top = (np.log(self.base[:, k] * f)[:, None] for k, f in ((3, self.low), (0, self.high)))
        position = np.clip((np.log(limits) - bottom) / (top - bottom), 0, 1)
        return np.concatenate(
            [position[np.array(self.groups) == group].mean(0) for group in range(max(self.groups) + 1)]
        )


@dataclass(frozen=True)
class SearchOptions:
    """How long and where to look."""

    space: SearchSpace = field(default_factory=SearchSpace)
    objective: Objective = field(default_factory=Objective)
    candidates: int = 4096  # Sobol points, the base among them
    rungs: tuple[float, ...] = (1.0,)  # share of the trials in each round of successive halving, increasing to 1
    keep: float = 0.25  # share of the candidates that survives a round
    generations: int = 0  # of CMA-ES around the best point
    population: int = 32
    sigma: float = 0.1  # first step of CMA-ES, in the unit cube
    seed: int = 0

    def __post_init__(self) -> None:
        rungs = self.rungs
        if not rungs or rungs[-1] != 1.0 or list(rungs) != sorted(set(rungs)) or rungs[0] <= 0:
            raise InputError(f"the rungs {rungs} do not increase to 1.")
        if self.candidates < 1 or self.generations < 0 or self.population < 4 or not 0 < self.keep <= 1:
            raise InputError("a search needs candidates, a population of at least 4 and a share to keep in (0, 1].")

    def points(self) -> Floats:
        """The base, then scrambled Sobol points ``[candidates, dimensions]``."""
        power = max(0, int(np.ceil(np.log2(self.candidates))))
        points = qmc.Sobol(self.space.dimensions, rng=self.seed).random_base2(power)[: self.candidates]
        points[0] = self.space.point(self.space.base)
        return points


@dataclass(frozen=True)
class SearchResult:
    """The best thresholds of a search."""

    thresholds: GradientThresholds  # [6, 4]
    value: float  # weighted sum of the scores
    scores: dict[str, float]
    start_value: float  # value of the base
    evaluations: int
    history: list[tuple[int, float, float]]  # evaluations, seconds, best value so far on all trials


def score_candidates(
    corpus: CalibrationData,
    config: EncoderConfig,
    limits: Floats,
    *,
    chunk: int | None = None,
    group: int | None = None,
    progress: Callable[[int, NDArray[np.float32]], None] | None = None,
) -> NDArray[np.float32]:
    """Scores ``[candidate, score]`` of thresholds ``[candidate, 6, 4]`` on a corpus.

    Args:
        corpus: what to tell apart.
        config: static configuration of the encoder.
        limits: candidates.
        chunk: candidates encoded at once, which bounds memory; the result does not depend on it.
        group: recordings encoded at once; neither does it depend on this.
        progress: called after each chunk with the index of its first candidate and its scores.
    """
    backend = "cpu" if jax.default_backend() == "cpu" else "gpu"
    # few sizes, few compilations
    chunk = min(chunk or _chunk(backend, corpus), 1 << (len(limits) - 1).bit_length())
    group = group or min(max(1, math.prod(_TOGETHER[backend]) // chunk), len(corpus))
    windows, edges, y = jax.device_put((corpus.windows, corpus.edges, corpus.y))
    dtype = corpus.windows.slope.dtype
    out = []
    for start in range(0, len(limits), chunk):
        some = limits[start : start + chunk].astype(dtype)
        padded = np.concatenate([some, np.repeat(some[-1:], chunk - len(some), 0)])
        times = label_durations(config, jax.device_put(padded), windows, edges, group=group)
        out.append(scores(times, y, len(corpus.classes))[: len(some)])
        if progress is not None:
            progress(start, out[-1])
    return np.concatenate(out)


def _chunk(backend: str, corpus: CalibrationData) -> int:
    """Candidates at once, a power of two, so that their times fit."""
    bytes_each = 4 * corpus.y.size * AXES * LABELS
    return min(_TOGETHER[backend][0], 1 << max(0, (_MOST[backend] // bytes_each).bit_length() - 1))


class _Run:
    """Numbered evaluations through the ledger."""

    def __init__(
        self,
        corpus: CalibrationData,
        config: EncoderConfig,
        options: SearchOptions,
        ledger: ScoreCheckpoint,
        chunk: int | None,
    ):
        self.corpus, self.config, self.options, self.ledger, self.chunk = corpus, config, options, ledger, chunk
        self.weights = options.objective.weights()
        self.number = 0
        self.history: list[tuple[int, float, float]] = []
        self.start = time.perf_counter()

    def __call__(self, points: Floats, trials: float, progress: Callable[[int], None] | None) -> NDArray[np.float32]:
        rows = np.arange(len(self.corpus))
        if trials < 1:
            shuffled = np.random.default_rng(self.options.seed).permutation(len(rows))
            rows = np.sort(shuffled[: max(2, round(trials * len(rows)))])
        first = self.number
        known = self.ledger.read(first, len(points))
        done = len(known)
        limits = self.options.space.limits(points)

        def keep(start: int, made: NDArray[np.float32]) -> None:
            self.ledger.write(first + done + start, made)
            if progress is not None:
                progress(len(made))

        if progress is not None and done:
            progress(done)
        if done < len(points):
            part = self.corpus if trials == 1 else self.corpus.take(rows)
            made = score_candidates(part, self.config, limits[done:], chunk=self.chunk, progress=keep)
            known = np.concatenate([known.reshape(-1, made.shape[1]), made])
        self.number += len(points)
        return known

    def values(self, made: NDArray[np.float32]) -> Floats:
        """Weighted sum, rounded so that no device decides a tie by its last bit."""
        return np.asarray((made.astype(np.float64) @ self.weights).round(6))

    def note(self, best: float) -> None:
        best = max(best, self.history[-1][2] if self.history else -np.inf)
        self.history.append((self.number, time.perf_counter() - self.start, best))


def search(
    corpus: CalibrationData,
    config: EncoderConfig,
    options: SearchOptions,
    *,
    chunk: int | None = None,
    ledger: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> SearchResult:
    """The best thresholds for a corpus; ties go to the candidate evaluated first.

    Args:
        corpus: training trials only.
        config: static configuration of the encoder.
        options: how long and where to look.
        chunk: candidates encoded at once; the result does not depend on it.
        ledger: file that keeps the scores; a search with the same corpus and options goes on from it.
        progress: called with the number of candidates done since the last call.

    Raises:
        InputError: the checkpoint is damaged or belongs to another search, or the corpus has fewer than two classes.
    """
    if len(np.unique(jax.device_get(corpus.y))) < 2:
        raise InputError("thresholds can only be searched on sentences of at least two classes.")
    run = _Run(
        corpus,
        config,
        options,
        ScoreCheckpoint(ledger, None if ledger is None else _made_by(corpus, config, options)),
        chunk,
    )
    points = options.points()
    for rung in options.rungs:
        made = run(points, rung, progress)
        values = run.values(made)
        if rung < 1:
            survivors = np.sort(np.argsort(-values, kind="stable")[: max(1, int(len(points) * options.keep))])
            points = points[np.union1d([0], survivors)]  # the base stays, to be compared with
    best = int(values.argmax())
    run.note(float(values[best]))
    found = points[best], made[best], values[best]
    state = Cma.start(found[0], options.sigma)
    for _ in range(options.generations):
        points = state.sample(options.population, options.seed)
        made = run(points, 1.0, progress)
        state = state.update(points, run.values(made))
        best = int(run.values(made).argmax())
        if run.values(made)[best] > found[2]:
            found = points[best], made[best], run.values(made)[best]
        run.note(float(found[2]))
    return SearchResult(
        thresholds=GradientThresholds(options.space.limits(found[0][None])[0]),
        value=float(found[2]),
        scores=dict(zip(SCORES, found[1].tolist(), strict=True)),
        start_value=float(values[0]),
        evaluations=run.number,
        history=run.history,
    )


def _made_by(corpus: CalibrationData, config: EncoderConfig, options: SearchOptions) -> dict[str, Any]:
    """Everything that the scores depend on."""
    plain: dict[str, Any] = asdict(options)
    plain["space"]["base"] = options.space.base.tolist()
    return {"data": corpus.fingerprint(), "encoder": asdict(config), "options": plain}


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
        stored = None if path is None else checkpoint.load(path, made_by)
        self._scores = np.zeros((0, 0), np.float32) if stored is None else np.array(stored, np.float32)

    def read(self, first: int, count: int) -> NDArray[np.float32]:
        """Scores of the evaluations ``first`` ... that are known, at most ``count``."""
        return self._scores[first : first + count]

    def write(self, first: int, scores: NDArray[np.float32]) -> None:
        """Append the scores of the evaluations ``first`` ...; they follow the last known one."""
        if first != len(self._scores):
            raise ValueError(f"evaluation {first} does not follow the {len(self._scores)} known ones")
        self._scores = np.concatenate([self._scores.reshape(-1, scores.shape[1]), scores])
        if self._path is not None:
            checkpoint.save(self._path, self._made_by, self._scores.tolist())
