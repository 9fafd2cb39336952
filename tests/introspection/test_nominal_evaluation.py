"""Alarms compared with the ground truth, against counts recording by recording."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.nominal_evaluation import Watched, hold_out, judge

RATE, EARLY = 4.0, 0.5
LIMITS = {"a": 2.0, "b": 3.0}  # of group c, too few nominal recordings were left


def counted(watched: Watched, onset: NDArray[np.float64], rows: list[int]) -> dict[str, Any]:
    """What the recordings ``rows`` amount to."""
    found, delays, false, early, wrong, calm = 0, [], 0, 0, 0, 0
    for row in rows:
        group = str(watched.groups[row])
        if not len(watched.scores[row]) or group not in LIMITS:
            continue
        above = [t for t, score in enumerate(watched.scores[row]) if score > LIMITS[group]]
        alarm = (above[0] + 1) / RATE if above else math.inf
        if watched.nominal[row]:
            calm, false = calm + 1, false + bool(above)
            continue
        wrong += 1
        if alarm < onset[row] - EARLY:
            early += 1
        elif above:
            found += 1
            delays += [] if math.isnan(onset[row]) else [alarm - onset[row]]
    seen = [row for row in rows if len(watched.scores[row])]
    truth = [not watched.nominal[row] for row in seen]
    return {
        "nominal": truth.count(False),
        "anomalous": truth.count(True),
        "auroc": roc_auc_score(truth, [watched.scores[row].max() for row in seen]),
        "auroc_usual_length": roc_auc_score(
            truth, [watched.scores[row][: int(watched.usual_length[row])].max() for row in seen]
        ),
        "false_alarms": false / calm if calm else None,
        "false_alarms_of": [false, calm],
        "detected": found / wrong if wrong else None,
        "early": early,
        "delay_median": np.median(delays) if delays else None,
        "delay_90": np.quantile(delays, 0.9) if delays else None,
    }


def flat(row: dict[str, Any]) -> dict[str, Any]:
    """Without a list, which ``approx`` refuses."""
    false, calm = row.pop("false_alarms_of")
    return {**row, "false": false, "calm": calm}


def test_alarms_are_counted_recording_by_recording() -> None:
    """Anomalies that are missed, found too early or of no known onset, alarms of nominal ones, groups without any."""
    rng = np.random.default_rng(0)
    nominal, groups = rng.random(60) < 0.5, np.array(list("abc"))[rng.integers(0, 3, 60)]
    scores = [rng.exponential(0.8 if calm else 1.2, size=rng.integers(6, 20)) for calm in nominal]
    for row in range(0, 60, 11):
        scores[row] = np.zeros(0)
    scores[1] = np.ones(1)
    onset = np.where(nominal | (rng.random(60) < 0.2), np.nan, rng.uniform(0, 4, 60))
    usual = np.array([rng.uniform(5, 15) if len(score) else np.nan for score in scores])
    watched = Watched(tuple(scores), nominal, groups, usual, {}, RATE)
    made = judge(watched, LIMITS, onset, EARLY)
    expected = counted(watched, onset, list(range(60)))
    assert 0 < expected["detected"] < 1
    assert expected["early"] > 0
    by_group = made.pop("groups")
    assert set(by_group) == set("abc")
    assert flat(made) == pytest.approx(flat(expected))
    for name, row in by_group.items():
        assert flat(row) == pytest.approx(flat(counted(watched, onset, np.flatnonzero(groups == name).tolist())))
    assert judge(watched, LIMITS)["early"] == 0


def test_a_group_of_one_nominal_recording_does_not_end_the_evaluation() -> None:
    """Monday's and Tuesday's monitors would score the other day by the one nominal recording of Wednesday."""
    days = np.array(["Mon"] * 5 + ["Tue"] * 5 + ["Wed"] * 2)
    rng = np.random.default_rng(0)
    series, nominal = [rng.normal(size=(30, 2)) for _ in days], np.array([True] * 11 + [False])
    watched = hold_out(NominalMonitor(), series, nominal, days)
    assert watched.seen.tolist() == [False] * 10 + [True] * 2
    assert {day: len(peaks) for day, peaks in watched.calibration.items()} == {"Wed": 10}
    with pytest.raises(InputError, match="levels are"):  # other errors are not taken for too few recordings
        hold_out(NominalMonitor(levels=(9,)), series, nominal, days)


def test_recordings_without_a_group_are_one_group() -> None:
    days, nominal = np.array([1.0, np.nan, 1.0, np.nan]), np.array([True, True, False, False])
    scores = tuple(np.array([peak]) for peak in (0.0, 1.0, 2.0, 3.0))
    found = judge(Watched(scores, nominal, days, np.ones(4), {}, RATE), {"1.0": 0.5, "nan": 0.5})["groups"]
    assert {name: (row["nominal"], row["anomalous"]) for name, row in found.items()} == {"1.0": (1, 1), "nan": (1, 1)}
    assert found["nan"]["false_alarms_of"] == [1, 1]


def test_a_group_without_which_too_few_nominal_recordings_remain_is_not_scored() -> None:
    rng = np.random.default_rng(0)
    groups = np.array([0, 0, 0, 0, 1, 1])
    watched = hold_out(NominalMonitor(), [rng.normal(size=(30, 2)) for _ in groups], np.ones(6, bool), groups)
    assert watched.seen.tolist() == [False] * 4 + [True] * 2
    assert np.isnan(watched.peaks()).tolist() == [True] * 4 + [False] * 2
    assert set(watched.calibration) == {"1"}
    assert judge(watched, {"0": 0.0, "1": np.inf})["nominal"] == 2
