"""``rcbht fidelity fit``."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings
from sim_mjx.assembly import parts, sensor
from sim_mjx.randomization import overrides
from sim_mjx.validation import sessions
from sim_mjx.validation.system_id import Bound, Fit, Generation, Search, fit

# What may be searched by default: (lowest, highest, by factors), SI units.
BOUNDS: dict[str, Bound] = {
    "parts.tab_stiffness": Bound(3e3, 3e4, log=True),
    "parts.hook_overlap": Bound(2e-4, 1.2e-3, log=True),
    "parts.seat_depth": Bound(1.5e-3, 3.5e-3),
    "parts.friction": Bound(0.05, 0.6),
    "parts.slot_play": Bound(5e-4, 2.5e-3),
    "parts.mount_stiffness[0]": Bound(1.5e3, 1.5e4, log=True),
    "parts.mount_stiffness[1]": Bound(1.5e3, 1.5e4, log=True),
    "parts.mount_stiffness[2]": Bound(3e3, 2e4, log=True),
    "parts.mount_damping[2]": Bound(20.0, 200.0, log=True),
    "parts.roll": Bound(-0.02, 0.02),
    "sensor.delay": Bound(3.6, 9.4),
}


@dataclass(frozen=True)
class FidelityFit(Command):
    """Fit physical parameters of parts and sensor to the wrench signature of a recorded session.

    Evolution strategy (CMA-ES) on the native engine, all candidates of a generation in one batch. The state of
    the search is kept beside the result and continued when the same command is called again; --generations may
    then be raised.

    Example: rcbht fidelity fit hiro.zarr --session B -o b.json
    """

    recorded: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="HIRO.zarr")]
    """Store of the recorded trials, made by "rcbht import hiro"."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.json")]
    """Parameters to write, for "rcbht simulate --physical"; an existing file is replaced."""
    session: Literal["A", "B", "C", "openhrp"] = "B"
    """Recorded session."""
    parameters: tuple[str, ...] = tuple(BOUNDS)
    """What to search, for example parts.friction, parts.hook_overlap[0:2] or sensor.delay."""
    bound: tuple[str, ...] = ()
    """Ranges that replace the usual ones, as NAME=LOW:HIGH, in SI units."""
    fixed: tuple[str, ...] = ()
    """Parameters to set and not to search, as NAME=VALUE."""
    trials: int | None = None
    """Simulated trials per candidate; default 4 for session A, elsewhere 9."""
    outcomes: bool = False
    """Session B: simulate whole trials, and count cells that end otherwise than recorded (three times slower)."""
    snaps: bool = False
    """Simulate whole trials, and count seated ones without a snap in the force where the recorded ones have it."""
    population: int = 12
    """Candidates per generation."""
    generations: int = 30
    """Generations."""
    spread: float = 0.15
    """First standard deviation of the search about the present values, in widths of the ranges."""
    seed: int = 0
    """Of the search and of the simulated noise."""

    def run(self) -> dict[str, Any]:
        start = time.perf_counter()
        if not self.out.absolute().parent.is_dir():
            raise InputError(f"{self.out.parent} is no folder; choose another place for the parameters.")
        target = sessions.recorded(read_recordings(self.recorded), self.session)
        fixed = tuple((name, _number(value)) for name, value in map(_assignment, self.fixed))
        overrides.check((*fixed, *((name, 0.0) for name in self.parameters)))
        trials = self.trials or (4 if self.session == "A" else 9)
        sessions.trials_of(self.session, trials, physical=fixed)  # refuses a wrong count before the work
        objective = sessions.SessionObjective(target, trials, self.seed, self.outcomes, self.snaps, fixed)
        search = self._search(fixed, trials, len(target.profiles))
        checkpoint = self.out.with_name(f"{self.out.name}.search")
        with tqdm(total=self.generations, desc="fit", unit=" gen", file=sys.stderr, disable=None) as bar:
            found = fit(objective, search, checkpoint=checkpoint, progress=lambda now, best: _show(bar, now, best))
        values = dict(fixed) | found.values
        about = {"session": self.session, "loss": found.loss, "generations": len(found.generations)}
        overrides.write(self.out, values, about)
        return {**about, "values": values, "file": str(self.out), "seconds": time.perf_counter() - start}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['file']}: loss {result['loss']:.4f} after {result['generations']} generations"]
        return "\n".join(lines + [f"  {name:26} {value:.6g}" for name, value in result["values"].items()])

    def _search(self, fixed: overrides.Physical, trials: int, recorded: int) -> Search:
        ranges = {name: _range(text) for name, text in map(_assignment, self.bound)}
        unknown = [name for name in self.parameters if name not in BOUNDS | ranges]
        if unknown:
            raise InputError(f"{unknown[0]} has no usual range; give one: --bound {unknown[0]}=LOW:HIGH.")
        unused = [name for name in ranges if name not in self.parameters]
        if unused:
            raise InputError(f"A range is given for {unused[0]}, which is not searched; add it to --parameters.")
        bounds = {name: (BOUNDS | ranges)[name] for name in self.parameters}
        about = {
            "session": self.session, "recorded_trials": recorded, "trials": trials, "outcomes": self.outcomes,
            "snaps": self.snaps, "fixed": [list(pair) for pair in fixed],
        }  # fmt: skip
        begin = {name: _present(self.session, name, bound) for name, bound in bounds.items()}
        return Search(bounds, self.population, self.generations, self.seed, begin, self.spread, about)


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"{text!r} is not NAME=VALUE.")
    return name, value


def _range(text: str) -> Bound:
    low, _, high = text.partition(":")
    return Bound(_number(low), _number(high))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{text!r} is not a number.") from None


def _present(session: str, name: str, bound: Bound) -> float:
    """The value that a parameter has now, moved into its range; the mean where it has several elements."""
    touch = sensor.simulated_sensor() if session == "openhrp" else sensor.real_sensor(session)
    return min(max(overrides.value(parts.nominal(session), touch, name), bound.low), bound.high)


def _show(bar: Any, now: Generation, best: Fit) -> None:
    bar.set_postfix_str(f"loss {best.loss:.4f}, this one {now.best:.4f}, step {now.step:.3f}", refresh=False)
    bar.update(now.number - bar.n)
