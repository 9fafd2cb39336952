"""Monitors that learn from successes alone: an anomaly score at every sample, and a threshold with few false alarms.

A monitor is trained on nominal recordings of one skill only. At time t its score is the distance of the last moments
from those of nominal recordings around t; it uses no later sample. The threshold is a conformal quantile (Vovk et al.
2005; Angelopoulos and Bates 2023, section 1) of the peak scores of nominal recordings that the score was not learned
from, so false alarms are counted per recording and not per sample.

:class:`NominalMonitor` compares with the nearest nominal recordings, channel by channel; see
:mod:`rcbht_jax.introspection.nominal_peers` for other monitors with the same interface.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import plural
from rcbht_jax._util.selection import group_numbers
from rcbht_jax._util.signals import (
    block_means,
    check_learned,
    moving_mean,
    period,
    read_parts,
    read_signal,
    warn_if_turned,
    whole_series,
)
from rcbht_jax._util.values import Copyable, number
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.alarms import check_calibration, check_groups, conformal_threshold, first_above, held_half
from rcbht_jax.introspection.neighbours import Bank, distances, make_bank, nearest, unbiased
from rcbht_jax.learning.estimators import keep_names

with needs_extra("learn"):
    from sklearn.base import BaseEstimator, clone
    from sklearn.utils.validation import check_is_fitted

Channels = Float[np.ndarray, "_ channel"]
Described = Float[np.ndarray, "time _ kind"]
Times = Int[np.ndarray, " time"]
Scores = Float[np.ndarray, " time"]

FREEDOM = 3.0  # degrees of freedom of the Student t whose negative logarithm is the surprise


@dataclass(kw_only=True, eq=False, repr=False)
class Monitor(BaseEstimator):  # type: ignore[misc]
    """Base of all monitors: time, calibration, alarms and streams; a subclass learns and scores.

    Args:
        rate: samples per second of the recordings.
        score_rate: scores per second, at most ``rate``; samples between two scores are averaged.
        memory: s over which the score is averaged.
        calibration: ``"cross"``: every nominal recording is scored by the other groups, and the final monitor is
            trained on all. ``"split"``: a random half trains, the other half sets the threshold. The guarantee of
            :meth:`threshold` is exact for ``"split"``.
        folds: largest number of groups left out in turn; more groups are distributed over this many folds.
        random_state: seed of the split and of randomness in the score.

    Attributes:
        n_features_in_: axes of a recording.
        feature_names_in_: their names ``[axis]``, only where pandas or xarray gave them to ``fit``.
        peaks_: largest scores ``[recording]`` of the nominal recordings that set the threshold.
    """

    rate: Any = 20.0
    score_rate: Any = 20.0
    memory: Any = 0.5
    calibration: Any = "cross"
    folds: Any = 10
    random_state: Any = 0

    _least: ClassVar = {"rate": 1e-9, "score_rate": 1e-9, "memory": 1e-9, "folds": 2}  # smallest value of a parameter

    def fit(self, X: Any, y: Any = None, groups: ArrayLike | None = None) -> Monitor:
        """Learn from nominal recordings of one skill, each from the beginning of the skill.

        Args:
            X: recordings ``[time, axis]`` of any lengths, all nominal; NumPy, JAX, pandas or xarray, read as by
                :func:`rcbht_jax.encode`.
            y: not used.
            groups: day or session of each; the score is made insensitive to differences between groups, and the
                threshold covers them. None = each recording is a group of its own.

        Raises:
            InputError: fewer than three recordings, a single one outside a group, wrong shapes, different axes, values
                that are not finite, a time that disagrees with the rate, or bad parameters; what was fitted stays.
        """
        fitted = clone(self)._fitted(X, groups)  # a fit that fails leaves what was fitted before
        keep_names(self, None)
        self.__dict__.update(vars(fitted))
        return self

    def _fitted(self, X: Any, groups: ArrayLike | None) -> Monitor:
        check_calibration(self.calibration)
        self._check()
        read, axes = read_parts(X, period(self.rate), dtype=np.float64)
        series = [whole_series(part) for part in read]
        if len(series) < 3 or len({part.shape[1] for part in series}) > 1:
            raise InputError(
                f"{plural(len(series), 'recording')}; it takes three or more nominal ones with the same axes."
            )
        warn_if_turned(X, max(map(len, series)), series[0].shape[1], axes)
        everyone = np.arange(len(series))
        given = everyone if groups is None else np.asarray(groups)
        if given.shape != (len(series),):
            raise InputError(f"Groups have the shape {given.shape}; expected one for each of {len(series)} recordings.")
        names = group_numbers(given)
        given, names = (given, names) if names.any() else (everyone, everyone)
        parts, self.n_features_in_ = [block_means(part, self.score_step) for part in series], series[0].shape[1]
        if self.calibration == "split":
            held = held_half(everyone, self.random_state)
            train = np.setdiff1d(everyone, held)
            half = [parts[row] for row in train], names[train]
            self._prepare(*half)  # what the held-out half had a part in would void its guarantee
            model = self._learn(*half)
            peaks = np.array([self._peak(model, parts[row]) for row in held])
        else:
            check_groups(given, names % int(self.folds))
            self._prepare(parts, names)
            peaks = self._cross_peaks(model := self._learn(parts, names), parts, names)
        self._model, self.peaks_ = model, peaks
        keep_names(self, axes)
        return self

    def scores(self, series: ArrayLike) -> Float[np.ndarray, " time"]:
        """Anomaly score at every sample of a recording ``[time, axis]``, from this and earlier samples.

        Raises:
            InputError: other axes than in :meth:`fit`, or values that are not finite.
        """
        return self.stream().push(series)

    def threshold(self, alpha: float = 0.05) -> float:
        """Score that a new nominal recording exceeds at any time with a probability of at most ``alpha``.

        With ``calibration="split"`` this holds for any finite number of recordings, on average over fits, if the new
        recording and those of the held-out half are exchangeable. With ``"cross"`` it is not proved; simulations agree
        (docs/howto/monitor.md). Longer recordings and those of a new day are not exchangeable: measure their alarms.

        Raises:
            InputError: fewer than 1 / ``alpha`` - 1 recordings set the threshold.
        """
        check_is_fitted(self, "peaks_")
        return conformal_threshold(self.peaks_, alpha)

    def detect(self, series: ArrayLike, alpha: float = 0.05) -> float:
        """Seconds from the beginning of a recording to the alarm; inf = none.

        Raises:
            InputError: as :meth:`threshold` and :meth:`scores`.
        """
        return first_above(self.scores(series), self.threshold(alpha), self.rate)

    def stream(self) -> MonitorStream:
        """A new recording, sample by sample."""
        check_is_fitted(self, "peaks_")
        return MonitorStream(self)

    @property
    def score_step(self) -> int:
        """Samples that are averaged for a score."""
        return max(round(self.rate / self.score_rate), 1)

    def _count(self, seconds: float) -> int:
        """Scores within so many seconds, at least one."""
        return max(round(seconds * self.rate / self.score_step), 1)

    def _check(self) -> None:
        for name, least in self._least.items():
            if not least <= number(name, getattr(self, name)) <= 1e9:
                raise InputError(f"{name} is {getattr(self, name)}; expected {least:g} to 1e+09.")

    def _cross_peaks(
        self, model: Any, parts: list[Channels], groups: Int[np.ndarray, " recording"]
    ) -> Float[np.ndarray, " recording"]:
        """Peak of each recording, scored by what was learned from the other folds."""
        fold = groups % int(self.folds)
        peaks = np.zeros(len(parts))
        for held in np.unique(fold):
            rest = np.flatnonzero(fold != held)
            # A bank of fewer groups has larger usual distances between groups: in units of these, peaks are too small.
            other = model.take(rest) if isinstance(model, Bank) else self._learn([parts[i] for i in rest], groups[rest])
            for row in np.flatnonzero(fold == held):
                peaks[row] = self._peak(other, parts[row])
        return peaks

    def _peak(self, model: Any, part: Float[np.ndarray, "time channel"]) -> float:
        return float(MonitorStream(self, model).advance(part).max())

    @property
    def _longest_head(self) -> float:
        return 0.0

    @property
    def _lags(self) -> list[int]:
        return []

    def _describe(self, part: Channels, head: Channels, before: Channels, time: Times) -> Described:
        """The features that the score reads at each moment: by default the values themselves."""
        return part[..., None]

    def _prepare(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> None:
        """What is decided once, from the averaged nominal recordings ``[time, channel]`` of the final monitor."""

    @abstractmethod
    def _learn(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> Any:
        """A model from averaged nominal recordings ``[time, channel]``."""

    @abstractmethod
    def _score(self, model: Any, described: Described, time: Times) -> Scores:
        """Score of each moment by itself, before it is averaged over ``memory``."""


class MonitorStream(Copyable):
    """Scores of one recording as it arrives; they equal those of the whole recording, whatever the chunks.

    The ``model`` scores; None = the one that the monitor has learned.

    >>> rng = np.random.default_rng(0)
    >>> monitor = NominalMonitor().fit(rng.normal(size=(8, 60, 2)))
    >>> stream, series = monitor.stream(), rng.normal(size=(50, 2))
    >>> in_pieces = np.concatenate([stream.push(series[:7]), stream.push(series[7:])])
    >>> bool((in_pieces == monitor.scores(series)).all())
    True
    """

    _fixed = ("_monitor", "_model")

    def __init__(self, monitor: Monitor, model: Any = None) -> None:
        self._monitor, axes = monitor, monitor.n_features_in_
        self._model = monitor._model if model is None else model
        self._samples = np.zeros((0, axes))  # of a block that is not complete
        self._head = np.zeros((0, axes))  # the first blocks
        self._before = np.zeros((0, axes))  # the latest blocks
        self._recent = np.zeros(0)  # scores that are still averaged
        self._time, self._last = 0, 0.0

    def push(self, samples: ArrayLike) -> Float[np.ndarray, " time"]:
        """Scores at new samples ``[time, axis]``; 0 before the first score.

        Raises:
            InputError: other axes than those learned, values that are not finite, or a time that disagrees with the
                rate.
        """
        monitor = self._monitor
        read, names = read_signal(samples, 1 / float(monitor.rate))
        new = whole_series(np.asarray(read, np.float64), least=0)
        check_learned(names, monitor, "The samples")
        if new.shape[1] != monitor.n_features_in_:
            axes = plural(new.shape[1], "axis", "axes")
            raise InputError(f"The samples have {axes}; the monitor learned {monitor.n_features_in_}.")
        waiting, step = len(self._samples), monitor.score_step
        joined = np.concatenate([self._samples, new])
        whole = len(joined) // step * step
        self._samples = joined[whole:]
        means = [self._last, *self.advance(block_means(joined[:whole], step))] if whole else [self._last]
        self._last = float(means[-1])
        return np.array(means, np.float64)[(waiting + 1 + np.arange(len(new))) // step]

    def advance(self, part: Float[np.ndarray, "time channel"]) -> Float[np.ndarray, " time"]:
        """Scores of new averaged samples, one or more, one each."""
        monitor = self._monitor
        time = self._time + np.arange(len(part))
        room = max(monitor._count(monitor._longest_head) - len(self._head), 0)
        self._head = np.concatenate([self._head, part[:room]])
        raw = monitor._score(self._model, monitor._describe(part, self._head, self._before, time), time)
        longest = max(monitor._lags, default=0)
        self._before = np.concatenate([self._before, part])[-longest:] if longest else self._before
        kept, count = len(self._recent), monitor._count(monitor.memory)
        joined = np.concatenate([self._recent, raw])
        self._recent = joined[max(len(joined) - count + 1, 0) :]
        self._time += len(part)
        return moving_mean(joined, count)[kept:]


@dataclass(kw_only=True, eq=False, repr=False)
class NominalMonitor(Monitor):
    """Distance to the nearest nominal recordings at about the same time, as surprise, averaged over the channels.

    Each channel is described by its change since the beginning of the skill and within ``lags``, so the bias of a
    sensor has no effect. Features are divided by their differences between groups. The distance of a channel to its
    nearest nominal moments within ``slack`` + ``drift`` x elapsed time is divided by the usual distance of held-out
    nominal recordings at that time, and its surprise is that of a Student t: log(1 + z^2 / 3). A short burst in one
    channel counts little; a deviation that lasts, or that several channels show, counts much.

    A recording that lasts longer than the nominal ones is compared with their ends: the score of a moment does not grow
    with the duration. The largest of more scores does, so :meth:`threshold` promises nothing for longer recordings.

    Args:
        lags: time differences of the changes, s.
        baseline: s at the beginning whose mean is subtracted.
        levels: numbers of the axes whose values are compared as well, as further channels: what is wrong from the
            beginning, such as a missing object, does not show in changes. None = those without a bias of the group,
            if three groups or more have several recordings (:func:`rcbht_jax.introspection.neighbours.unbiased`).
        slack: s by which a moment may be early or late.
        drift: the same, as a share of the elapsed time.
        neighbours: nearest nominal recordings whose distances are averaged; all others are those of :class:`Monitor`.

    Attributes:
        levels_: the axes whose values are compared.
        bank_: all that was learned: features of the nominal recordings, scales and usual distances.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> push = np.clip(np.arange(80) - 30, 0, 20)[:, None] * [0.5, 0.02]  # [time, axis], 4 s at 20 Hz
        >>> nominal = push + 0.1 * rng.normal(size=(40, 80, 2))
        >>> monitor = NominalMonitor(rate=20).fit(nominal)
        >>> jammed = push + 0.1 * rng.normal(size=(80, 2))
        >>> jammed[40:] += 8  # after 2 s
        >>> monitor.detect(push), 2.0 < monitor.detect(jammed) < 2.5
        (inf, True)
    """

    memory: Any = 1.0
    lags: Any = (0.2, 0.4)
    baseline: Any = 0.25
    levels: Any = None
    slack: Any = 0.2
    drift: Any = 0.1
    neighbours: Any = 1

    _least: ClassVar = {**Monitor._least, "baseline": 0, "slack": 0, "drift": 0, "neighbours": 1}

    def _check(self) -> None:
        super()._check()
        lags, levels = np.asarray(self.lags), np.asarray([] if self.levels is None else self.levels)
        good = [v.dtype.kind in "iuf" and v.ndim == 1 and ((v >= 0) & (v <= 1e9)).all() for v in (lags, levels)]
        if not all(good) or (levels % 1).any() or self.neighbours % 1:
            given = f"lags {self.lags!r}, levels {self.levels!r}, neighbours {self.neighbours!r}"
            raise InputError(f"There are {given}; expected times, numbers of axes, a whole number.")

    @property
    def bank_(self) -> Bank:
        check_is_fitted(self, "peaks_")
        return self._model

    def restore(
        self, axes: int, levels: tuple[int, ...], bank: Bank, peaks: Float[np.ndarray, " recording"]
    ) -> NominalMonitor:
        """The fitted state from its parts, as a file holds them, if the parameters are good."""
        self._check()
        self.n_features_in_, self.levels_, self._model, self.peaks_ = axes, levels, bank, peaks
        return self

    @property
    def _longest_head(self) -> float:
        return float(self.baseline)

    @property
    def _lags(self) -> list[int]:
        return [self._count(lag) for lag in self.lags]

    def _describe(self, part: Channels, head: Channels, before: Channels, time: Times) -> Described:
        seen = np.cumsum(head, 0) / np.arange(1, len(head) + 1)[:, None]
        kinds = [part - seen[np.minimum(time, len(head) - 1)]]
        joined, first = np.concatenate([before, part]), time[0] - len(before)
        kinds += [part - joined[np.maximum(time - lag, 0) - first] for lag in self._lags]
        levels = part[:, list(self.levels_), None]
        values = np.concatenate([levels, np.zeros((*levels.shape[:2], len(self._lags)))], 2)
        return np.concatenate([np.stack(kinds, 2), values], 1)

    def _prepare(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> None:
        self.levels_ = unbiased(parts, groups) if self.levels is None else tuple(map(int, self.levels))
        if not set(self.levels_) <= set(range(axes := parts[0].shape[1])):
            raise InputError(f"levels are {self.levels}; expected numbers of axes, 0 to {axes - 1}.")

    def _described(self, parts: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Features of whole recordings ``[time, channel, kind]``."""
        first = self._count(self.baseline)
        return [self._describe(part, part[:first], part[:0], np.arange(len(part))) for part in parts]

    def _learn(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> Bank:
        slack = float(self.slack * self.rate / self.score_step)
        return make_bank(self._described(parts), groups, slack, float(self.drift), int(self.neighbours))

    def _score(self, model: Bank, described: Described, time: Times) -> Scores:
        distance = nearest(distances(model, described, time), model.neighbours)
        ratio = distance / model.reference[np.minimum(time, len(model.reference) - 1)]
        return np.log1p(ratio**2 / FREEDOM).mean(1)
