"""Passes of tabs beneath their lips: found in logs, the same in every engine, and a track of a store."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from rcbht_jax.io import store
from rcbht_jax.robots.snap_assembly import HARMONISED, MERGED, RECORDED
from sim_mjx.assembly.parts import TABS
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device, native
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.passes import TRACK, passes_of
from sim_mjx.synthesis.pipeline import synthesise
from tests.support.fake_simulation import SMALL, fake_engine
from tests.support.plunger import plunger, plunger_trials


def slowly(past: np.ndarray, length: int) -> list[tuple[int, int, int]]:
    """One trial, sample by sample: start, tab, end."""
    passes, since = [], dict[int, int]()
    for sample in range(1, length):
        for tab in range(past.shape[1]):
            if past[sample, tab] and not past[sample - 1, tab]:
                since[tab] = sample
            if not past[sample, tab] and tab in since:
                passes.append((since.pop(tab), tab, sample))
    return sorted(passes + [(start, tab, length) for tab, start in since.items()])


@pytest.mark.parametrize("seed", range(4))
def test_passes_are_those_that_a_loop_over_samples_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    past = np.cumsum(rng.random((9, 40, 3)) < 0.1, axis=1) % 2 == seed % 2  # in the half of them in from the start
    length = rng.integers(0, 41, 9)
    past[0], length[0] = False, 40
    found = passes_of(past, length)
    for row, known in zip(found, (slowly(*trial) for trial in zip(past, length, strict=True)), strict=True):
        rows = [(start, tab, end) for tab, start, end in row.tolist() if end]
        assert rows == known
        assert not row[len(known) :].any()
    assert found.any()


def test_a_device_finds_the_passes_of_c_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball falls beneath a height, of which each period of two steps logs the side on which it begins."""
    monkeypatch.setattr(device, "LANES", 8)
    scene, params = replace(plunger(), substeps=2), plunger_trials(np.full(8, 1.0))
    expected = native.simulate(scene, params)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        found = device.simulate(scene, params, "jax")
    passes = [passes_of(run.past, run.length) for run in (expected, found)]
    assert passes[0][..., 2].any(1).sum() > 3
    np.testing.assert_array_equal(passes[1], passes[0])
    np.testing.assert_array_equal(found.seated, expected.seated)


@pytest.mark.parametrize(("preset", "arms"), [("hooked-B", 1), ("two", 2)])
def test_a_store_has_a_track_of_passes_behind_the_states(tmp_path: Path, preset: str, arms: int) -> None:
    scenario = get_scenario(preset)
    job = replace(SMALL, preset=preset, seed=1)

    def engine(params: Any) -> Rollouts:
        out = fake_engine(params)
        return replace(out, wrench=np.tile(out.wrench, arms))

    synthesise(tmp_path / "trials.zarr", job, simulate=engine)
    recordings = store.read_recordings(tmp_path / "trials.zarr")
    marks = recordings.annotations
    assert marks.tracks == (RECORDED, HARMONISED, MERGED, TRACK)
    assert (marks.choose(), marks.labels[TRACK]) == (HARMONISED, TABS)
    run = engine(scenario.draw_batch(job.seed, range(job.trials), job.spec)[0])
    for row, length in enumerate(recordings.length.tolist()):
        passed = marks.of_recording(row).of(TRACK)
        seated = np.flatnonzero(run.seated[row // arms])
        assert passed.names().tolist() == [TABS[tab] for tab in seated]
        np.testing.assert_array_equal(passed.start, (6 + seated) * CONTROL_PERIOD)
        np.testing.assert_array_equal(passed.end, length * CONTROL_PERIOD)
    assert 0 < len(marks.of(TRACK)) < len(recordings) * len(TABS)
