"""Simulated trials as a corpus: which ones count, where their states begin, and that scores need no copy."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.calibration.search import score_candidates
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from sim_mjx.assembly import task
from sim_mjx.assembly.task import CONTROL_PERIOD, STATES
from sim_mjx.engines import device
from sim_mjx.engines.common import collect
from sim_mjx.synthesis import calibration_data

CONFIG = EncoderConfig(5, CONTROL_PERIOD)
SPANS = {  # logged periods of approach, rotation, insertion, pre-mating, mating
    "good": (100, 60, 40, 0, 90), "premating": (90, 50, 30, 20, 80), "no time left": (100, 60, 120, 0, 0),
    "unseated": (80, 60, 40, 0, 90), "diverged": (100, 60, 40, 0, 90),
}  # fmt: skip


@pytest.fixture(scope="module")
def out() -> device.Outcome:
    samples = 320
    phase = np.full((len(SPANS), samples), task.ENDED, np.int32)
    for row, spans in enumerate(SPANS.values()):
        logged = np.repeat(np.arange(5), spans)
        phase[row, : len(logged)] = logged
    rng = np.random.default_rng(0)
    steep = 0.02 * (1 + 9 * (np.arange(samples) // 80 % 2))
    wrench = np.cumsum(rng.normal(size=(len(SPANS), samples, 6)) * steep[:, None], axis=1).astype(np.float32)
    wrench[phase == task.ENDED] = np.nan  # means nothing there
    wrench[4, 50, 2] = np.inf
    past = np.ones((len(SPANS), samples, 4), bool)
    past[3, :, 1] = False
    joints = np.zeros((len(SPANS), samples, 6), np.float32)
    return device.Outcome(*(jnp.asarray(leaf) for leaf in (wrench, joints, phase, past)))


def test_states_are_those_of_the_trials_on_the_host(out: device.Outcome) -> None:
    data = calibration_data.states_corpus(out, CONFIG)
    assert len(data) == 2  # "good" and "premating"
    host = collect(*(np.asarray(leaf) for leaf in (out.wrench, out.joints, out.phase, out.past)))
    starts = np.rint(host.onset[:2] / CONTROL_PERIOD)
    np.testing.assert_array_equal(data.edges, np.c_[starts, host.length[:2]])
    np.testing.assert_array_equal(data.y, np.tile(np.arange(len(STATES)), (2, 1)))
    np.testing.assert_array_equal(
        data.wrench[:, :290], np.where(np.isnan(out.wrench[:2, :290]), 0, out.wrench[:2, :290])
    )


def test_failures_are_one_sentence_each(out: device.Outcome) -> None:
    data = calibration_data.whole_corpus(out, np.array([0, 1, 1, 0, 1]), ("a", "b"), CONFIG)
    np.testing.assert_array_equal(data.edges, [[0, 270]])
    np.testing.assert_array_equal(data.y, [[0]])
    with pytest.raises(InputError, match="None of the 5"):
        calibration_data.whole_corpus(out, np.full(5, -1), ("a", "b"), CONFIG)


def test_scores_of_rollouts_need_no_copy(out: device.Outcome) -> None:
    """The chain alone; experiments/calibration/on_device.py checks that physics stays on the device."""
    many = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * 3), out)
    limits = np.asarray(preset().limits)[None]
    with jax.transfer_guard("disallow"):
        made = score_candidates(calibration_data.states_corpus(out, CONFIG), CONFIG, limits)
    assert np.isfinite(made).all()
    assert len(calibration_data.states_corpus(many, CONFIG)) == 6
    with pytest.raises(InputError, match="None of the"):
        calibration_data.states_corpus(replace(out, past=jnp.zeros_like(out.past)), CONFIG)
