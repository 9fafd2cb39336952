"""Simulated trials that were fitted to no recorded session, and recorded ones, tared, as one data set.

One part, that of the OpenHRP preset, which was fitted to the authors' own simulation; a sensor such as data sheets
describe (unit gain, a low pass of 10 Hz, noise of a twentieth of a percent of 200 N and 10 Nm, moments about a point
5 cm from the wrist); widely randomised placement, parts, gains, set-points, speed, noise and drift. Of every trial the
mean of its first second is subtracted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments._lib.benchmarks import recorded
from experiments._lib.simulated import simulated
from rcbht_jax.io.tare import tare
from rcbht_jax.types import Recordings
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.plan import SynthesisConfig

TARE_SECONDS = 1.0  # of free space at the beginning of every trial
# Variation between robots, parts and days, chosen without data: half to twice each unknown physical parameter.
WIDE = DomainRandomization(
    nominal_share=1.0, shift=(-2e-3, 2e-3), turn=(-0.02, 0.02), stiffness=(0.5, 2.0), overlap=(0.8, 1.1),
    friction=(0.5, 2.0), mount=(0.6, 1.7), gain=(0.8, 1.25), goal=(0.7, 1.4), speed=(0.6, 1.6), lag=(3, 8),
    noise=(0.5, 2.0), force_bias=(-1.0, 1.0), moment_bias=(-0.05, 0.05), tare=(0.8, 1.0), mating=(1.0, 20.0),
)  # fmt: skip
SEED, TRIALS, PRESET = 40, 256, "openhrp"
SESSIONS, SIMULATED = ("A", "B"), "simulated"
WORN = "A"  # a session's sensor has to be named for noise and drift to vary; every number of it is replaced below
SENSOR = (
    ("sensor.a", 0.73), ("sensor.b", 0.27), ("sensor.c", 1.0), ("sensor.d", 0.0),  # 10 Hz at 200 Hz, unit gain
    ("sensor.delay", 5.0), ("sensor.tared", 1.0),
    ("sensor.noise[0:3]", 0.1), ("sensor.noise[3:6]", 0.005), ("sensor.step[0:3]", 0.02), ("sensor.step[3:6]", 0.001),
    ("sensor.bias", 0.0), ("sensor.reference[0]", -0.05), ("sensor.reference[1:3]", 0.0),
)  # fmt: skip
SPEC = replace(WIDE, mating=(0.5, 30.0), sensor=WORN, physical=SENSOR)


def simulated_and_recorded(folder: Path, seed: int = SEED) -> Recordings:
    """The trials of session "simulated", kept in the folder and made if they are missing, then those of A and B."""
    job = SynthesisConfig(PRESET, TRIALS, seed, shard=64, spec=SPEC)
    known, made = recorded(), simulated(folder / f"zero-shot-{TRIALS}.zarr", job)
    real = known.take(np.isin(known.session, SESSIONS))
    made = replace(made, session=np.full(len(made), SIMULATED))
    return tare(Recordings.join([made, real]), round(TARE_SECONDS / real.dt))
