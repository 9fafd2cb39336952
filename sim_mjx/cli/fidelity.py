"""``rcbht fidelity`` and ``rcbht fidelity fit``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

import rcbht_jax
from rcbht_jax._util.printable import plural
from rcbht_jax.cli.command import Command, Flag, Folder, MadeBy, announce, option, progress_bar, unset
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from sim_mjx.randomization.overrides import Physical
    from sim_mjx.validation.system_id import Bound, Fit, Generation, Search

Measured = tuple[dict[str, Any], Any]  # values of the report, figure or None
HIRO = MadeBy('"rcbht import hiro DIR {path}"')
Session = Literal["A", "B", "C", "openhrp", "hooked-A", "hooked-B", "hooked-C", "rigid-openhrp"]

MOST = 100_000  # trials, which are all in memory at once

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
class Fidelity(Command):
    """Measure the fidelity of the simulation and write report.json, report.txt and pictures to a folder.

    Four measurements: convergence of the solver, agreement of the engines, position of the arm along recorded
    approaches, similarity of the wrenches of each session. Those that need recordings are skipped without them. After
    an interruption the same command resumes: finished measurements are in OUT/parts.

    Example: rcbht fidelity -o fidelity-out --recorded hiro.zarr --data path/to/hiro
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT"), Folder(grows=True)] = Path("fidelity-out")
    """Folder to write to; created if it does not exist."""
    recorded: Annotated[Path | None, unset(metavar="HIRO.zarr"), HIRO] = None
    """Store of "rcbht import hiro" with the recorded trials, to compare wrenches with."""
    data: Annotated[Path | None, unset(metavar="DIR")] = None
    """Folder of the recorded trials, to compare positions of the arm with."""
    session: tuple[Session, ...] = ("hooked-A", "hooked-B", "hooked-C", "rigid-openhrp")
    """Sessions to measure; a prefix such as hooked names the parts."""
    engines: Annotated[tuple[Literal["mjx", "warp"], ...], unset()] = ()
    """Engines to compare with the native one; slow without a GPU."""
    trials: int = 64
    """Randomised trials to compare solver and engines on, shared among the sessions."""
    max_seconds: float = 13.0
    """Longest duration of these trials, s."""
    seed: int = 0
    """Seed of all trials."""

    FORMER: ClassVar[dict[str, str]] = {"--sessions": "--session", "--longest": "--max-seconds"}

    def run(self) -> dict[str, Any]:
        start = time.perf_counter()
        self._check()
        jobs = self._jobs()
        (self.out / "parts").mkdir(parents=True, exist_ok=True)
        report: dict[str, Any] = {"rcbht_jax": rcbht_jax.__version__, "seed": self.seed}
        for place, (name, job) in enumerate(jobs.items()):
            announce(place + 1, len(jobs), name)
            report[name] = self._part(name, job)
        missing = {"kinematics": self.data, "signatures": self.recorded}
        report["left_out"] = [name for name, given in missing.items() if given is None]
        _write(self.out / "report.json", json.dumps(report, indent=1, allow_nan=False) + "\n")
        _write(self.out / "report.txt", table(report) + "\n")
        return {**report, "folder": str(self.out), "seconds": time.perf_counter() - start}

    def text(self, result: dict[str, Any]) -> str:
        drawn = any(name.startswith("session ") and row["mated"] for name, row in result.items())
        files = f"report.json, report.txt{', pictures' if drawn else ''}"
        return f"{table(result)}\n\n{result['folder']}: {files} ({result['seconds']:.0f} s)"

    def _check(self) -> None:
        from rcbht_jax.io.hiro.importer import find_trials
        from sim_mjx import engines

        if not 4 <= self.trials <= MOST or not 0.0 < self.max_seconds < 1000.0:
            raise InputError(
                f"--trials is {self.trials} and --max-seconds {self.max_seconds}; expected 4 to {MOST}, and a positive "
                "time below 1000 s."
            )
        for engine in self.engines:
            engines.check(engine)
        if self.data is not None:
            if not self.data.is_dir():
                raise InputError(f"{self.data} is not a folder; expected that of the authors' data sets.")
            find_trials(self.data)

    def _jobs(self) -> dict[str, Callable[[], Measured]]:
        """The measurements, in order; their input is checked here, before the first of them."""
        from rcbht_jax.io.store import read_recordings
        from sim_mjx.validation import fidelity, sessions

        options = (self._trials_of_each(), self.seed, self.max_seconds)
        jobs: dict[str, Callable[[], Measured]] = {}
        for name in self.session:
            jobs[f"solver {name}"] = partial(_convergence, name, *options)
        for engine, name in product(self.engines, self.session):
            jobs[f"engine {engine} {name}"] = partial(_parity, engine, name, *options)
        if self.data is not None:
            data = self.data
            jobs["kinematics"] = lambda: (fidelity.kinematics(data), None)
        if self.recorded is not None:
            recordings = read_recordings(self.recorded)
            for name in self.session:
                target = sessions.recorded(recordings, name)
                jobs[f"session {name}"] = partial(fidelity.session, target, None, self.seed)
        return jobs

    def _trials_of_each(self) -> int:
        """Trials of a session that solver and engines are compared on, rounded up."""
        return -(-self.trials // len(self.session))

    def _part(self, name: str, job: Callable[[], Measured]) -> dict[str, Any]:
        """Measure one part, unless an earlier run with the same options, data and code measured it."""
        from rcbht_jax._util import checkpoint

        path = self.out / "parts" / f"{name.replace(' ', '-')}.json"
        made_by = self._made_by()
        with suppress(InputError):  # of other options or code, or damaged: measured again
            if (earlier := checkpoint.load(path, made_by)) is not None:
                return earlier
        result, figure = job()
        if figure is not None:
            from rcbht_jax.plots import save

            save(figure, self.out / f"{name.replace(' ', '-')}.png")
        checkpoint.save(path, made_by, result)
        return result

    def _made_by(self) -> list[Any]:
        """Everything that a measurement depends on."""
        from rcbht_jax.io.store import read_attrs
        from sim_mjx.synthesis.plan import code_hash

        data = None if self.recorded is None else read_attrs(self.recorded)["content_sha256"]
        folder = None if self.data is None else str(self.data.resolve())
        return [code_hash(), self._trials_of_each(), self.max_seconds, self.seed, data, folder]


def _convergence(name: str, trials: int, seed: int, longest: float) -> Measured:
    from sim_mjx.presets import preset
    from sim_mjx.validation import fidelity

    return fidelity.convergence(preset(name), trials, seed, longest), None


def _parity(engine: str, name: str, trials: int, seed: int, longest: float) -> Measured:
    from sim_mjx.presets import preset
    from sim_mjx.validation import fidelity

    return fidelity.parity(engine, preset(name), trials, seed, longest), None


def _write(path: Path, text: str) -> None:
    from rcbht_jax._util.atomic import atomic_write

    with atomic_write(path) as draft:
        draft.write_text(text, encoding="utf-8")


def table(report: dict[str, Any]) -> str:
    """The report as a table: measurement, limit, verdict."""
    lines = [_solver(name, value) for name, value in report.items() if name.startswith("solver ")]
    lines += [_engine(name, value) for name, value in report.items() if name.startswith("engine ")]
    for name, row in report.get("kinematics", {}).items():
        value = f"{row['rms_mm']:.4f} mm, {row['rms_degrees']:.4f} deg rms over {row['trials']} approaches"
        lines.append(_line(f"kinematics {name}", value, "{:g} mm, {:g} deg".format(*row["limits"]), row["holds"]))
    lines += [line for name, value in report.items() if name.startswith("session ") for line in _session(name, value)]
    if report["left_out"]:
        lines.append(f"skipped without recordings: {', '.join(report['left_out'])}")
    return "\n".join(lines)


def _check(name: str, row: dict[str, Any]) -> tuple[str, str, bool]:
    """One measure of the fidelity gate: value, limit, verdict."""
    value = "cannot be measured" if row["value"] is None else f"{row['value']:.2f}"
    low, high = (None if row[which] is None else f"{row[which]:.2f}" for which in ("low", "high"))
    limit = f"{low} to {high}" if low and high else f">= {low}" if low else f"<= {high}"
    return f"{name} {value}", limit, row["holds"]


def _snaps(row: dict[str, Any]) -> str:
    counts = "none in {}, one in {}, two in {}, more in {}".format(*row["trials_with_0_1_2_more"])
    if not row["drop_N_5_50_95_percent"]:
        return counts
    release, drop = row["release_N_5_50_95_percent"][1], row["drop_N_5_50_95_percent"][1]
    return f"{counts}; median release {release} N, drop {drop} N"


def _line(name: str, value: str, limit: str = "", holds: bool | None = None) -> str:
    verdict = "" if holds is None else ("ok" if holds else "MISSED")
    return f"{name:28}{value:64}{f'limit {limit}' if limit else '':34}{verdict}".rstrip()


def _contacts(row: dict[str, Any]) -> str:
    return f"{row['touched']} of {plural(row['trials'], 'trial')} touched"


def _solver(name: str, row: dict[str, Any]) -> str:
    step, limits = row["step"], row["limits"]
    value = f"{step['force']:.2g} N, {step['moment']:.2g} Nm from converged, {_contacts(row)}"
    return _line(name, value, f"{limits['force']:g} N, {limits['moment']:g} Nm", row["holds"])


def _engine(name: str, row: dict[str, Any]) -> str:
    value = (
        f"{row['force_until_contact']:.2g} N until contact, labels {min(row['labels'].values()):.1%}, "
        f"outcome {row['same_outcome']:.1%}, {_contacts(row)}"
    )
    limits = row["limits"]
    limit = f"{limits['force']:g} N, {limits['labels']:.0%}, {limits['outcome']:.0%}"
    return _line(name, value, limit, row["holds"])


def _session(name: str, row: dict[str, Any]) -> list[str]:
    lines = []
    if row["gate"]:
        value = "coverage {:.2f}, W1/sd {:.2f}, DTW/sd {:.2f}".format(
            *(row["gate"][each]["value"] for each in ("coverage", "W1/sd", "DTW/sd"))
        )
        lines.append(_line(name, f"{value}; {row['mated']} of {row['trials']} mated", holds=row["holds"]))
        lines += [_line("", *_check(each, check)) for each, check in row["gate"].items() if not check["holds"]]
    else:
        value = f"{row['mated']} of {plural(row['trials'], 'trial')} mated for a second; the gate needs three"
        lines.append(_line(name, value, holds=False))
    if row["onsets"] is not None:
        pairs = zip(row["onsets"], row["recorded_onsets"], strict=True)
        times = ", ".join(f"{simulated:.2f} ({recorded:.2f})" for simulated, recorded in pairs)
        lines.append(_line("", f"onsets (recorded): {times} s"))
    if row["ring"] and row["recorded_ring"]:
        values = [row[which][key] for key in ("hertz", "peak") for which in ("ring", "recorded_ring")]
        lines.append(_line("", "ring (recorded): {:.2f} ({:.2f}) Hz, peak {:.1f} ({:.1f}) N".format(*values)))
    for which, snaps in (("snaps", row["snaps"]), ("recorded snaps", row["recorded_snaps"])):
        if snaps and snaps["trials"]:
            lines.append(_line("", f"{which} of seated trials: {_snaps(snaps)}"))
    lines.append(_line("", f"all four tabs seated: {row['seated']:.1%}"))
    if "outcomes_as_recorded" in row:
        lines[-1] += "; outcomes as recorded: {} of {}".format(*row["outcomes_as_recorded"])
    return lines


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
    bound: Annotated[
        tuple[str, ...], option("Ranges in place of the default ones, as NAME=LOW:HIGH, in SI units.", "")
    ] = ()
    fixed: Annotated[tuple[str, ...], unset()] = ()
    """Parameters with a fixed value, as NAME=VALUE."""
    trials: Annotated[
        int | None, option("Simulated trials per candidate; default 4 for session A, 9 for the others.", "")
    ] = None
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

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.store import read_recordings
        from sim_mjx.randomization import overrides
        from sim_mjx.validation import sessions
        from sim_mjx.validation.system_id import fit

        start = time.perf_counter()
        if not self.out.absolute().parent.is_dir():
            raise InputError(f"{self.out.parent} is not a folder; create it, or choose another.")
        target = sessions.recorded(read_recordings(self.recorded), self.session)
        fixed = tuple((name, _number(value)) for name, value in map(_assignment, self.fixed))
        overrides.check((*fixed, *((name, 0.0) for name in self.parameters)))
        trials = self.trials or (4 if self.session == "A" else 9)
        sessions.trials_of(target.session, trials, physical=fixed)  # refuses a wrong count before the work
        objective = sessions.SessionObjective(target, trials, self.seed, self.outcomes, self.snaps, fixed)
        search = self._search(fixed, trials, len(target.profiles))
        checkpoint = self.out.with_name(f"{self.out.name}.search")
        with progress_bar("fit", "generations", self.generations) as bar:
            best = fit(objective, search, checkpoint=checkpoint, progress=lambda now, best: _show(bar, now, best))
        values = dict(fixed) | best.values
        summary = {"session": self.session, "loss": best.loss, "generations": len(best.generations)}
        overrides.write(self.out, values, summary)
        return {**summary, "values": values, "file": str(self.out), "seconds": time.perf_counter() - start}

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"{result['file']}: loss {result['loss']:.4f} after {result['generations']} generations"]
        return "\n".join(lines + [f"  {name:26} {value:.6g}" for name, value in result["values"].items()])

    def _search(self, fixed: Physical, trials: int, recorded: int) -> Search:
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
        settings = {
            "session": self.session, "recorded_trials": recorded, "trials": trials, "outcomes": self.outcomes,
            "snaps": self.snaps, "fixed": [list(pair) for pair in fixed],
        }  # fmt: skip
        begin = {name: _present(self.session, name, bound) for name, bound in bounds.items()}
        return Search(bounds, self.population, self.generations, self.seed, begin, self.initial_std, settings)


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"{text!r} has no =; expected NAME=VALUE for --fixed, NAME=LOW:HIGH for --bound.")
    return name, value


def _range(text: str) -> Bound:
    from sim_mjx.validation.system_id import Bound

    low, _, high = text.partition(":")
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
