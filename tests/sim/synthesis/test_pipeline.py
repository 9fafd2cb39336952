"""Synthesis: the same bytes whatever the shards, in the store what was simulated; what cannot be is refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import xarray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_attrs, read_recordings, read_simulation, write_recordings
from rcbht_jax.labels import LAYERS
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals, unlabelled_intervals
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import one_arm
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import tables
from sim_mjx.synthesis.pipeline import LANE, SynthesisProgress, balanced, synthesise
from tests.support.fake_simulation import JOB, SMALL, fake_engine, short
from tests.support.snaps import deviation
from tests.support.store_cases import same
from tests.support.trees import assert_trees_equal


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The uninterrupted result of JOB."""
    target = tmp_path_factory.mktemp("whole") / "trials.zarr"
    synthesise(target, JOB, simulate=fake_engine)
    return target


def changed(change: Callable[[Rollouts], None]) -> Callable[[TrialParams], Rollouts]:
    def engine(params: TrialParams) -> Rollouts:
        out = fake_engine(params)
        change(out)
        return out

    return engine


@pytest.mark.parametrize("shard", [7, 60, 1000])
def test_size_of_shards_divides_the_files_and_no_more(shard: int, whole: Path, tmp_path: Path) -> None:
    target = tmp_path / "trials.zarr"
    report = synthesise(target, replace(JOB, shard=shard), simulate=fake_engine)
    same(read_recordings(target), read_recordings(whole))
    found, expected = read_simulation(target), read_simulation(whole)
    assert_trees_equal(found, expected)
    assert (report.stored, report.resumed, report.diverged) == (60, 0, [])
    assert os.listdir(tmp_path) == ["trials.zarr"]


def test_store_holds_what_was_simulated(whole: Path) -> None:
    recordings, simulation = read_recordings(whole), read_simulation(whole)
    params, faults = get_scenario("B").draw_batch(5, range(60), JOB.spec)
    out = fake_engine(params)
    assert np.array_equal(recordings.wrench, out.wrench)
    assert np.array_equal(recordings.length, out.length)
    assert np.array_equal(recordings.outcome == "success", out.seated.all(1))
    assert set(recordings.outcome) == {"success", "failure"}
    assert simulation["fault"].tolist() == [fault.kind for fault in faults]
    assert recordings.column("failure_type").tolist() == [fault.failure_type for fault in faults]
    assert np.array_equal(deviation(recordings), [fault.deviation for fault in faults])
    assert np.array_equal(simulation["hook_overlap"], params.parts.hook_overlap)
    assert np.array_equal(simulation["seated"], out.seated)
    assert set(recordings.source) == {"SIM_MJX_B"}
    assert set(recordings.session) == {"sim-B"}
    assert recordings.trial[3] == "sim-B-000003"
    # a fault that seats all the same is a success with its fault
    assert ((simulation["fault"] != "none") & (recordings.outcome == "success")).any()
    assert set(simulation["failed_in"][recordings.outcome == "success"]) == {""}
    assert read_attrs(whole)["simulated"]["job"]["seed"] == 5


def test_store_opens_in_xarray(whole: Path) -> None:
    with xarray.open_zarr(whole) as data:
        assert data["wrench"].dims == ("trial", "time", "axis")
    with xarray.open_zarr(whole, group="simulation") as data:
        assert data["seated"].shape == (60, 4)


def test_a_trial_that_stops_early_has_failed_in_its_last_state(tmp_path: Path) -> None:
    def stop(out: Rollouts) -> None:
        out.onset[:, 2:] = np.nan
        out.seated[:] = False

    synthesise(tmp_path / "t.zarr", SMALL, simulate=changed(stop))
    assert set(read_simulation(tmp_path / "t.zarr")["failed_in"]) == {"rotation"}


def test_one_sample_of_rotation_is_harmonised_by_the_tilt(tmp_path: Path) -> None:
    # session B's last waypoint with an upright hand
    upright = np.array([-0.0180, -0.0016, -1.7158, 0.2649, 0.1478, 0.0557])
    tilt = np.degrees(kinematics.tilt(kinematics.fk(upright + np.eye(6)[4:5] * [[0.0], [0.09]])[1]))
    assert tilt[0] < 1.0
    assert tilt[1] > 3.0

    def turn(out: Rollouts) -> None:
        out.joints[:] = upright + np.array([0, 0, 0, 0, 0.09, 0])
        out.joints[:, 5:] = upright

    synthesise(tmp_path / "t.zarr", SMALL, simulate=changed(turn))
    recordings = read_recordings(tmp_path / "t.zarr")
    assert set(recordings.note) == {"harmonised"}
    np.testing.assert_allclose(recordings.starts(RECORDED)[:, 2], 0.015)
    np.testing.assert_allclose(recordings.starts(HARMONISED)[:, 2], 0.025)


def wild(out: Rollouts, how: str) -> None:
    rows = slice(1, None, 5)
    if how == "marked":
        out.diverged[rows] = True
    elif how == "nan":
        out.wrench[rows, 4, 2] = np.nan
    elif how == "huge":
        out.wrench[rows, 4, 2] = -1e7
    else:
        out.joints[rows, 6:8] = 2.0


@pytest.mark.parametrize("how", ["marked", "nan", "huge", "jump"])
def test_diverged_trials_are_listed_and_never_stored(how: str, tmp_path: Path) -> None:
    target = tmp_path / "t.zarr"
    job = replace(SMALL, shard=16)
    report = synthesise(target, job, simulate=changed(lambda out: wild(out, how)))
    assert report.diverged == [1, 6, 11] == read_attrs(target)["diverged"]
    assert read_simulation(target)["index"].tolist() == [0, 2, 3, 4, 5, 7, 8, 9, 10]
    recordings = read_recordings(target)
    assert recordings.trial[1] == "sim-B-000002"
    params, _ = get_scenario("B").draw(5, 2, job.spec)
    alone = fake_engine(jax.tree.map(lambda leaf: np.asarray(leaf)[None], params))
    assert np.array_equal(recordings.wrench[1, : recordings.length[1]], alone.wrench[0])


def test_nothing_is_stored_when_all_diverged(tmp_path: Path) -> None:
    def all_of_them(out: Rollouts) -> None:
        out.diverged[:] = True

    with pytest.raises(InputError, match="diverged in every trial; nothing to store"):
        synthesise(tmp_path / "t.zarr", SMALL, simulate=changed(all_of_them))
    assert not (tmp_path / "t.zarr").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"preset": "D"}, "openhrp"),
        ({"trials": 0}, "number of trials"),
        ({"trials": 10**18}, "number of trials is 1000000000000000000"),
        ({"trials": 200_001, "shard": 1}, "in shards of 1; expected at most 5000000, in 200000 shards"),
        ({"shard": 0}, "shard"),
        ({"seed": -1}, "seed"),
        ({"engine": "abacus"}, "native"),
        ({"spec": DomainRandomization(nominal_share=2.0)}, "nominal share"),
    ],
)
def test_impossible_jobs_are_refused(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        synthesise(tmp_path / "t.zarr", replace(SMALL, **change), simulate=fake_engine)
    assert os.listdir(tmp_path) == []


def test_a_store_without_a_name_is_refused() -> None:
    with pytest.raises(InputError, match="not a name for a store"):
        synthesise(Path(""), SMALL, simulate=fake_engine)


def test_an_existing_store_is_only_replaced_when_asked(whole: Path, tmp_path: Path) -> None:
    """Not even then one that came while trials were simulated."""
    target, other = tmp_path / "t.zarr", read_recordings(whole)
    write_recordings(target, other, {})
    with pytest.raises(InputError, match="--overwrite"):
        synthesise(target, SMALL, simulate=fake_engine)
    assert len(read_recordings(target)) == 60
    again = partial(synthesise, target, SMALL, simulate=fake_engine, overwrite=True)
    with pytest.raises(InputError, match="exists already"):
        again(ready=lambda _: write_recordings(target, other, {}, overwrite=True))
    assert len(read_recordings(target)) == 60
    assert again().resumed == 12
    assert len(read_recordings(target)) == 12
    assert os.listdir(tmp_path) == ["t.zarr"]


def test_progress_counts_trials(tmp_path: Path) -> None:
    seen: list[SynthesisProgress] = []
    synthesise(tmp_path / "t.zarr", SMALL, simulate=fake_engine, progress=seen.append)
    assert [now.done for now in seen] == [0, 5, 10, 12]
    assert seen[0].seconds_left is None
    assert seen[-1].seconds_left == 0.0
    assert all(now.per_minute > 0 and now.total == 12 for now in seen[1:])


def test_labels_are_those_of_the_stored_wrench_whatever_the_shards(tmp_path: Path) -> None:
    job = replace(SMALL, window=5)
    for name, shard in (("a", 5), ("b", 12)):
        synthesise(tmp_path / name, replace(job, shard=shard), simulate=fake_engine)
    found, how = read_tracks(tmp_path / "a", "online-W5")
    assert_trees_equal(found, read_tracks(tmp_path / "b", "online-W5")[0])
    recordings = read_recordings(tmp_path / "a")
    expected = encode_batch(EncoderConfig(window=5), preset("hiro"), recordings.wrench, recordings.length)
    assert how["thresholds"] == preset("hiro").limits.tolist()
    for layer in LAYERS:
        theirs = getattr(expected, layer).label
        assert np.array_equal(getattr(found, layer).label[:, :, : theirs.shape[2]], theirs)
        assert not getattr(found, layer).label[:, :, theirs.shape[2] :].any()


def test_physics_of_a_trial_does_not_depend_on_its_batch() -> None:
    engine = partial(engines.simulate, one_arm())
    whole_batch, _ = get_scenario("A").draw_batch(4, range(32), short(longest=0.8))
    reference = engine(whole_batch)
    assert np.abs(reference.wrench).max() > 0.1
    for rows in ([30], [5, 17, 2], list(range(1, 20))):
        params = jax.tree.map(lambda leaf, rows=rows: leaf[np.array(rows)], whole_batch)
        out = engine(params)
        for place, row in enumerate(rows):
            samples = reference.length[row]
            assert out.length[place] == samples
            assert np.array_equal(out.wrench[place, :samples], reference.wrench[row, :samples])
            assert np.array_equal(out.joints[place, :samples], reference.joints[row, :samples])
            assert np.array_equal(out.onset[place], reference.onset[row], equal_nan=True)
            assert np.array_equal(out.seated[place], reference.seated[row])


@pytest.mark.parametrize(
    ("trials", "most", "memory", "expected"),
    [
        (100, 1000, None, 100),
        (1001, 1000, None, 501),  # not one wave of 1000 and one of a single trial
        (3000, 1000, None, 1000),
        (100, 1000, 10 * LANE, 10),
        (5, 1000, 1, 1),
    ],
)
def test_waves_are_equally_large_and_fit_into_the_memory(
    trials: int, most: int, memory: int | None, expected: int
) -> None:
    assert balanced(trials, most, memory) == expected


@pytest.mark.parametrize(
    ("longest", "limit", "ended"),
    [
        (None, 40.0, "failure"), (0.3, 40.0, "unfinished"), (39.9, 40.0, "unfinished"), (40.0, 40.0, "failure"),
        (0.3, 0.2999, "failure"), (0.3, 0.3, "failure"), (40.0, 50.0, "unfinished"), (41.0, 50.0, "unfinished"),
        (41.0, 40.0, "failure"),
    ],
)  # fmt: skip
def test_a_trial_that_is_ended_before_the_controllers_limit_is_unfinished(
    longest: float | None, limit: float, ended: str
) -> None:
    """It is 40 s in session A, or what a fault makes of it. A trial that ended by itself, or is seated, is not cut."""
    end = min(limit, longest or limit)
    last = round(end / 0.005) + 1
    rows = {
        "seated": np.array([[False, True], [False, True], [True, True]]),
        "length": np.array([last, last - 1, last]),
    }
    scenario = get_scenario("hooked-A")
    params, _ = scenario.draw_batch(0, range(3), scenario.spec())
    params = replace(params, task=replace(params.task, timeout=np.full(3, limit)))
    assert tables.outcomes(scenario, rows, params, longest).tolist() == [ended, "failure", "success"]


def test_an_unfinished_trial_has_not_failed_in_a_state_and_has_no_class(tmp_path: Path) -> None:
    def stop(out: Rollouts) -> None:
        out.seated[:9] = False

    synthesise(tmp_path / "t.zarr", replace(SMALL, shard=12, spec=short()), simulate=changed(stop))
    recordings, simulation = read_recordings(tmp_path / "t.zarr"), read_simulation(tmp_path / "t.zarr")
    cut = (recordings.length > 20) & ~simulation["seated"].all(1)
    assert np.array_equal(recordings.outcome == "unfinished", cut)
    assert 0 < cut[:9].sum() < 9
    assert np.array_equal(simulation["failed_in"] != "", recordings.outcome == "failure")
    items = labelled_intervals(recordings, TaskSpec("outcome"))
    assert (items.classes, items.dropped) == (("failure", "success"), {"class unknown": int(cut.sum())})
    assert len(unlabelled_intervals(recordings, TaskSpec("outcome")).row) == 12
