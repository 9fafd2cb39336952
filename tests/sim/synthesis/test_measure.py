"""What a device reduces trials to is what the host makes of their logs."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sim_mjx.assembly.rollout import ONE_ARM
from sim_mjx.engines import device
from sim_mjx.engines.device import Outcome
from sim_mjx.synthesis import records
from sim_mjx.synthesis.in_lanes import LENGTHS, cut, measure, to_host

TRIALS, SAMPLES = 12, 60


def outcome(seed: int) -> Outcome:
    """Random logs: trials of all lengths and phases, of which some diverge in each of the ways."""
    rng = np.random.default_rng(seed)
    ends = np.sort(rng.integers(1, SAMPLES + 10, (TRIALS, ONE_ARM.ended)), axis=1)
    ends[0] = 2, 3, SAMPLES - 20, SAMPLES - 9, SAMPLES  # a rotation of one sample
    phase = (np.arange(SAMPLES)[None, :, None] >= ends[:, None]).sum(2)
    wrench = rng.normal(0, 20, (TRIALS, SAMPLES, 6))
    joints = 0.1 * np.arange(6) + np.cumsum(rng.normal(0, 0.01, (TRIALS, SAMPLES, 6)), 1)
    wrench[1, 0, 2], wrench[2, 0, 0], wrench[3, 0, 5] = np.nan, 3000.0, 1e6
    joints[4, 0, 1], joints[5, 1:, 3] = np.nan, 4.0
    phase[6, -1] = ONE_ARM.ended
    wrench[6, -1], joints[6, -1] = np.nan, np.nan  # after its end
    past = np.cumsum(rng.random((TRIALS, SAMPLES, 4)) < 0.05, axis=1) % 2 == 1  # in and out again
    return Outcome(
        jnp.asarray(wrench, jnp.float32), jnp.asarray(joints, jnp.float32), jnp.asarray(phase, jnp.int32),
        jnp.asarray(past),
    )  # fmt: skip


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_device_stores_what_the_host_would(seed: int, recorded: bool) -> None:
    logs = outcome(seed)
    found = to_host(measure(logs, recorded), logs.program)
    expected = records.of_trials(device.to_host(logs), recorded)
    assert set(found) == set(expected)
    assert found["diverged"].tolist()[1:7] == [True, True, True, True, True, False]
    assert ((found["onset_harmonised"] != found["onset"]) & np.isfinite(found["onset"])).any() == recorded
    kept = ~expected["diverged"]  # of a diverged trial nothing but its mark is stored
    for name in expected:
        np.testing.assert_array_equal(found[name][kept], expected[name][kept], err_msg=name)
    assert not found["wrench"][~kept].any()
    assert not found["seated"][~kept].any()


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("used", [1, 13, 41, SAMPLES])
def test_trials_are_cut_behind_all_of_them(used: int, recorded: bool) -> None:
    """What is stored is the same, and few lengths are compiled."""
    logs = outcome(used)
    there = measure(replace(logs, phase=logs.phase.at[:, used:].set(ONE_ARM.ended)), recorded)
    short = cut(there, used)
    assert used <= short.wrench.shape[1] <= used + SAMPLES / LENGTHS + 1
    assert short.past.shape[1] == short.wrench.shape[1]
    for name, expected in to_host(there, ONE_ARM).items():
        np.testing.assert_array_equal(to_host(short, ONE_ARM)[name], expected)
    assert len({cut(there, samples).wrench.shape for samples in range(1, SAMPLES + 1)}) <= LENGTHS
