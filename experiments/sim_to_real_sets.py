"""Simulated training sets for ``experiments.sim_to_real``: each preset with nothing, little or much varied.

Run: python -m experiments.sim_to_real_sets FOLDER [--sets none mild wide]
Every set is a store that ``sim_mjx.synth`` makes: interrupted, it goes on where it stopped; finished ones are kept.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from sim_mjx import synth
from sim_mjx.presets import PRESETS
from sim_mjx.randomize import Randomisation

SEED = 20
ONE = (1.0, 1.0)
NONE = Randomisation(
    nominal_share=1.0, shift=(0.0, 0.0), turn=(0.0, 0.0), stiffness=ONE, overlap=ONE, friction=ONE, mount=ONE,
    gain=ONE, goal=ONE, speed=ONE, noise=ONE, force_bias=(0.0, 0.0), moment_bias=(0.0, 0.0), tare=ONE,
)  # fmt: skip
MILD = Randomisation(nominal_share=1.0)
# What another robot, part or day might bring, without looking at any: half to twice each physical unknown.
WIDE = Randomisation(
    nominal_share=1.0, shift=(-2e-3, 2e-3), turn=(-0.02, 0.02), stiffness=(0.5, 2.0), overlap=(0.8, 1.1),
    friction=(0.5, 2.0), mount=(0.6, 1.7), gain=(0.8, 1.25), goal=(0.7, 1.4), speed=(0.6, 1.6), lag=(3, 8),
    noise=(0.5, 2.0), force_bias=(-1.0, 1.0), moment_bias=(-0.05, 0.05), tare=(0.8, 1.0),
)  # fmt: skip


@dataclass(frozen=True)
class SimulatedSet:
    """How one level of randomisation is simulated."""

    spec: Randomisation
    trials: int  # per preset


SETS = {"none": SimulatedSet(NONE, 64), "mild": SimulatedSet(MILD, 128), "wide": SimulatedSet(WIDE, 256)}


def store_of(folder: Path, level: str, preset: str) -> Path:
    """Where a set is kept."""
    return folder / f"{level}-{preset}.zarr"


def make(folder: Path, level: str, preset: str) -> None:
    """Simulate a set unless it is there."""
    target = store_of(folder, level, preset)
    if target.exists():
        return
    job = synth.Synthesis(preset, SETS[level].trials, SEED, shard=64, spec=SETS[level].spec)

    def progress(now: synth.Progress) -> None:
        print(f"{target.name}: {now.done}/{now.total}, {now.per_minute:.0f} a minute", flush=True)

    print(synth.synthesise(target, job, progress=progress), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=list(PRESETS))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for level in given.sets:
        for preset in given.presets:
            make(given.folder, level, preset)


if __name__ == "__main__":
    main()
