"""Randomised two-arm trials: the distributions and faults of one arm, turned sideways, and what the left arm adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_mjx.assembly.rollout import repeated
from sim_mjx.assembly.two_arm_program import TwoArmParams
from sim_mjx.assembly.two_arm_scene import ARMS
from sim_mjx.presets.session import Range
from sim_mjx.presets.two_arm import TwoArmPreset
from sim_mjx.randomization import overrides, trials
from sim_mjx.randomization.trials import DomainRandomization, Fault

MATING_TIME: Range = (0.15, 0.96)  # s, recorded after mating begins: lowest and highest of 13 trials
CHATTER: Range = (0.8, 1.2)  # factor on the contact's chatter; chosen
# The recorded trials repeat one pose with the same gains; the remaining ranges are small, and chosen.
REPEATED = DomainRandomization(
    nominal_share=1.0, shift=(-1e-4, 1e-4), turn=(-1e-3, 1e-3), stiffness=(1.0, 1.0), overlap=(1.0, 1.0),
    friction=(1.0, 1.0), mount=(1.0, 1.0), gain=(1.0, 1.0), goal=(1.0, 1.0), speed=(1.0, 1.0),
)  # fmt: skip
FORCE_DRIFT: Range = (-0.05, 0.05)  # N, either wrist's free-space offset; chosen
MOMENT_DRIFT: Range = (-0.003, 0.003)  # Nm, likewise


def sample_batch(
    preset: TwoArmPreset, seed: int, indices: Sequence[int], spec: DomainRandomization
) -> tuple[TwoArmParams, list[Fault]]:
    """Two-arm trials; arguments and errors of ``trials.sample_batch``.

    The sensors are OpenHRP's, whose noise and tare do not vary; physical parameters of the sensor are those of both
    wrists. A fault's deviation is the right hand's from the part, x forward and y up.
    """
    trials.check(spec)
    spans = [spec.goal, spec.goal, spec.gain, spec.gain]
    spans += [span for _ in ARMS for span in (FORCE_DRIFT, MOMENT_DRIFT) for _ in range(3)]
    low, high = np.array([*spans, spec.mating or MATING_TIME, CHATTER]).T
    drawn = np.stack([trials.stream(seed, index, branch=1).uniform(low, high) for index in indices])
    right, faults = trials.sample_batch(preset, seed, indices, spec, drawn[:, -2])
    left = overrides.apply_overrides(preset.left_sensor, "sensor", spec.physical)
    hold, left_sensor = repeated((preset.hold, left), len(indices))
    return TwoArmParams(
        task=right.task,
        hold=replace(
            hold,
            force=hold.force * drawn[:, :1, None],
            moment=hold.moment * drawn[:, 1:2, None],
            force_gain=hold.force_gain * drawn[:, 2],
            moment_gain=hold.moment_gain * drawn[:, 3],
        ),
        sensor=right.sensor,
        left_sensor=left_sensor,
        offset=preset.offset + drawn[:, 4:-2],
        chatter=preset.chatter * drawn[:, -1],
        parts=right.parts,
        command_delay=right.command_delay,
        seed=right.seed,
    ), faults
