"""``rcbht simulate``."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, MadeBy, option, progress_bar, unset
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.cli.encode import Encode
    from sim_mjx.synthesis.pipeline import SynthesisReport
    from sim_mjx.synthesis.plan import SynthesisConfig
    from sim_mjx.synthesis.workers import SynthesisProgress

FIT = MadeBy('"rcbht fidelity fit HIRO.zarr -o {path}"')


Preset = Literal["hooked-A", "hooked-B", "hooked-C", "A", "B", "C", "openhrp", "rigid-openhrp", "two", "two-fixed"]


@dataclass(frozen=True)
class Simulate(Command):
    """Simulate randomised trials of an assembly, nominal and faulty, into a store.

    After an interruption the same command resumes: finished trials are in the folder STORE.zarr.work beside the store.
    With the native engine, the same options give the same bytes on processors with the same instruction set. To share
    the work, run the same command again while it runs, on any machine that sees the same folder.

    Example: rcbht simulate trials.zarr --trials 200 --seed 1

    Example: rcbht simulate blocks.zarr --preset A --trials 10000

    Example: rcbht simulate pegs.zarr --assembly peg-in-hole --robot panda --trials 100

    Example: rcbht simulate trials.zarr --trials 100000 --engine fused --devices all

    Example: rcbht simulate trials.zarr --status
    """

    out: common.OutStore
    assembly: Annotated[str, tyro.conf.arg(metavar="NAME")] = "camera-snap"
    """camera-snap (recorded, see --preset), peg-in-hole, square-peg, clip, plug, or FILE.py:NAME for your own."""
    robot: Annotated[str, unset(metavar="NAME")] = ""
    """panda, ur5e, hiro, or FILE.py:NAME for your own; default panda. The camera snap is HIRO's."""
    preset: Annotated[
        Preset | None,
        option(
            "Recorded session whose controller is simulated. hooked-A, -B, -C: one set of parts whose hooks catch and "
            "hold; A, B, C: blocks with friction, which simulate some three times as fast; openhrp: the authors' "
            "simulation; rigid-openhrp: the same with harder contacts, sensor offset and solver jitter; two: two "
            "arms, the left one compliant; two-fixed: the left one fixed.", "hooked-B",
        ),
    ] = None  # fmt: skip
    trials: int = 200
    """Number of trials."""
    seed: int = 0
    """Seed of the random numbers; it and the index determine a trial, whose fault is the same in all presets."""
    nominal_share: float = 0.5
    """Fraction of the trials without a fault, 0 to 1."""
    shard: int = 256
    """Trials that are saved together; an interruption loses unsaved ones."""
    max_seconds: Annotated[
        float | None,
        option(
            "Longest duration of a trial, s; default the controller's own limit. A trial that is ended sooner, with "
            "parts not yet assembled, has the outcome unfinished.",
            "",
        ),
    ] = None
    engine: Literal["native", "mjx", "warp", "fused"] = "native"
    """Physics engine: MuJoCo on all cores; for GPUs MJX, MJX with Warp, or one kernel per trial, the fastest."""
    lanes: Annotated[
        int | None,
        option(
            "Trials that a GPU steps at once; default and maximum: its share of all trials, but at most 8192 with "
            "mjx, 32768 with warp and fused, and one per 2 MB of its memory.",
            "",
        ),
    ] = None
    window: Annotated[
        int | None,
        option(
            "Also encode the trials, with this many samples per linear fit: the camera snap during the simulation, as "
            '"rcbht encode --robot hiro" does, other assemblies afterwards, as "rcbht encode" does.',
            "",
            metavar="INT",
        ),
    ] = None
    physical: Annotated[Path | None, unset(metavar="FIT.json"), FIT] = None
    """File of "rcbht fidelity fit" with physical parameters, in place of the preset's."""
    compile_cache: common.CompileCache = None
    overwrite: common.Overwrite = False
    processes: Annotated[int | None, unset()] = None
    """Worker processes that share the work; default one per 4 cores, with a GPU 1, with Ray one per node or GPU."""
    devices: Annotated[str | None, option("GPUs of this machine to use, with a worker process each.", "1")] = None
    launch: Annotated[Literal["ray", "slurm"] | None, unset()] = None
    """Run the workers as Ray tasks or Slurm jobs; default processes of this machine."""
    launch_options: Annotated[tuple[str, ...], unset(metavar="KEY=VALUE")] = ()
    """Options of the Slurm jobs, named as in submitit: timeout_min=60, slurm_partition=gpu."""
    worker: Flag = False
    """Run as one worker of this job: start or join it, and exit when nothing is left to simulate."""
    status: Flag = False
    """Only show the progress of the job, its workers and its failed shards."""

    FORMER: ClassVar[dict[str, str]] = {"--longest": "--max-seconds", "-o": "", "--out": ""}
    RESUMES: ClassVar[bool] = True
    LARGEST_SEED: ClassVar[int] = 2**64 - 1  # a key of Philox

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util import compile_cache
        from sim_mjx.cli.simulate_workers import be_worker, helpers, status
        from sim_mjx.synthesis import launch
        from sim_mjx.synthesis.pipeline import synthesise
        from sim_mjx.synthesis.plan import SynthesisConfig

        if self.status:
            return status(self.out)
        if self.lanes is not None and self.engine == "native":
            raise InputError("--lanes is for --engine mjx, warp or fused; leave it out, or use one of them.")
        name, spec = self._chosen()
        encode = self._encode_afterwards()
        command = self if encode is None else replace(self, window=None)
        job = SynthesisConfig(name, self.trials, self.seed, self.engine, self.shard, spec, command.window)
        if self.engine != "native":  # whose controllers compile in seconds
            compile_cache.use(self.compile_cache)
            os.environ.setdefault(*launch.AS_NEEDED)  # read when JAX first asks for a device
        start = time.perf_counter()
        notices: list[str] = []
        with progress_bar("simulate", "trials", self.trials) as bar:

            def notice(sentence: str) -> None:
                notices.append(sentence)
                bar.write(sentence, file=sys.stderr)

            progress = partial(show, bar)
            if self.worker:
                return be_worker(self, job, progress, notice)
            others = helpers(command, notice)
            report = (None if encode is None else self._unlabelled(job)) or synthesise(
                self.out, job, overwrite=self.overwrite, progress=progress, notice=notice, helpers=others,
                lanes=self.lanes,
            )  # fmt: skip
        if encode is not None:
            encode.run()
        return {
            "store": str(self.out),
            "stored": report.stored,
            "seated": report.seated,
            "diverged": report.diverged,
            "resumed": report.resumed,
            "faults": {kind: {"trials": n, "seated": ok} for kind, (n, ok) in report.faults.items()},
            "seconds": time.perf_counter() - start,
            "notices": notices,
        }

    def _encode_afterwards(self) -> Encode | None:
        """The command that labels trials which HIRO's thresholds do not fit; None = nothing to do afterwards.

        Raises:
            InputError: a window that cannot be, or this is one worker of several.
        """
        from rcbht_jax.cli.encode import Encode
        from rcbht_jax.encoding.rules import config_of
        from sim_mjx.assembly.task import CONTROL_PERIOD
        from sim_mjx.registry import SNAP

        if self.window is None or self.assembly == SNAP:
            return None
        config_of("paper", self.window, CONTROL_PERIOD)  # refused before the simulation
        if self.worker:
            raise InputError(
                "The thresholds of this assembly come from all trials: leave --window out here, and encode the store "
                f"when it is complete: rcbht encode {self.out} --window {self.window}."
            )
        return Encode(store=self.out, window=self.window)

    def _unlabelled(self, job: SynthesisConfig) -> SynthesisReport | None:
        """What an earlier run has simulated that was interrupted while it encoded; None = nothing."""
        from rcbht_jax.io.label_store import list_tracks
        from sim_mjx.synthesis.pipeline import earlier

        try:
            labelled = f"online-W{self.window}" in list_tracks(self.out)
        except InputError:  # no store
            return None
        return None if labelled or self.overwrite else earlier(self.out, job)

    def _chosen(self) -> tuple[str, Any]:
        """Name of what is simulated, and its distributions.

        Raises:
            InputError: unknown assembly or robot, or an option that it does not have.
        """
        from sim_mjx.randomization import overrides
        from sim_mjx.registry import HIRO, SNAP, get_scenario

        snap = self.assembly == SNAP
        if not snap and (self.preset is not None or self.physical is not None):
            raise InputError(f"--preset and --physical belong to the assembly {SNAP}; leave them out.")
        robot = self.robot or (HIRO if snap else "panda")
        name = f"{self.assembly}@{robot}"
        scenario, values = get_scenario(name), {"nominal_share": self.nominal_share, "longest": self.max_seconds}
        if not snap:
            return name, scenario.spec(**values)
        physical = () if self.physical is None else overrides.read(self.physical)
        return self.preset or scenario.preset.name, scenario.spec(**values, physical=physical)

    def text(self, result: dict[str, Any]) -> str:
        if self.status or self.worker:
            from sim_mjx.cli.simulate_workers import status_text, worker_text

            return status_text(result) if self.status else worker_text(result)
        done = "with all four tabs seated" if self.assembly == "camera-snap" else "put together"
        lines = [f"{plural(result['stored'], 'trial')} in {result['store']}, {result['seated']} {done}"]
        lines += [f"  {kind:12} {n['trials']:6d}, seated {n['seated']}" for kind, n in result["faults"].items()]
        if result["resumed"]:
            lines.append(f"{result['resumed']} of them were simulated earlier")
        if result["diverged"]:
            lines.append(f"diverged, not stored: {', '.join(map(str, result['diverged']))}")
        return "\n".join(lines)


def show(bar: Any, now: SynthesisProgress) -> None:
    """Bring a progress bar up to date."""
    if now.seconds_left is None:
        bar.initial = bar.n = now.done  # done by an earlier run: no part of the rate
        bar.refresh()
        return
    bar.set_postfix_str(f"{now.per_minute:.0f} trials/min, {now.seconds_left:.0f} s left", refresh=False)
    bar.update(now.done - bar.n)
