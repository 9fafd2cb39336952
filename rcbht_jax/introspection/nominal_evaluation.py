"""Evaluation of a nominal monitor on unseen days: groups are held out one at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.alarms import TooFewRecordingsError, conformal_threshold, first_above, trials_needed
from rcbht_jax.introspection.nominal import Monitor

with needs_extra("learn"):
    from sklearn.base import clone
    from sklearn.metrics import roc_auc_score

FEWEST = 3  # nominal recordings to learn from


@dataclass(frozen=True)
class Watched:
    """Recordings, each scored by a monitor of the nominal recordings of the other groups."""

    scores: tuple[NDArray[np.float64], ...]  # [recording] of [time]; empty where too few nominal ones were left
    nominal: Bool[np.ndarray, " recording"]
    groups: Shaped[np.ndarray, " recording"]
    usual_length: Float[np.ndarray, " recording"]  # samples, median length of the nominal training recordings
    calibration: dict[str, NDArray[np.float64]]  # group -> peaks of the nominal recordings of the others
    rate: float  # samples per second

    @property
    def seen(self) -> Bool[np.ndarray, " recording"]:
        """Which recordings were scored."""
        return np.array([len(score) > 0 for score in self.scores], bool)

    def peaks(self, usual: bool = False) -> Float[np.ndarray, " recording"]:
        """Largest score of each recording; NaN where there is none.

        Args:
            usual: only up to the usual length of a nominal recording, so that long ones have no advantage.
        """
        ends = [int(end) if usual else None for end in np.nan_to_num(self.usual_length)]
        pairs = zip(self.scores, ends, strict=True)
        return np.array([score[:end].max() if len(score) else np.nan for score, end in pairs])


def hold_out(
    monitor: Monitor,
    series: Sequence[Float[np.ndarray, "_ axis"]],
    nominal: Bool[np.ndarray, " recording"],
    groups: Shaped[np.ndarray, " recording"],
    progress: Callable[[int], Any] | None = None,
    folds: int = 0,
) -> Watched:
    """Score every group by a monitor that learns from the nominal recordings of all others.

    A part is not scored where the others have fewer than three, or a single one without one of their groups.

    Args:
        monitor: with its parameters; it is cloned.
        series: recordings ``[time, axis]`` of one skill.
        nominal: which of them are nominal, and train.
        groups: day or session of each.
        progress: called with 1 after each part.
        folds: parts into which the groups are distributed, if there are more; the groups of a part are held out
            together. 0 = each group is a part.

    Raises:
        InputError: no group can be held out, or a negative number of folds.
    """
    scores = [np.zeros(0)] * len(series)
    usual = np.full(len(series), np.nan)
    calibration: dict[str, NDArray[np.float64]] = {}
    part = parts(groups, folds)
    for held in range(part.max() + 1):
        train = np.flatnonzero(nominal & (part != held)).tolist()
        test = np.flatnonzero(part == held).tolist()
        fitted = None
        with suppress(TooFewRecordingsError):
            if len(train) >= FEWEST:
                fitted = clone(monitor).fit([series[row] for row in train], groups=groups[train])
        if fitted is not None:
            for row in test:
                scores[row] = fitted.scores(series[row])
            usual[test] = np.median([len(series[row]) for row in train])
            calibration |= {str(group): fitted.peaks_ for group in np.unique(groups[test])}
        if progress is not None:
            progress(1)
    if not calibration:
        found = plural(len(np.unique(groups[nominal])), "group")
        raise InputError(
            f"Each part of the recordings is scored by a monitor of the others, for which {FEWEST} nominal ones must "
            f"remain, and two without any one of their groups; the {int(nominal.sum())} nominal recordings are of "
            f"{found}. Choose other groups (--group)."
        )
    return Watched(tuple(scores), nominal, groups, usual, calibration, float(monitor.rate))


def parts(groups: Shaped[np.ndarray, " recording"], folds: int) -> Int[np.ndarray, " recording"]:
    """The part of each recording, in which its group is held out: 0 to ``folds`` - 1, or fewer.

    >>> parts(np.array(["Mon", "Tue", "Wed", "Mon"]), 2)
    array([0, 1, 0, 0])
    """
    if folds < 0:
        raise InputError(f"There are {folds} folds; expected 0 or more.")
    numbers = np.unique(groups, return_inverse=True)[1]
    return numbers % folds if folds else numbers


def auroc(nominal: Bool[np.ndarray, " recording"], peak: Float[np.ndarray, " recording"]) -> float | None:
    """Probability that an anomalous recording has a larger peak than a nominal one; None if there is none of either.

    >>> auroc(np.array([True, True, False]), np.array([0.1, 0.3, 0.2]))
    0.5
    """
    known = ~np.isnan(peak)
    if len(np.unique(nominal[known])) < 2:
        return None
    return float(roc_auc_score(~nominal[known], peak[known]))


def thresholds(watched: Watched, alpha: float) -> dict[str, float]:
    """Threshold of each group for ``alpha`` false alarms, if the others have enough nominal recordings for it."""
    fewest = trials_needed(alpha) if 0 < alpha < 1 else 0  # 0: the first threshold raises the error
    return {
        group: conformal_threshold(peaks, alpha) for group, peaks in watched.calibration.items() if len(peaks) >= fewest
    }


def judge(
    watched: Watched,
    thresholds: dict[str, float],
    onset: Float[np.ndarray, " recording"] | None = None,
    early: float = 0.5,
) -> dict[str, Any]:
    """Alarms compared with the ground truth: AUROC, false alarms, detections and delays, in all and by group.

    Args:
        watched: the scores.
        thresholds: by group; groups without one raise no alarm and are not counted in rates.
        onset: s at which the anomaly of a recording began; NaN = not known. None = none is known.
        early: s before the onset; earlier alarms of an anomalous recording are counted apart and are no detection.

    Returns:
        JSON values; None where there was nothing to count. Delays are in s since the onset.
    """
    onset = np.full(len(watched.scores), np.nan) if onset is None else onset
    limit = np.array([thresholds.get(str(group), np.nan) for group in watched.groups])
    alarm = np.array(
        [first_above(score, level, watched.rate) for score, level in zip(watched.scores, limit, strict=True)], float
    )
    counted = watched.seen & ~np.isnan(limit)
    whole, usual = watched.peaks(), watched.peaks(usual=True)
    too_early = alarm < onset - early

    def row(mask: Bool[np.ndarray, " recording"]) -> dict[str, Any]:
        calm, wrong = mask & counted & watched.nominal, mask & counted & ~watched.nominal
        found = wrong & np.isfinite(alarm) & ~too_early
        delay = (alarm - onset)[found & ~np.isnan(onset)]
        return {
            "nominal": int((mask & watched.seen & watched.nominal).sum()),
            "anomalous": int((mask & watched.seen & ~watched.nominal).sum()),
            "auroc": auroc(watched.nominal[mask], whole[mask]),
            "auroc_usual_length": auroc(watched.nominal[mask], usual[mask]),
            "false_alarms": float(np.isfinite(alarm[calm]).mean()) if calm.any() else None,
            "false_alarms_of": [int(np.isfinite(alarm[calm]).sum()), int(calm.sum())],
            "detected": float(found[wrong].mean()) if wrong.any() else None,
            "early": int((wrong & too_early).sum()),
            "delay_median": float(np.median(delay)) if len(delay) else None,
            "delay_90": float(np.quantile(delay, 0.9)) if len(delay) else None,
        }

    names, number = np.unique(watched.groups, return_inverse=True)  # missing values, which are not equal, become one
    by_group = {str(name): row(number == index) for index, name in enumerate(names)}
    return {**row(np.ones(len(limit), bool)), "groups": by_group}
