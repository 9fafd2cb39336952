"""``rcbht fidelity``."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from matplotlib.figure import Figure

import rcbht_jax
from rcbht_jax._util import checkpoint
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_attrs, read_recordings
from rcbht_jax.plots import save
from sim_mjx.synthesis import pipeline
from sim_mjx.validation import fidelity, sessions

Measured = tuple[dict[str, Any], Figure | None]


@dataclass(frozen=True)
class Fidelity(Command):
    """Measure how much the simulation can be trusted, into a folder of report.json, report.txt and pictures.

    Is the solver converged; do the engines agree; does the arm stand where the recorded one stood; how alike are
    the wrenches of each session? What needs recordings is left out without them. Interrupted, it goes on where it
    stopped when called again: finished parts wait in OUT/parts.

    Example: rcbht fidelity fidelity-out --recorded hiro.zarr --data ../shared/data/hiro
    """

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")] = Path("fidelity-out")
    """Folder to write to; made if it is not there."""
    recorded: Annotated[Path | None, tyro.conf.arg(metavar="HIRO.zarr")] = None
    """Store of the recorded trials, made by "rcbht import hiro": for the signatures."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of the recorded trials: for the kinematics."""
    sessions: tuple[Literal["A", "B", "C", "openhrp"], ...] = ("A", "B", "C", "openhrp")
    """Sessions whose signatures are compared."""
    engines: tuple[Literal["mjx", "warp"], ...] = ()
    """Engines to hold against the native one; slow without a graphics card."""
    trials: int = 64
    """Randomised trials for solver and engines."""
    longest: float = 13.0
    """Stop them after this many seconds."""
    seed: int = 0
    """Of all trials."""

    def run(self) -> dict[str, Any]:
        start = time.perf_counter()
        self._check()
        jobs = self._jobs()
        (self.out / "parts").mkdir(parents=True, exist_ok=True)
        report: dict[str, Any] = {"rcbht_jax": rcbht_jax.__version__, "seed": self.seed}
        for place, (name, job) in enumerate(jobs.items()):
            print(f"[{place + 1}/{len(jobs)}] {name}", file=sys.stderr, flush=True)
            report[name] = self._part(name, job)
        missing = {"kinematics": self.data, "signatures": self.recorded}
        report["left_out"] = [name for name, given in missing.items() if given is None]
        _write(self.out / "report.json", json.dumps(report, indent=1, allow_nan=False) + "\n")
        _write(self.out / "report.txt", table(report) + "\n")
        return {**report, "folder": str(self.out), "seconds": time.perf_counter() - start}

    def text(self, result: dict[str, Any]) -> str:
        return f"{table(result)}\n\n{result['folder']}: report.json, report.txt, pictures ({result['seconds']:.0f} s)"

    def _check(self) -> None:
        if self.trials < 4 or not 0.0 < self.longest < 1000.0:
            raise InputError(f"{self.trials} trials of {self.longest} s: expected at least 4, and a positive time.")
        if self.out.exists() and not self.out.is_dir():
            raise InputError(f"{self.out} is a file; name a folder.")
        if self.data is not None and not self.data.is_dir():
            raise InputError(f"{self.data} is not a folder; expected that of the authors' data sets.")

    def _jobs(self) -> dict[str, Callable[[], Measured]]:
        """What is to be measured, in order; raises now what could not be measured later."""
        options = (self.trials, self.seed, self.longest)
        jobs: dict[str, Callable[[], Measured]] = {"solver": lambda: (fidelity.convergence(*options), None)}
        for engine in self.engines:
            jobs[f"engine {engine}"] = partial(_parity, engine, *options)
        if self.data is not None:
            data = self.data
            jobs["kinematics"] = lambda: (fidelity.kinematics(data), None)
        if self.recorded is not None:
            recordings = read_recordings(self.recorded)
            for name in self.sessions:
                target = sessions.recorded(recordings, name)
                jobs[f"session {name}"] = partial(fidelity.session, target, None, self.seed)
        return jobs

    def _part(self, name: str, job: Callable[[], Measured]) -> dict[str, Any]:
        """Measure one part, unless an earlier run with the same options, data and code has."""
        path = self.out / "parts" / f"{name.replace(' ', '-')}.json"
        made_by = self._made_by()
        with suppress(InputError):  # of other options or code, or damaged: measured again
            if (earlier := checkpoint.load(path, made_by)) is not None:
                return earlier
        result, figure = job()
        if figure is not None:
            save(figure, self.out / f"{name.replace(' ', '-')}.png")
        checkpoint.save(path, made_by, result)
        return result

    def _made_by(self) -> list[Any]:
        """Everything that a part depends on."""
        data = None if self.recorded is None else read_attrs(self.recorded)["content_sha256"]
        folder = None if self.data is None else str(self.data.resolve())
        return [pipeline.code_hash(), self.trials, self.longest, self.seed, data, folder]


def _parity(engine: str, trials: int, seed: int, longest: float) -> Measured:
    return fidelity.parity(engine, trials, seed, longest), None


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as draft:
        draft.write_text(text, encoding="utf-8")


def table(report: dict[str, Any]) -> str:
    """The report as a table: what was measured, its limit, whether it holds."""
    lines = [_solver(report["solver"])]
    lines += [_engine(value) for name, value in report.items() if name.startswith("engine ")]
    for name, row in report.get("kinematics", {}).items():
        said = f"{row['rms_mm']:.4f} mm, {row['rms_degrees']:.4f} deg rms over {row['trials']} approaches"
        lines.append(_line(f"kinematics {name}", said, "{:g} mm, {:g} deg".format(*row["limits"]), row["holds"]))
    lines += [line for name, value in report.items() if name.startswith("session ") for line in _session(name, value)]
    if report["left_out"]:
        lines.append(f"left out without recordings: {', '.join(report['left_out'])}")
    return "\n".join(lines)


def _snaps(found: dict[str, Any]) -> str:
    counts = "none in {}, one in {}, two in {}, more in {}".format(*found["trials_with_0_1_2_more"])
    if not found["drop_N_5_50_95_percent"]:
        return counts
    release, drop = found["release_N_5_50_95_percent"][1], found["drop_N_5_50_95_percent"][1]
    return f"{counts}; median release {release} N, drop {drop} N"


def _line(name: str, said: str, limit: str = "", holds: bool | None = None) -> str:
    verdict = "" if holds is None else ("ok" if holds else "MISSED")
    return f"{name:20}{said:64}{f'limit {limit}' if limit else '':34}{verdict}".rstrip()


def _solver(row: dict[str, Any]) -> str:
    step, limits = row["step"], row["limits"]
    said = f"{step['force']:.2g} N, {step['moment']:.2g} Nm from converged, {row['trials']} trials"
    return _line("solver", said, f"{limits['force']:g} N, {limits['moment']:g} Nm", row["holds"])


def _engine(row: dict[str, Any]) -> str:
    said = (
        f"{row['force_until_contact']:.2g} N until contact, labels {min(row['labels'].values()):.1%}, "
        f"outcome {row['same_outcome']:.1%}"
    )
    limits = row["limits"]
    limit = f"{limits['force']:g} N, {limits['labels']:.0%}, {limits['outcome']:.0%}"
    return _line(f"engine {row['engine']}", said, limit, row["holds"])


def _session(name: str, row: dict[str, Any]) -> list[str]:
    lines = []
    if row["mated"]:
        said = f"coverage {row['coverage']:.2f}, W1/sd {row['w1_over_sd']:.2f}, DTW/sd {row['dtw_over_sd']:.2f}"
        limit = "{coverage}, {w1_over_sd}, {dtw_over_sd}".format(**row["limits"]) if row["limits"] else ""
        lines.append(_line(name, f"{said}; {row['mated']} of {row['trials']} mated", limit, row["holds"]))
    else:
        lines.append(_line(name, f"none of {row['trials']} trials mated for a second", holds=False))
    if row["onsets"] is not None:
        pairs = zip(row["onsets"], row["recorded_onsets"], strict=True)
        said = ", ".join(f"{found:.2f} ({recorded:.2f})" for found, recorded in pairs)
        lines.append(_line("", f"onsets (recorded): {said} s"))
    if row["ring"] and row["recorded_ring"]:
        values = [row[which][key] for key in ("hertz", "peak") for which in ("ring", "recorded_ring")]
        lines.append(_line("", "ring (recorded): {:.2f} ({:.2f}) Hz, peak {:.1f} ({:.1f}) N".format(*values)))
    for which, found in (("snaps", row["snaps"]), ("recorded snaps", row["recorded_snaps"])):
        if found and found["trials"]:
            lines.append(_line("", f"{which} of seated trials: {_snaps(found)}"))
    lines.append(_line("", f"all four tabs seated: {row['seated']:.1%}"))
    if "outcomes_as_recorded" in row:
        lines[-1] += "; outcomes as recorded: {} of {}".format(*row["outcomes_as_recorded"])
    return lines
