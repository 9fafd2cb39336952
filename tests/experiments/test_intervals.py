"""Intervals of the committed results, and what makes them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from experiments._lib.benchmarks import with_interval
from experiments._lib.intervals import (
    at_least,
    bootstrap,
    by_trial,
    jackknife,
    of_folds,
    of_sums,
    sums,
    with_width,
)
from experiments._lib.results_io import COMMITTED, committed
from rcbht_jax.learning.metrics import equal_items, has_width, percentile_interval, wilson
from rcbht_jax.learning.validation import CrossValidation, without_intervals


def pairs(value: Any) -> Iterator[tuple[float, float]]:
    """Every pair of numbers in what is named an interval."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if len(parts) == 2 and all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts):
        low, high = parts
        yield low, high
    else:
        for part in parts:
            yield from pairs(part)


def intervals(value: Any, place: str = "") -> Iterator[tuple[str, float, float]]:
    """Every interval of a result, and where it is."""
    for key, part in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        if "interval" in str(key) or str(key).endswith("95_percent"):
            yield from ((f"{place} > {key}", *ends) for ends in pairs(part))
        yield from intervals(part, f"{place} > {key}")
    if isinstance(value, dict) and all(isinstance(value.get(end), int | float) for end in ("low", "high")):
        yield place, value["low"], value["high"]


@pytest.mark.parametrize("path", sorted(COMMITTED.glob("*.json")), ids=lambda path: path.stem)
def test_no_committed_interval_has_zero_width(path: Any) -> None:
    found = list(intervals(json.loads(path.read_text(encoding="utf-8"))))
    assert [place for place, low, high in found if not has_width(low, high)] == []
    assert all(low < high for _, low, high in found)


OVER_FOLDS = (
    "abnormal_real", "calibration", "calibration_bank", "calibration_near", "calibration_transfer", "causal",
    "external_early", "external_failures", "failure_types_online", "fit_classification", "frozen_choice", "grammar",
    "headline", "peers", "probes", "table1_ours", "table2", "two_arm_states", "types_across",
)  # fmt: skip
# No share of items that are right, or an exception that docs/evaluation.md names: streams at every step, and alarms.
UNLIMITED = "macro step|every tenth|time known|OverallPr|alarmed|ECE|calibration error|gain|earliness|harmonic"
ITEMS = {  # at most, of the set that the place of a score names; the first counts
    "abnormal_real > sessions": equal_items([16, 19]),
    "abnormal_real|headline.*success or failure": equal_items([12, 35]),
    "types|failure-type|calibration_transfer": 294, "two_arm_states": 160, "lp1": 88, "lp2": 47, "lp4": 117,
    "SIM1|sim1": 116, "SIM2": 52, "session A": 64, "REAL|real-transfer|[AB] to [AB]": 140,
}  # fmt: skip


def scores(value: Any, place: str) -> Iterator[tuple[str, float, float, float]]:
    """Every score that has an interval, and where it is."""
    if not isinstance(value, dict):
        return
    ends = value.get("interval", [value.get("low"), value.get("high")])
    if "mean" in value and isinstance(ends[0], float):
        yield place, value["mean"], *ends
    for key, part in value.items():
        if key == "intervals":
            yield from ((f"{place} > {task}", value["scores"][task], *pair) for task, pair in part.items())
        yield from scores(part, f"{place} > {key}")


def items_of(place: str, row: dict[str, Any]) -> float:
    """How many items a score is of; mean recall has so many as classes of equal size would have."""
    sizes = row.get("items", row.get("trials"))
    if isinstance(sizes, dict):
        return equal_items(list(sizes.values())) if "balanced" in place else sum(sizes.values())
    return next(items for pattern, items in ITEMS.items() if re.search(pattern, place))


@pytest.mark.parametrize("name", OVER_FOLDS)
def test_no_committed_score_over_folds_has_an_interval_narrower_than_wilsons(name: str) -> None:
    result = committed(name)
    found = [
        (place, low, high, wilson(mean * items, items))
        for key, row in result.get("rows", result).items()
        for place, mean, low, high in scores(row, f"{name} > {key}")
        if not re.search(UNLIMITED, place)
        for items in [items_of(place, row)]
    ]
    assert found
    rounding = 0.0015  # of scores and ends to three places
    assert [one for one in found if one[1] > one[3][0] + rounding or one[2] < one[3][1] - rounding] == []


def test_the_search_finds_every_form_of_an_interval() -> None:
    forms = {
        "a": {"low": 1, "high": 1}, "interval": [1.0, 1.0], "auroc_interval": [0, 0], "share_95_percent": [1, 1],
        "intervals": {"x": [1, 1], "y": [0, 1]}, "rows": [{"interval": {"delay": [0.0, 0.0], "edit": [None, None]}}],
    }  # fmt: skip
    assert sum(low == high for _, low, high in intervals(forms)) == 6


def test_scores_of_folds_that_all_agree_have_wilsons_interval_by_trial() -> None:
    same = {"mean": 1.0, "low": 1.0, "high": 1.0}
    right, apart = np.ones((2, 2)), np.array([[1.0, 0.8], [0.8, 1.0]])

    def run(accuracy: np.ndarray, recall: np.ndarray, items: list[int]) -> CrossValidation:
        split, confusion = np.arange(4).reshape(2, 2), np.zeros((2, 2), int)
        return CrossValidation(accuracy, recall, [], confusion, 1.0, split, np.array(items))

    made = of_folds(run(right, apart, [10, 10]), 12)
    assert (made["accuracy"]["low"], made["accuracy"]["high"]) == wilson(12, 12)
    assert made["balanced_accuracy"]["interval by"] == "corrected resampled t"
    assert with_width(made["accuracy"], 12) == made["accuracy"]  # which says how it was made
    assert {name: without_intervals(made)[name] for name in ("accuracy", "balanced_accuracy")} == {
        "accuracy": {"mean": 1.0},
        "balanced_accuracy": {"mean": pytest.approx(0.9)},
    }
    # Two of a rare class that are both right say little of its recall: as much as 4 / (1/98 + 1/2) equal ones.
    rare = of_folds(run(right, right, [98, 2]), 100)
    assert rare["balanced_accuracy"]["low"] == pytest.approx(wilson(7.84, 7.84)[0])
    assert rare["accuracy"]["low"] == pytest.approx(wilson(100, 100)[0])
    # Folds that agree better than new items would: 0.9 of 100 items cannot be known to 0.001.
    near = of_folds(run(np.array([[0.9, 0.901], [0.901, 0.9]]), apart, [50, 50]), 50)["accuracy"]
    assert (near["low"], near["high"]) == wilson(0.9005 * 100, 100)
    assert near["interval by"] == "corrected resampled t, no narrower than Wilson's by item"
    one_end = at_least({"mean": 0.9, "low": 0.5, "high": 0.91, "interval by": "t"}, 100)
    assert (one_end["low"], one_end["high"]) == (0.5, wilson(90, 100)[1])
    assert (
        at_least(with_width({"mean": 0.9, "low": 0.5, "high": 1.0}, 10), 100)["interval by"] == "corrected resampled t"
    )
    assert at_least({"mean": 0.9}, 100) == {"mean": 0.9}
    assert with_width(same, 0) == {"mean": 1.0}
    assert with_interval(np.ones((3, 5)), trials=12)["interval"] == [round(end, 3) for end in wilson(12, 12)]
    assert with_interval(np.ones((3, 5))) == {"mean": 1.0}
    ends = [round(end, 3) for end in wilson(90, 100)]
    assert with_interval(np.array([0.899, 0.901]), items=100) == {"mean": 0.9, "interval": ends}


def test_shares_of_sums_vary_with_the_groups_that_are_drawn() -> None:
    rng = np.random.default_rng(1)
    whole = rng.integers(50, 150, 30).astype(float)
    part = whole * rng.uniform(0.4, 0.8, 30)
    found = of_sums(part, whole)
    draws = rng.integers(0, 30, (4000, 30))
    expected = np.quantile(part[draws].sum(1) / whole[draws].sum(1), [0.025, 0.975])
    assert found["mean"] == pytest.approx(part.sum() / whole.sum())
    np.testing.assert_allclose([found["low"], found["high"]], expected, atol=0.006)
    assert found["interval by"] == "groups drawn"


def test_shares_of_sums_without_a_mistake_have_a_width() -> None:
    """Groups that hold nothing, such as trials without a contact, count for nothing."""
    whole = np.array([3.0, 0.0, 5.0, 4.0, 0.0])
    found = of_sums(whole, whole)
    assert found == by_trial(1.0, 3)
    assert found["low"] < 0.5


def test_an_interval_of_one_split_is_named_by_what_it_is() -> None:
    """An evaluation from one session to another has Wilson's already."""
    low, high = wilson(0.8 * 13, 13)
    assert with_width({"mean": 0.8, "low": low, "high": high}, 13)["interval by"] == "Wilson, by trial"
    assert with_width({"mean": 0.8, "low": low, "high": high + 0.01}, 13)["interval by"] == "corrected resampled t"


def test_the_jackknife_of_means_is_that_of_student() -> None:
    """The standard error of a difference of means; for a nonlinear measure, about that of draws."""
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(9, 3)), rng.normal(size=(14, 3)) + 2

    def difference(first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(first.mean(0) - second.mean(0))

    low, high = jackknife(difference, one, other)
    error = np.sqrt(one.var(0, ddof=1) / 9 + other.var(0, ddof=1) / 14)
    np.testing.assert_allclose((low + high) / 2, difference(one, other))
    np.testing.assert_allclose((high - low) / 2, stats.t.ppf(0.975, 8) * error)

    def ratio(first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(first.std(0) / second.std(0))

    many = [ratio(rng.normal(size=(30, 1)), rng.normal(size=(40, 1))) for _ in range(2000)]
    ends = [jackknife(ratio, rng.normal(size=(30, 1)), rng.normal(size=(40, 1))) for _ in range(200)]
    widths = [float(high[0] - low[0]) / 2 / stats.t.ppf(0.975, 29) for low, high in ends]
    assert np.median(widths) == pytest.approx(np.std(many), rel=0.15)


def test_a_bootstrap_draws_groups_not_items() -> None:
    """Items of a group stay together, whatever their order and the names of the groups."""
    rng = np.random.default_rng(2)
    groups = rng.permutation(np.repeat(np.arange(12), rng.integers(1, 9, 12)))
    correct = rng.random(len(groups)) < np.linspace(0.3, 1, 12)[groups]
    right, total = (np.array([part[groups == group].sum() for group in range(12)]) for part in (correct, correct >= 0))
    draws = rng.integers(0, 12, (4000, 12))
    expected = percentile_interval(right[draws].sum(1) / total[draws].sum(1), 12)
    found = bootstrap(correct, groups, 0)
    np.testing.assert_allclose(found, expected, atol=0.02)
    assert bootstrap(correct, np.array(list("abcdefghijkl"))[groups], 0) == found
    alone = bootstrap(correct, np.arange(len(groups)), 0)
    assert found[1] - found[0] > 1.2 * (alone[1] - alone[0])
    assert bootstrap(correct >= 0, groups, 0) == wilson(12, 12)


def test_sums_of_groups() -> None:
    values = np.array([[1.0, 2], [3, 4], [5, 6], [7, 8]])
    assert sums(values, np.array(["b", "a", "b", "a"])).tolist() == [[10, 12], [6, 8]]
