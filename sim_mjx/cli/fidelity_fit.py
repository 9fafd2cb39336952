"""``rcbht fidelity fit``."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from rcbht_jax._util.printable import plural
from rcbht_jax.cli.command import Command, Flag, option, progress_bar, unset
from rcbht_jax.errors import InputError
from sim_mjx.cli.fidelity import HIRO, MOST, Session

if TYPE_CHECKING:
    from sim_mjx.randomization.overrides import Physical
    from sim_mjx.validation.system_id import Bound, Fit, Generation, Search

# Parameters that are fitted by default: lowest, highest value (SI units), scale of the search.
BOUNDS = {
    "parts.tab_stiffness": (2e3, 3e4, "log"),
    "parts.hook_overlap": (2e-4, 1.2e-3, "log"),
    "parts.seat_depth": (1.5e-3, 4.5e-3, "linear"),
    "parts.friction": (0.05, 0.6, "linear"),
    "parts.slot_play": (5e-4, 2.5e-3, "linear"),
    "parts.mount_stiffness[0]": (1.5e3, 1.5e4, "log"),
    "parts.mount_stiffness[1]": (1.5e3, 1e5, "log"),
    "parts.mount_stiffness[2]": (3e3, 2e4, "log"),
    "parts.mount_damping[2]": (5.0, 400.0, "log"),
    "parts.roll": (-0.05, 0.05, "linear"),
    "sensor.delay": (0.6, 11.4, "linear"),
}


@dataclass(frozen=True)
class FidelityFit(Command):
    """Fit physical parameters of parts and sensor to the wrenches of a recorded session.

    The search is CMA-ES on the native engine, with all candidates of a generation in one batch. Its state is saved
    beside the result; the same command resumes it, also with more --generations.

    Example: rcbht fidelity fit hiro.zarr --session B -o b.json
    """

    recorded: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="HIRO.zarr"), HIRO]
    """Store of "rcbht import hiro" with the recorded trials."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT.json")]
    """File of parameters to write, for "rcbht simulate --physical"; an existing one is replaced."""
    session: Session = "B"
    """Recorded session."""
    parameters: tuple[str, ...] = tuple(BOUNDS)
    """Parameters to fit, for example parts.friction, parts.hook_overlap[0:2] or sensor.delay."""
    bound: Annotated[tuple[str, ...], unset()] = ()
    """Ranges in place of the default ones, as NAME=LOW:HIGH, in SI units."""
    fixed: Annotated[tuple[str, ...], unset()] = ()
    """Parameters with a fixed value, as NAME=VALUE."""
    trials: Annotated[int | None, unset()] = None
    """Simulated trials per candidate; default 4 for session A, 9 for the others."""
    outcomes: Annotated[
        Flag,
        option(
            "Also penalise trials whose outcome differs from the recorded one or, in a session without a grid, "
            "trials that do not seat; simulates whole trials."
        ),
    ] = False
    snaps: Flag = False
    """Also penalise seated trials without a snap in the force, if recorded ones have one; simulates whole trials."""
    population: int = 12
    """Candidates per generation."""
    generations: int = 30
    """Generations of the search."""
    initial_std: float = 0.15
    """Standard deviation of the first generation about the present values, as a fraction of the ranges."""
    seed: int = 0
    """Seed of the search and of the simulated noise."""

    FORMER: ClassVar[dict[str, str]] = {"--spread": "--initial-std"}
    RESUMES: ClassVar[bool] = True

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.store import read_attrs, read_recordings
        from sim_mjx.randomization import overrides
        from sim_mjx.validation import sessions
        from sim_mjx.validation.system_id import fit

        start = time.perf_counter()
        target = sessions.recorded(read_recordings(self.recorded), self.session)
        fixed = tuple((name, _number(value)) for name, value in map(_assignment, self.fixed))
        _check_once([*self.parameters, *(name for name, _ in fixed)], "--parameters and --fixed")
        _check_once([name for name, _ in map(_assignment, self.bound)], "--bound")
        overrides.check((*fixed, *((name, 1.0) for name in self.parameters)))  # a value that every one of them can have
        trials = (4 if self.session == "A" else 9) if self.trials is None else self.trials
        if not 1 <= trials <= MOST:
            raise InputError(f"--trials is {trials}; expected 1 to {MOST}.")
        sessions.trials_of(target.session, trials, physical=fixed)  # refuses a wrong count before the work
        objective = sessions.SessionObjective(target, trials, self.seed, self.outcomes, self.snaps, fixed)
        search = self._search(fixed, trials, read_attrs(self.recorded)["content_sha256"])
        checkpoint = self.out.with_name(f"{self.out.name}.search")
        with progress_bar("fit", "generations", self.generations) as bar:
            best = fit(objective, search, checkpoint=checkpoint, progress=lambda now, best: _show(bar, now, best))
        values = dict(fixed) | best.values
        summary = {"session": self.session, "loss": best.loss, "generations": len(best.generations)}
        overrides.write(self.out, values, summary)
        return {**summary, "values": values, "file": str(self.out), "seconds": time.perf_counter() - start}

    def text(self, result: dict[str, Any]) -> str:
        after = plural(result["generations"], "generation")
        lines = [f"{result['file']}: loss {result['loss']:.4f} after {after}"]
        return "\n".join(lines + [f"  {name:26} {value:.6g}" for name, value in result["values"].items()])

    def _search(self, fixed: Physical, trials: int, recorded: str) -> Search:
        from sim_mjx.randomization import overrides
        from sim_mjx.synthesis.plan import code_hash
        from sim_mjx.validation.system_id import Bound, Search

        usual = {name: Bound(low, high, log=scale == "log") for name, (low, high, scale) in BOUNDS.items()}
        ranges = {name: _range(text) for name, text in map(_assignment, self.bound)}
        unknown = [name for name in self.parameters if name not in usual | ranges]
        if unknown:
            raise InputError(f"{unknown[0]} has no default range; give one: --bound {unknown[0]}=LOW:HIGH.")
        unused = [name for name in ranges if name not in self.parameters]
        if unused:
            raise InputError(f"A range is given for {unused[0]}, which is not fitted; add it to --parameters.")
        bounds = {name: (usual | ranges)[name] for name in self.parameters}
        overrides.check(tuple((name, end) for name, bound in bounds.items() for end in (bound.low, bound.high)))
        settings = {
            "session": self.session, "recorded_sha256": recorded, "trials": trials, "outcomes": self.outcomes,
            "snaps": self.snaps, "fixed": [list(pair) for pair in fixed], "sim_mjx_sha256": code_hash(),
        }  # fmt: skip
        begin = {name: _present(self.session, name, bound) for name, bound in bounds.items()}
        return Search(bounds, self.population, self.generations, self.seed, begin, self.initial_std, settings)


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"{text!r} has no =; expected NAME=VALUE for --fixed, NAME=LOW:HIGH for --bound.")
    return name, value


def _check_once(names: list[str], options: str) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{twice} is given twice in {options}; expected it once.")


def _range(text: str) -> Bound:
    from sim_mjx.validation.system_id import Bound

    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{text!r} has no :; expected NAME=LOW:HIGH for --bound.")
    return Bound(_number(low), _number(high))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"{text!r} is not a number; expected NAME=VALUE for --fixed, NAME=LOW:HIGH for --bound."
        ) from None


def _present(session: str, name: str, bound: Bound) -> float:
    """The present value of a parameter, clipped to its range; the mean if it has several elements."""
    from sim_mjx.presets import preset
    from sim_mjx.randomization import overrides

    nominal = preset(session)
    return min(max(overrides.value(nominal.parts, nominal.sensor, name), bound.low), bound.high)


def _show(bar: Any, now: Generation, best: Fit) -> None:
    bar.set_postfix_str(f"loss {best.loss:.4f}, this generation {now.best:.4f}, step {now.step:.3f}", refresh=False)
    bar.update(now.number - bar.n)
