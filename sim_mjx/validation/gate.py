"""The gate: what a simulated session must have in common with the recorded one.

Band, distance and time warping of :mod:`sim_mjx.validation.signature` measure one axis at a time: a constant in place
of a wrench, or parts without tabs, can pass them. Here a classifier tries to separate simulated from recorded trials (a
classifier two-sample test, Lopez-Paz & Oquab 2017), and the first impact, the ringing, the spread between trials and
the signs of the moments are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from sim_mjx.presets.session import GateLimits
from sim_mjx.validation import signature
from sim_mjx.validation.dynamics import Dynamics
from sim_mjx.validation.signature import Given

MOMENTS = slice(3, 6)
LEAST = 3  # least number of trials in a set


@dataclass(frozen=True)
class Check:
    """One measure and its limits."""

    value: float | None  # None = it cannot be measured, which does not pass
    low: float | None = None
    high: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the value is within the limits."""
        if self.value is None or not np.isfinite(self.value):
            return False
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)


def cells(profiles: Given) -> Float64[np.ndarray, "_trial _cell"]:
    """Mean and standard deviation of every state and axis: the classifier's features of a trial."""
    return np.concatenate([profiles.mean(2), profiles.std(2)], axis=1).reshape(len(profiles), -1)


def separability(reference: Given, test: Given) -> float:
    """How well a linear classifier separates two sets of trials: area under the ROC curve, 0.5 = not at all.

    Each trial is scored by a linear discriminant (shrinkage of Ledoit and Wolf) of all others' :func:`cells`; its
    decision counts in units of their spread. With few trials the area is below 0.5 where the sets are alike, because
    the mean of the others moves away from the trial that was left out.

    Args:
        reference: profiles ``[n, 4, 100, 6]``. test: ``[m, 4, 100, 6]``.

    Raises:
        InputError: fewer than three trials in a set.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> one, other = (rng.normal(size=(12, 4, 100, 6)) for _ in range(2))
        >>> separability(one, other) < 0.7, separability(one, other + 0.2)
        (True, 1.0)
    """
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.metrics import roc_auc_score
    from sklearn.model_selection import LeaveOneOut, cross_val_predict
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    if min(len(reference), len(test)) < LEAST:
        raise InputError(
            f"reference has {plural(len(reference), 'trial')} and test {len(test)}; expected at least {LEAST} of each."
        )
    values = np.concatenate([cells(reference), cells(test)])
    labels = np.repeat([0, 1], [len(reference), len(test)])
    discriminant = make_pipeline(StandardScaler(), LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"))
    scores = cross_val_predict(discriminant, values, labels, cv=LeaveOneOut(), method="decision_function")
    return float(roc_auc_score(labels, scores))


def wrong_signs(reference: Given, test: Given) -> Bool[np.ndarray, "4 3"]:
    """States and moments whose mean has the other sign and is more than one recorded standard deviation away."""
    ours, theirs = (profiles[..., MOMENTS].mean((0, 2)) for profiles in (test, reference))
    away = np.abs(ours - theirs) > reference[..., MOMENTS].std((0, 2))
    return (ours * theirs < 0) & away


def spread(reference: Given, test: Given) -> float:
    """Standard deviation between the test's trials over that between the reference's: median over states and axes."""
    ours, theirs = (profiles.mean(2).std(0) for profiles in (test, reference))
    return float(np.median(ours / theirs))


def checks(
    limits: GateLimits,
    reference: Given,
    test: Given,
    events: tuple[Dynamics, Dynamics] | None = None,
    snaps: tuple[float, float] | None = None,
    late: float | None = None,
) -> dict[str, Check]:
    """Every measure of a simulated session, with its limits.

    Args:
        limits: of the session.
        reference: recorded profiles ``[n, 4, 100, 6]``. test: simulated ones, at least three.
        events: fast events, recorded and simulated; None = not compared.
        snaps: shares of seated trials with a snap like the recorded ones, recorded and simulated; None = not compared.
        late: s, largest error of a median onset; None = not compared.

    Raises:
        InputError: profiles of a wrong shape, not finite, or fewer than three.
    """
    score = signature.compare(reference, test)
    out = {
        "coverage": Check(score.coverage, low=limits.coverage),
        "W1/sd": Check(score.w1_over_sd, high=limits.w1_over_sd),
        "DTW/sd": Check(score.dtw_over_sd, high=limits.dtw_over_sd),
        "AUC": Check(separability(reference, test), high=limits.auc),
        "wrong signs": Check(float(wrong_signs(reference, test).sum()), high=0.0),
        "spread": Check(spread(reference, test), low=1 / limits.spread, high=limits.spread),
    }
    if events is not None:
        impacts = [float(np.median(each.impact)) if len(each.impact) else None for each in events]
        out["first impact"] = _ratio(impacts, limits.impact)
        if events[0].ring is not None:
            for name, factor in (("hertz", limits.ring), ("peak", limits.ring_peak), ("damping", limits.damping)):
                values = [None if each.ring is None else getattr(each.ring, name) for each in events]
                out[f"ring {name}"] = _ratio(values, factor)
    if snaps is not None:
        out["snaps"] = Check(snaps[1], low=snaps[0] - limits.fewer_snaps)
    if late is not None:
        out["onsets"] = Check(late, high=limits.late)
    return out


def _ratio(values: Sequence[float | None], factor: float) -> Check:
    """Ratio of the simulated value to the recorded one."""
    recorded, simulated = values
    ratio = None if recorded is None or simulated is None else simulated / recorded
    return Check(ratio, low=1 / factor, high=factor)


def as_json(found: dict[str, Check]) -> dict[str, Any]:
    """Values, limits and verdicts as JSON values."""
    return {name: {**asdict(check), "holds": check.holds} for name, check in found.items()}
