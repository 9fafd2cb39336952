"""Sim-to-real: nothing recorded is trained on, sets are held out whole, choices are those that carry over."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from experiments._lib.benchmarks import REAL
from experiments._lib.fit_words import WORDS, tolerances
from experiments._lib.results_io import RESULTS
from experiments._lib.simulated import assembled, simulated
from experiments.classification.sim_to_real import Pool, choose, scored, some_trials
from experiments.classification.sim_to_real_fit import FIT, PROTOCOL
from experiments.classification.sim_to_real_rows import CANDIDATES, ROWS
from experiments.classification.sim_to_real_sets import RECORDED, SETS, Labelling, Sets
from experiments.figures.sim_to_real import draw, lines
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.features import FAMILIES
from rcbht_jax.io.store import write_recordings
from rcbht_jax.io.tare import tare
from rcbht_jax.plots.canvas import save
from rcbht_jax.types import Recordings
from sim_mjx.presets import ONE_ARM as PRESETS
from sim_mjx.synthesis.plan import SynthesisConfig, manifest_of, provenance

SETS_OF_POOL = ("wide A", "wide B", "wide C")
TRIALS, CLASSES = 12, ("approach", "mating")


def pool() -> Pool:
    """Two features: the class with some noise, and the class plus an offset that is each set's own."""
    rng = np.random.default_rng(0)
    place = np.repeat(SETS_OF_POOL, TRIALS * 2)
    y = np.tile([0, 1], TRIALS * 3)
    trial = np.char.add(np.char.add(place, " "), np.repeat(np.tile(np.arange(TRIALS), 3), 2).astype(str))
    offset = np.repeat([0.0, 40.0, -40.0], TRIALS * 2)
    shifting, steady = (y * 4.0 + offset)[:, None], (y * 4.0 + rng.normal(0, 1.5, len(y)))[:, None]
    return Pool({"shifting": shifting, "steady": steady}, y, trial, place, CLASSES)


def test_what_carries_over_to_another_set_is_chosen() -> None:
    some = pool()
    spec, score = choose(some)
    assert spec.features == "steady"
    assert score is not None
    assert 0.8 < score < 1.0
    inside, unknown = choose(some.take(some.rows(("wide A",))))
    assert inside.features == "shifting"  # nothing in one set says that it shifts
    assert unknown is None


def test_more_trials_hold_the_fewer_and_every_set_gives_as_many() -> None:
    some = pool()
    few, many = (some_trials(some, np.arange(len(some.y)), count, 0) for count in (3, 7))
    assert set(few) < set(many)
    assert [sum(trial.startswith(name) for trial in many) for name in SETS_OF_POOL] == [7, 7, 7]
    assert set(some_trials(some, np.arange(len(some.y)), 3, 1)) != set(few)
    assert len(some_trials(some, np.arange(len(some.y)), 99, 0)) == 3 * TRIALS


def test_scores_say_who_was_taken_for_whom() -> None:
    some = pool()
    said = some.y.copy()
    said[[0, 2, 3]] ^= 1
    found = scored(some, np.arange(len(said)), said)
    assert found["wrong"] == {"approach as mating": 2, "mating as approach": 1}
    assert found["accuracy"] == pytest.approx(1 - 3 / len(said))
    assert found["interval"][0] < found["accuracy"] < found["interval"][1]
    assert found["trials"] == 3 * TRIALS
    sure = scored(some, np.arange(len(said)), some.y)
    wilson = [1 / (1 + 1.96**2 / sure["trials"]), 1.0]  # where nothing is wrong
    assert sure["interval"] == pytest.approx(wilson, abs=1e-3)


def trials(samples: tuple[int, ...]) -> Recordings:
    count, rng = len(samples), np.random.default_rng(1)
    wrench = rng.normal(3.0, 1.0, (count, max(samples), 6)).astype(np.float32)
    for row, length in enumerate(samples):
        wrench[row, length:] = 0
    known = {"trial": np.array([f"trial {n}" for n in samples]), "outcome": np.full(count, "success")}
    return assembled(wrench, np.array(samples, np.int32), np.zeros((count, 4)), "", **known)


def test_tare_takes_the_first_second_and_nothing_later() -> None:
    before = trials((150, 400))
    other = replace(before, wrench=before.wrench.copy())
    other.wrench[1, 200:400] *= 7
    one, two = tare(before, 200), tare(other, 200)
    np.testing.assert_allclose(one.wrench[1, :200].mean(0), 0, atol=1e-5)
    np.testing.assert_array_equal(one.wrench[1, :200], two.wrench[1, :200])
    assert not one.wrench[0, 150:].any()
    assert before.wrench[1, :200].mean() > 2


def test_joined_sets_keep_every_trial() -> None:
    whole = Recordings.join([trials((150, 400)), trials((90,))])
    assert whole.wrench.shape == (3, 400, 6)
    np.testing.assert_array_equal(whole.take(np.array([2])).wrench[0, :90], trials((90,)).wrench[0])
    assert whole.trial.tolist() == ["trial 150", "trial 400", "trial 90"]


def test_a_store_of_another_job_is_refused(tmp_path: Path) -> None:
    path, job, made = tmp_path / "set.zarr", SynthesisConfig("A", 1), trials((150,))
    attrs = {"simulated": provenance(manifest_of(job)), "diverged": []}
    truth = {"seated": np.ones((1, 4), bool), "fault": np.array(["none"])}
    write_recordings(path, made, attrs, simulation=truth)
    np.testing.assert_array_equal(simulated(path, job).wrench, made.wrench)
    with pytest.raises(InputError, match=r"set\.zarr was made with other options"):
        simulated(path, replace(job, seed=1))


def test_rows_train_on_nothing_that_they_are_tested_on() -> None:
    known = {*RECORDED, *(f"{level} {preset}" for level in SETS for preset in PRESETS)}
    for name, row in ROWS.items():
        assert {*row.train, *row.test} <= known
        assert not {*row.train} & {*row.test}, name
        assert {*row.candidates} <= {*CANDIDATES}
        if "recorded" not in name:
            assert not {*row.train} & {*RECORDED}, name
    assert {family for families in CANDIDATES.values() for family in families} <= {*FAMILIES}


def test_rows_of_the_fit_rule_differ_in_their_words_only() -> None:
    known, limits = ROWS[PROTOCOL], np.arange(1.0, 7.0)
    assert not {"wide A", "wide B"} & {*known.train}
    for name, row in FIT.items():
        assert replace(row, rule=known.rule, weighing=known.weighing, factors=known.factors) == known
        config, made = WORDS.get(name, WORDS["fit"]).encoder(limits, 0.005)
        assert isinstance(config, FitConfig) == (row.rule == "fit")
        if isinstance(made, FitLimits):
            np.testing.assert_allclose(made.tolerance, row.factors[0] * limits)
    assert FIT["paper"] == known


def test_a_set_is_labelled_by_the_rule_of_its_tolerance(tmp_path: Path) -> None:
    some = trials((150, 400))
    some = replace(some, session=np.full(2, "A"))
    both = Labelling(tare=False, tolerances=((0.5,) * 6, (0.1,) * 6))
    for tolerance, made in zip((0.5, 0.1), Sets(tmp_path, some).tracks("A", both).values(), strict=True):
        expected = rj.encode(some.wrench, rate=200, lengths=some.length, rule="fit", tolerance=tolerance)
        np.testing.assert_array_equal(made.llb.label, expected.llb.label)
    (paper,) = Sets(tmp_path, some).tracks("A", Labelling(tare=False)).values()
    np.testing.assert_array_equal(paper.llb.label, rj.encode(some.wrench, rate=200, lengths=some.length).llb.label)


def test_the_robots_tolerance_is_of_session_a_alone() -> None:
    both = replace(trials((400, 400)), session=np.array(["A", "B"]), source=np.full(2, REAL))
    louder = replace(both, wrench=both.wrench * np.array([1, 5], np.float32)[:, None, None])
    np.testing.assert_array_equal(tolerances(both)[REAL], tolerances(louder)[REAL])
    quiet = replace(both, wrench=both.wrench * np.array([0.1, 1], np.float32)[:, None, None])
    np.testing.assert_allclose(tolerances(quiet)[REAL], tolerances(both)[REAL] / 10, rtol=1e-4)


def test_figure_shows_the_committed_rows(tmp_path: Path) -> None:
    rows = json.loads((RESULTS / "sim_to_real.json").read_text())["result"]["rows"]
    shown = lines(rows)
    assert "main | all presets" in shown
    assert not any("draw" in name for name in shown)
    save(draw(rows), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
