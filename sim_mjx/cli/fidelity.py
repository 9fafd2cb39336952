"""``rcbht fidelity``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

import rcbht_jax
from rcbht_jax._util.printable import plural
from rcbht_jax.cli.command import Command, Folder, MadeBy, announce, unset
from rcbht_jax.errors import InputError

Measured = tuple[dict[str, Any], Any]  # values of the report, figure or None
HIRO = MadeBy('"rcbht import hiro DIR {path}"')
Session = Literal["A", "B", "C", "openhrp", "hooked-A", "hooked-B", "hooked-C", "rigid-openhrp"]

MOST = 100_000  # trials, which are all in memory at once


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
    engines: Annotated[tuple[Literal["mjx", "warp", "fused"], ...], unset()] = ()
    """Engines to compare with the native one; slow without a GPU."""
    trials: int = 64
    """Randomised trials to compare solver and engines on, shared among the sessions."""
    max_seconds: float = 13.0
    """Longest duration of these trials, s."""
    seed: int = 0
    """Seed of all trials."""

    FORMER: ClassVar[dict[str, str]] = {"--sessions": "--session", "--longest": "--max-seconds"}
    RESUMES: ClassVar[bool] = True

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
        drawn = any(map(_is_drawn, result, result.values()))
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
        from sim_mjx.presets import preset
        from sim_mjx.validation import fidelity, sessions

        options = (self._trials_of_each(), self.seed, self.max_seconds)
        jobs: dict[str, Callable[[], Measured]] = {}
        names = tuple(dict.fromkeys(self.session))
        for name in names:
            jobs[f"solver {name}"] = partial(_without_picture, fidelity.convergence, preset(name), *options)
        for engine, name in product(self.engines, names):
            jobs[f"engine {engine} {name}"] = partial(_without_picture, fidelity.parity, engine, preset(name), *options)
        if self.data is not None:
            jobs["kinematics"] = partial(_without_picture, fidelity.kinematics, self.data)
        if self.recorded is not None:
            recordings = read_recordings(self.recorded)
            for name in names:
                target = sessions.recorded(recordings, name)
                jobs[f"session {name}"] = partial(fidelity.session, target, None, self.seed)
        return jobs

    def _trials_of_each(self) -> int:
        """Trials of a session that solver and engines are compared on, rounded up."""
        return -(-self.trials // len(set(self.session)))

    def _part(self, name: str, job: Callable[[], Measured]) -> dict[str, Any]:
        """Measure one part, unless an earlier run with the same options, data and code has and its picture is there."""
        from rcbht_jax._util import checkpoint

        path = self.out / "parts" / f"{name.replace(' ', '-')}.json"
        picture = self.out / f"{path.stem}.png"
        made_by = self._made_by()
        with suppress(InputError):  # of other options or code, or damaged: measured again
            earlier = checkpoint.load(path, made_by)
            if earlier is not None and (picture.is_file() or not _is_drawn(name, earlier)):
                return earlier
        result, figure = job()
        if figure is not None:
            from rcbht_jax.plots import save

            save(figure, picture)
        checkpoint.save(path, made_by, result)
        return result

    def _made_by(self) -> list[Any]:
        """Everything that a measurement depends on."""
        from importlib.metadata import version

        from rcbht_jax.io.store import read_attrs
        from sim_mjx.synthesis.plan import code_hash

        data = None if self.recorded is None else read_attrs(self.recorded)["content_sha256"]
        folder = None if self.data is None else _state_of(self.data)
        versions = [version(name) for name in ("jax", "mujoco", "numpy")]
        return [code_hash(), versions, self._trials_of_each(), self.max_seconds, self.seed, data, folder]


def _is_drawn(name: str, row: Any) -> bool:
    """Whether a measurement of the report has a picture."""
    return name.startswith("session ") and bool(row["mated"])


def _state_of(folder: Path) -> str:
    """Digest of the names, sizes and times of change of all files of the trials in a folder."""
    from hashlib import sha256

    from rcbht_jax.io.hiro.importer import find_trials

    files = sorted(file for _, trial in find_trials(folder) for file in trial.iterdir() if file.is_file())
    states = [(str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return sha256(json.dumps(states).encode()).hexdigest()


def _without_picture(measure: Callable[..., dict[str, Any]], *options: Any) -> Measured:
    return measure(*options), None


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
