"""``rcbht simulate``."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax._util import compile_cache
from rcbht_jax.cli.command import Command
from sim_mjx.randomization import overrides as physical
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.pipeline import SHARD, SynthesisConfig, SynthesisProgress, synthesise


@dataclass(frozen=True)
class Simulate(Command):
    """Simulate randomised trials of the snap assembly, nominal and faulty, into a store.

    Interrupted, it goes on where it stopped when called again with the same options: finished trials wait in a
    folder OUT.zarr.work beside the store. The same options give the same bytes.

    Example: rcbht simulate trials.zarr --preset A --trials 200 --seed 1
    """

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.zarr")]
    """Store to create, for example trials.zarr."""
    preset: Literal["A", "B", "C", "openhrp", "two", "two-fixed"] = "A"
    """Recorded session whose controller is simulated; two = two arms, the left one under force control or fixed."""
    trials: int = 200
    """Number of trials."""
    seed: int = 0
    """Determines, with a trial's index, everything about it."""
    nominal_share: float = 0.5
    """Share of the trials without a fault, 0 to 1."""
    shard: int | None = None
    """Trials that are kept together: an interruption costs at most so many; default 256, on a GPU 8192."""
    longest: float | None = None
    """Stop every trial after this many seconds; default the session's own limit."""
    engine: Literal["native", "mjx", "warp"] = "native"
    """What computes the physics: C MuJoCo on all cores; MJX with JAX's or with Warp's kernels, for GPUs."""
    window: int | None = None
    """Also label the trials, with so many samples per straight-line fit, as "rcbht encode" does."""
    physical: Annotated[Path | None, tyro.conf.arg(metavar="FIT.json")] = None
    """Physical parameters in place of the preset's, from "rcbht fidelity fit"."""
    compile_cache: Path | None = None
    """Folder that keeps compiled programs of mjx and warp; default rcbht-jax in your cache folder."""
    overwrite: bool = False
    """Replace an existing store, once the new one is complete."""

    def run(self) -> dict[str, Any]:
        values = () if self.physical is None else physical.read(self.physical)
        spec = DomainRandomization(nominal_share=self.nominal_share, longest=self.longest, physical=values)
        shard = SHARD[self.engine] if self.shard is None else self.shard
        job = SynthesisConfig(self.preset, self.trials, self.seed, self.engine, shard, spec, self.window)
        if self.engine != "native":  # whose controllers compile in seconds
            compile_cache.use(self.compile_cache)
        start = time.perf_counter()
        with tqdm(total=self.trials, desc="simulate", unit=" trials", file=sys.stderr, disable=None) as bar:
            report = synthesise(self.out, job, overwrite=self.overwrite, progress=lambda now: _show(bar, now))
        return {
            "store": str(self.out),
            "stored": report.stored,
            "seated": report.seated,
            "diverged": report.diverged,
            "resumed": report.resumed,
            "faults": {kind: {"trials": n, "seated": ok} for kind, (n, ok) in report.faults.items()},
            "seconds": time.perf_counter() - start,
        }

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['stored']} trials in {result['store']}, {result['seated']} with all four tabs seated"]
        lines += [f"  {kind:12} {n['trials']:6d}, seated {n['seated']}" for kind, n in result["faults"].items()]
        if result["resumed"]:
            lines.append(f"{result['resumed']} of them had been simulated before")
        if result["diverged"]:
            lines.append(f"diverged, not stored: {', '.join(map(str, result['diverged']))}")
        return "\n".join(lines)


def _show(bar: Any, now: SynthesisProgress) -> None:
    """Progress on standard error, silent where that is not a terminal."""
    if now.seconds_left is None:
        bar.initial = bar.n = now.done  # done by an earlier run: no part of the rate
        bar.refresh()
        return
    bar.set_postfix_str(f"{now.per_minute:.0f} trials/min, {now.seconds_left:.0f} s left", refresh=False)
    bar.update(now.done - bar.n)
