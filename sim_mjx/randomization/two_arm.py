"""Randomised two-arm trials: the distributions and faults of one arm, turned sideways, and what the left arm adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.two_arm_program import TwoArmParams
from sim_mjx.assembly.two_arm_scene import ARMS
from sim_mjx.presets.session import Range
from sim_mjx.presets.two_arm import TwoArmPreset
from sim_mjx.randomization import trials
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


def sample(preset: TwoArmPreset, seed: int, index: int, spec: DomainRandomization) -> tuple[TwoArmParams, Fault]:
    """One two-arm trial.

    Args:
        preset: nominal values.
        seed: of the whole set, 0 to 2^64 - 1.
        index: of the trial within the set, >= 0.
        spec: the distributions; the sensors are OpenHRP's, whose noise and tare do not vary.

    Returns:
        its parameters (a single trial: leaves have no batch axis) and its fault, whose deviation is the right hand's
        from the part, x forward and y up.

    Raises:
        InputError: negative seed or index, or impossible distributions.
    """
    right, fault = trials.sample(preset, seed, index, spec)
    rng = trials.stream(seed, index, branch=1)
    hold = replace(
        preset.hold,
        force=preset.hold.force * rng.uniform(*spec.goal),
        moment=preset.hold.moment * rng.uniform(*spec.goal),
        force_gain=preset.hold.force_gain * rng.uniform(*spec.gain),
        moment_gain=preset.hold.moment_gain * rng.uniform(*spec.gain),
    )
    drift = [rng.uniform(*span, 3) for _ in ARMS for span in (FORCE_DRIFT, MOMENT_DRIFT)]
    params = TwoArmParams(
        task=replace(right.task, mating_time=np.array(rng.uniform(*MATING_TIME))),
        hold=hold,
        sensor=right.sensor,
        left_sensor=preset.left_sensor,
        offset=preset.offset + np.concatenate(drift),
        chatter=np.array(preset.chatter * rng.uniform(*CHATTER)),
        parts=right.parts,
        command_delay=right.command_delay,
        seed=right.seed,
    )
    return params, fault
