"""Simulated sets for ``experiments.classification.sim_to_real``: each session with no, mild or wide randomisation.

Every simulated set is a store, made when it is first asked for. The name of a set is a recorded session, or a level of
randomisation and a simulated one, such as "wide B".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from experiments._lib.simulated import simulated
from experiments._lib.tasks import states
from experiments._lib.zero_shot_set import TARE_SECONDS, WIDE
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import config_of, limits_for
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import FAMILIES, Features, FeatureSpec
from rcbht_jax.io.tare import tare
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features, labelled_intervals
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.plan import SynthesisConfig

SEED = 20
# Session -> the preset that simulates it: hooks that catch, one part for A, B and C.
PRESETS = {"A": "hooked-A", "B": "hooked-B", "C": "hooked-C", "openhrp": "openhrp"}
ONE = (1.0, 1.0)
NONE = DomainRandomization(
    nominal_share=1.0, shift=(0.0, 0.0), turn=(0.0, 0.0), stiffness=ONE, overlap=ONE, friction=ONE, mount=ONE,
    gain=ONE, goal=ONE, speed=ONE, noise=ONE, force_bias=(0.0, 0.0), moment_bias=(0.0, 0.0), tare=ONE,
)  # fmt: skip
MILD = DomainRandomization(nominal_share=1.0)


@dataclass(frozen=True)
class SimulatedSet:
    """How one level of randomisation is simulated."""

    spec: DomainRandomization
    trials: int  # per preset


# The recorded sessions; C's trials are failures, of which those count that reached every state.
RECORDED = {
    "A": states(sessions=("A",)),
    "B": states(sessions=("B",)),
    "C": states(sessions=("C",), outcomes=("failure",)),
    "SIM1": states(sessions=("SIM1",)),
}
SPEC = FeatureSpec(families=tuple(family for family in FAMILIES if family != "sentence"))

SETS = {
    "none": SimulatedSet(NONE, 64),
    "mild": SimulatedSet(MILD, 128),
    "wide": SimulatedSet(WIDE, 256),
    "own-end": SimulatedSet(replace(WIDE, mating=None), 64),  # as wide, but each preset's own time of mating
    "ideal": SimulatedSet(WIDE, 64),  # as wide, but the OpenHRP preset keeps its noise-free sensor
}
WORN = "A"  # a robot's sensor has noise, which the OpenHRP preset's has not: it wears this session's


@dataclass(frozen=True)
class Labelling:
    """How a wrench becomes labels."""

    window: int = 5  # samples
    tare: bool = True  # subtract the mean of the first second
    limits: tuple[tuple[float, ...], ...] | None = None  # [6][4]; None = the preset
    tolerances: tuple[tuple[float, ...], ...] = ()  # [encoder][6] of the fit rule; none = the paper's rule
    weighing: tuple[str, ...] = ()  # of labels in the family histogram


class Sets:
    """Sets by name, each read, labelled and described once."""

    def __init__(self, folder: Path, recorded: Recordings, seed: int = SEED) -> None:
        self.folder, self.recorded, self.seed = folder, recorded, seed

    @cache  # noqa: B019 (one object lives as long as the program)
    def recordings(self, name: str, tared: bool) -> Recordings:
        """The trials of a set; a simulated one is made where it is missing."""
        if name in RECORDED:
            (session,) = RECORDED[name].sessions
            found = self.recorded.take(self.recorded.session == session)
        else:
            level, which = name.split()
            found = make(self.folder, level, which, self.seed)
        return tare(found, round(TARE_SECONDS / found.dt)) if tared else found

    @cache  # noqa: B019
    def items(self, name: str, boundaries: str) -> LabelledIntervals:
        """One sentence per state of the trials that reached every state."""
        spec = RECORDED.get(name, states(outcomes=()))
        return labelled_intervals(self.recordings(name, True), replace(spec, boundaries=boundaries))

    @cache  # noqa: B019
    def tracks(self, name: str, how: Labelling) -> dict[str, LabelTracks]:
        """Labels of all trials of a set, one for each encoder."""
        trials = self.recordings(name, how.tare)
        limits = preset() if how.limits is None else GradientThresholds(np.array(how.limits))
        config = config_of("fit" if how.tolerances else "paper", how.window, trials.dt)
        tracks = {}
        for number, tolerance in enumerate(how.tolerances or (None,)):
            chosen = limits_for(config, limits, tolerance, trials.wrench, trials.length)
            tracks[f"W{how.window} {number}"] = encode_batch(config, chosen, trials.wrench, trials.length)
        return tracks

    @cache  # noqa: B019
    def features(self, name: str, how: Labelling, boundaries: str) -> Features:
        """All families of features of a set's sentences."""
        spec = replace(SPEC, weighing=how.weighing)
        return extract_features(self.tracks(name, how), self.items(name, boundaries), spec)


def make(folder: Path, level: str, session: str, seed: int = SEED) -> Recordings:
    """A simulated set, made if it is missing."""
    preset, spec = PRESETS[session], SETS[level].spec
    if not preset_of(preset).real and level != "ideal":
        spec = replace(spec, sensor=WORN)
    job = SynthesisConfig(preset, SETS[level].trials, seed, shard=64, spec=spec)
    return simulated(folder / f"{level}-{preset}.zarr", job)
