"""Zero shot: no number of a recorded session's sensor is left in the simulated one."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from experiments._lib.zero_shot_set import PRESET, SEED, SPEC
from experiments.online import causal, zero_shot_stream
from sim_mjx.presets import preset
from sim_mjx.randomization.trials import sample


def test_the_sensor_does_not_depend_on_the_session_that_it_is_named_after() -> None:
    for index in range(3):
        one, other = (
            sample(preset(PRESET), SEED, index, replace(SPEC, sensor=session))[0].sensor for session in ("A", "B")
        )
        assert all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    kept = sample(preset(PRESET), SEED, 0, replace(SPEC, physical=SPEC.physical[1:]))[0].sensor
    assert not np.array_equal(kept.a, one.a)  # what is not replaced is a session's
    assert not preset(PRESET).real


def test_a_recorded_session_that_is_streamed_does_not_train() -> None:
    stream: Any = SimpleNamespace(items=SimpleNamespace(session=np.array(["simulated", "A", "B"])))
    masks = {name: causal.inside_of(stream, split, 0).tolist() for name, split in zero_shot_stream.SPLITS.items()}
    assert masks == {
        "simulated to A and B": [True, False, False],
        "simulated and A to B": [True, True, False],
        "simulated and B to A": [True, False, True],
        "A alone to B": [False, True, False],
        "B alone to A": [False, False, True],
    }
