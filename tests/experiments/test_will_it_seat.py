"""The belief in the outcome: drawn severities, what is seen, and scores that say what they should."""

from __future__ import annotations

import numpy as np
import pytest

from experiments._lib.results_io import committed
from experiments.online import faults_outcome
from experiments.online import will_it_seat as seat
from experiments.online.fault_trials import TAIL, Trials, drawn_from
from experiments.online.seat_trials import APART, KINDS, OUT_OF_REACH, SEVERITIES, sets
from rcbht_jax.introspection.fault_monitor import NOMINAL
from rcbht_jax.types import Recordings
from sim_mjx.presets import HOOKED
from sim_mjx.randomization.trials import check, sample


def test_every_set_can_be_drawn_and_says_nothing_by_its_length() -> None:
    for session in SEVERITIES:
        for name, fault, ranges, count in sets(session, 10):
            spec = drawn_from(fault, ranges)
            check(spec)
            assert spec.logs_on == TAIL
            kind = sample(HOOKED[session], 0, 0, spec)[1].kind
            assert kind == fault
            assert count == (2 if name == APART else 10)
    assert set(OUT_OF_REACH) < set(KINDS)


def made_up(shift: float, seed: int) -> seat.Seen:
    """Trials one feature of which tells the outcome, about a level of the session, and nothing of the fault."""
    rng = np.random.default_rng(seed)
    kind = np.repeat([NOMINAL, *KINDS, APART], 20)
    failed = (kind != NOMINAL) & ((np.arange(len(kind)) % 2 == 0) | (kind == APART))
    x = rng.normal(size=(len(seat.BEFORE), len(kind), 3)) * 0.1
    x[2:, :, 0] += failed  # the first two moments know nothing
    x += shift
    outcome, ones = np.where(failed, "failure", "success"), np.ones(len(kind))
    blank = Recordings.from_arrays(np.zeros((len(kind), 4, 6)), outcome=outcome)
    trials = Trials(blank, kind, ones.astype(int), ones > 0, kind, ones, ones)
    return seat.Seen(trials, x, rng.normal(size=(4, len(kind), 2)), np.zeros((4, len(kind), 3)))


def test_the_outcome_is_foretold_and_a_deviation_is_not_the_outcome() -> None:
    get = {"A": made_up(0.0, 0), "B": made_up(50.0, 1)}.__getitem__
    row = seat.within(get, "A", seat.OUTCOME, 1, 0)
    assert all(row["area"][kind]["mean"] > 0.95 for kind in KINDS)
    assert row["area"]["jamming"]["low"] < 0.8  # ten failures
    assert row["area, s earlier"]["8"] < 0.7 < 0.95 < row["area, s earlier"]["0"]
    assert row["said at 0.5"][APART]["specificity"] is None
    assert row["said at 0.5"][APART]["sensitivity"]["mean"] > 0.9
    other = seat.within(get, "A", seat.DEVIATION, 1, 0)["said at 0.5"][seat.EVERY]["specificity"]["mean"]
    assert other < row["said at 0.5"][seat.EVERY]["specificity"]["mean"] - 0.3
    plain, own = (seat.across(get, ("A", "B"), seat.OUTCOME, kept, 0)["area"][seat.EVERY] for kept in (False, True))
    assert own["mean"] > 0.95 > plain["mean"]


def test_the_nominal_trials_that_scale_are_not_tested() -> None:
    s = made_up(5.0, 0)
    scaled, tested = seat.nominal_scaled(s.x, s.trials.kind, 0)
    assert (tested[s.trials.kind == NOMINAL].sum(), (~tested).sum()) == (10, 10)
    np.testing.assert_allclose(np.median(scaled[:, ~tested], 1), 0.0, atol=1e-9)


def test_shares_and_areas_have_a_width() -> None:
    assert seat.area(np.array([0.1, 0.9]), np.array([0, 0])) is None
    best = seat.area(np.array([0.1, 0.2, 0.9]), np.array([0, 0, 1]))
    assert best is not None
    assert best["low"] < best["mean"] == 1.0
    assert seat.share(np.ones(2, bool), np.zeros(2, bool)) is None
    counts = np.array([5, 5, 0, 10])
    made = faults_outcome.against(counts, 5)
    assert (made["precision"]["mean"], made["specificity on seated faults"]["mean"]) == (1.0, 1.0)
    assert made["specificity on seated faults"]["low"] < 0.5  # two trials
    assert faults_outcome.against(np.array([5, 5, 10, 10]), 5)["precision"]["mean"] == pytest.approx(1 / 3, abs=1e-4)


def test_between_a_fifth_and_four_fifths_of_every_kind_failed() -> None:
    result = committed("will_it_seat")
    assert result["complete"]
    for session in seat.WITHIN:
        for kind in KINDS:
            row = result["rows"][f"{session} | trials"][kind]
            assert 0.2 <= row["failed"] / row["trials"] <= 0.8
