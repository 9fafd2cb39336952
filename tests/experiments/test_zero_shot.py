"""Zero shot: no number of a recorded session's sensor is left in the simulated one."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from experiments.classification.zero_shot import PRESET, SEED, SPEC
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
