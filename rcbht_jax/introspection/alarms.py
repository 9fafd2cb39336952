"""Confidence levels with hysteresis, alarms, the phase filter, and conformal thresholds for a false-alarm rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from rcbht_jax._util.printable import plural
from rcbht_jax._util.values import number
from rcbht_jax.errors import InputError
from rcbht_jax.events import Level
from rcbht_jax.learning.class_groups import fewest_groups
from rcbht_jax.learning.metrics import INADMISSIBLE
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import fit, grouped_folds

FOLDS = 5
CALIBRATIONS = ("cross", "split")  # each nominal trial is held out in turn, or a half of them from all training


def check_calibration(calibration: object) -> None:
    """Refuse what is none of the ``CALIBRATIONS``.

    Raises:
        InputError: lists them.
    """
    if calibration not in CALIBRATIONS:
        raise InputError(f"calibration is {calibration!r}; expected one of {', '.join(CALIBRATIONS)}.")


def held_half(rows: Int[np.ndarray, " row"], seed: Any) -> Int[np.ndarray, " held"]:
    """A random half of some rows, rounded down, which trains nothing and sets thresholds.

    >>> held_half(np.arange(5), seed=0)
    array([0, 1])
    """
    return np.sort(np.random.default_rng(seed).permutation(rows)[(len(rows) + 1) // 2 :])


def first_above(scores: Float[np.ndarray, " time"], threshold: float, rate: float) -> float:
    """Seconds from the beginning of a recording to the first score above a threshold; inf = none.

    >>> first_above(np.array([0.1, 0.9]), 0.5, 20.0)
    0.1
    """
    above = np.flatnonzero(scores > threshold)
    return float((above[0] + 1) / rate) if len(above) else np.inf


def sustained_peak(probability: Float[np.ndarray, " snapshot"], steps: int) -> float:
    """The highest level that the probability keeps for ``steps`` snapshots in a row; 0 if there are fewer.

    >>> sustained_peak(np.array([0.2, 0.9, 0.6, 0.7]), 2)
    0.6
    """
    if len(probability) < steps:
        return 0.0
    return float(np.lib.stride_tricks.sliding_window_view(probability, steps).min(1).max())


def rounded_up(share: float) -> float:
    """A share between 0 and 1 in three digits, not below it: what so many trials can promise, they keep.

    >>> rounded_up(1 / 95), rounded_up(0.1)
    (0.0106, 0.1)
    """
    step = 10.0 ** (np.floor(np.log10(share)) - 2)
    return float(f"{np.ceil(share / step - 1e-9) * step:.3g}")


def conformal_threshold(peaks: Float[np.ndarray, " trial"], share: float) -> float:
    """Threshold that a new nominal trial's peak exceeds with a probability of at most ``share``.

    Args:
        peaks: of nominal trials that did not train the classifier.
        share: false alarms per nominal trial, between 0 and 1.

    Raises:
        InputError: there are fewer than 1 / share - 1 trials.

    >>> conformal_threshold(np.arange(9) / 10, 0.1)
    0.8
    """
    if not 0 < (share := number("The share of false alarms", share)) < 1:
        raise InputError(f"{share:g} false alarms per trial were asked for; expected a number between 0 and 1.")
    rank = int(np.ceil((len(peaks) + 1) * (1 - share) - 1e-9))
    if rank > len(peaks):
        least = f", only {rounded_up(1 / (len(peaks) + 1)):g} or more" if len(peaks) else ""
        raise InputError(
            f"{plural(len(peaks), 'nominal trial')} cannot promise {share:g} false alarms per trial{least}; "
            f"it takes {trials_needed(share)}."
        )
    return float(np.sort(peaks)[rank - 1])


def conformal_p(peaks: Float[np.ndarray, " trial"], score: float) -> float:
    """Conformal p-value of a score: at most ``share`` just where it exceeds the :func:`conformal_threshold`.

    >>> conformal_p(np.arange(9) / 10, 0.85)
    0.1
    """
    return (1 + int((peaks >= score).sum())) / (len(peaks) + 1)


def trials_needed(share: float) -> int:
    """Fewest nominal trials that promise ``share`` false alarms per trial, more than 0 and less than 1.

    >>> trials_needed(0.1)
    9
    """
    return int(np.ceil(1 / share - 1 - 1e-9))


class TooFewRecordingsError(InputError):
    """Without one of their groups, too few nominal recordings remain to learn from."""


def check_groups(groups: Shaped[np.ndarray, " recording"], part: Int[np.ndarray, " recording"]) -> None:
    """Refuse groups without which fewer than two recordings remain.

    Args:
        groups: of the recordings.
        part: in which the group of each recording is held out.

    Raises:
        TooFewRecordingsError: names such a group.
    """
    for held in np.unique(part):
        if (part != held).sum() < 2:
            without = ", ".join(map(str, np.unique(groups[part == held]).tolist()))
            raise TooFewRecordingsError(
                f"Without group {without} a single recording remains; it takes two to learn from. Add recordings of "
                "other groups, or group them otherwise."
            )


def peaks(
    probability: Float[np.ndarray, " snapshot"], groups: Shaped[np.ndarray, " snapshot"], steps: int
) -> Float[np.ndarray, " trial"]:
    """:func:`sustained_peak` of every trial, in the order of the names in ``groups``."""
    counts = np.unique(groups, return_counts=True)[1]
    trials = np.split(probability[np.argsort(groups, kind="stable")], counts.cumsum()[:-1]) if len(counts) else []
    return np.array([sustained_peak(trial, steps) for trial in trials])


def held_out(
    machine: ProbabilisticSvm,
    x: Float[np.ndarray, "item feature"],
    y: Int[np.ndarray, " item"],
    groups: Shaped[np.ndarray, " item"],
    stream: Float[np.ndarray, "snapshot feature"],
    stream_group: Shaped[np.ndarray, " snapshot"],
    seed: int,
) -> Float[np.ndarray, "snapshot class"]:
    """Class probabilities of training trials as they are streamed, each by a classifier not trained on the trial.

    Args:
        machine: trained on all of ``x``; gives hyper-parameters and sigmoids.
        x: training features.
        y: class index.
        groups: trial of each item.
        stream: features of the streamed training trials.
        stream_group: trial of each snapshot.
        seed: of the folds.

    Raises:
        InputError: a streamed trial is not among those that train.
    """
    out = np.full((len(stream), len(machine.svm.classes)), np.nan)
    for train, test in grouped_folds(y, groups, min(FOLDS, fewest_groups(y, groups)), seed):
        one = ProbabilisticSvm(fit(x[train], y[train], machine.svm.classes, machine.svm.spec), machine.sigmoid)
        rows = np.flatnonzero(np.isin(stream_group, groups[test]))
        out[rows] = one.probability(stream[rows])
    if np.isnan(out).any():
        raise InputError("A streamed trial is not among those that train, so that nothing is held out for it.")
    return out


LEAST = 1e-4  # least probability of a sub-task in a belief: no single belief may rule one out


class Confidence:
    """Level of a belief: certain above ``k``, until it falls below ``k - margin`` or another class is likelier.

    Raises:
        InputError: ``k`` is not from 0.5 + ``margin`` to less than 1, or the margin is negative.
    """

    def __init__(self, k: float, margin: float) -> None:
        k, margin = number("The certainty level", k), number("The margin", margin)
        least = INADMISSIBLE + max(margin, 0.0)
        if not least - 1e-9 <= k < 1 or margin < 0:
            raise InputError(
                f"a belief cannot be certain above {k:g} with a margin of {margin:g}; expected a margin of zero or "
                f"more, and a level from 0.5 + margin, here {least:g}, to less than 1."
            )
        self._k, self._margin = k, margin
        self.reset()

    def reset(self) -> None:
        """Forget that anything was certain."""
        self._label, self._since = "", 0.0

    def update(self, label: str, probability: float, time: float) -> tuple[Level, float]:
        """The level of the likeliest class and the seconds for which it has been certain."""
        if label != self._label or probability < self._k - self._margin:
            self._label = ""
        if not self._label and probability > self._k:
            self._label, self._since = label, time
        if self._label:
            return "certain", round(time - self._since, 6)
        return ("uncertain" if probability >= INADMISSIBLE else "inadmissible"), 0.0


class Alarm:
    """Raised when a probability stays above ``k`` for ``hold`` seconds; cleared when it stays as long below 0.5, or
    below ``k`` where that is less."""

    def __init__(self, k: float, hold: float) -> None:
        if not 0 <= (hold := number("The hold time", hold)) < float("inf"):
            raise InputError(f"an alarm cannot be held for {hold} s; expected zero or more.")
        self._k, self._hold = k, hold
        self.reset()

    def reset(self) -> None:
        """Clear the alarm, as at the beginning."""
        self.raised = False
        self._since: float | None = None

    def update(self, probability: float, time: float) -> bool | None:
        """True if the alarm is raised now, False if it is cleared now, None if nothing changes."""
        against = probability < min(INADMISSIBLE, self._k) if self.raised else probability > self._k
        if not against:
            self._since = None
            return None
        if self._since is None:
            self._since = time
        if time - self._since < self._hold - 1e-9:
            return None
        self.raised, self._since = not self.raised, None
        return self.raised


class PhaseFilter:
    """Finds the sub-task in progress from beliefs alone, with the forward filter of a left-to-right Markov chain.

    Sub-tasks follow each other in the order of the classes; one that passes unnoticed is skipped, none comes back. The
    next one begins when it is likelier than not that the present one is over.

    Args:
        classes: in the order of the sub-tasks.
        stay: prior mean duration of a sub-task, s; the order of magnitude suffices.
        memory: s after which beliefs count as independent; nearer ones weigh less, in proportion.

    Raises:
        InputError: ``stay`` or ``memory`` is not positive.
    """

    def __init__(self, classes: Sequence[str], stay: float = 1.0, memory: float = 0.1) -> None:
        if not (0 < stay < float("inf") and 0 < memory < float("inf")):
            raise InputError(f"stay is {stay} s and memory {memory} s; expected positive times.")
        self._count, self._stay, self._memory = len(classes), stay, memory
        self.reset()

    def reset(self) -> None:
        """Return to the first sub-task."""
        self.current, self._time = 0, 0.0
        self.filtered = np.eye(self._count)[0]  # probability of each sub-task, given all that was seen

    def update(self, probabilities: Sequence[float] | Float[np.ndarray, " class"], time: float) -> bool:
        """Whether a new sub-task begins now, given the belief ``[class]`` and the time since the trial began, s."""
        passed, self._time = time - self._time, time
        mean = passed / self._stay
        # Probability that so many sub-tasks pass meanwhile (Poisson).
        moves = np.exp(-mean) * np.cumprod([1.0, *(mean / k for k in range(1, self._count))])
        ahead = np.convolve(self.filtered, moves)[: self._count]
        ahead[-1] += 1.0 - ahead.sum()
        seen = ahead * np.maximum(probabilities, LEAST) ** min(passed / self._memory, 1.0)
        self.filtered = seen / seen.sum()
        number = int(np.searchsorted(self.filtered.cumsum(), 0.5))  # of which and of later ones more than half
        began = number > self.current
        self.current = max(number, self.current)
        return began
