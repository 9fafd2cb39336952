"""Every experiment, one after the other: complete results are skipped, interrupted ones resumed.

Run: make reproduce [FORCE=1] [LONG=1] [RESULTS=FOLDER] [JOBS=2], or
python -m experiments.reproduce WORK [--force] [--long] [--jobs 2]
WORK keeps what experiments share (the imported trials, simulated sets, a model), their output, and the minutes each
took (reproduce.json). A result that is there, of this version and complete is not made again, unless --force is given.
With RESULTS (RCBHT_RESULTS) results go to another folder, from nothing, and are compared with the committed ones at the
end. Experiments that take hours run in a shorter form, whose results stay in WORK/shorter and are compared with the
committed intervals; --long runs them whole.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import IO

from tqdm import tqdm

import rcbht_jax
from experiments._lib import agreement
from experiments._lib.catalogue import DATA, EXPERIMENTS, EXTERNAL, GOLDEN, MODEL, SHARED, STORE, Experiment
from experiments._lib.results_io import COMMITTED, RESULTS, machine, record_of
from rcbht_jax._util.atomic import atomic_write

RCBHT = ("-c", "import sys; from rcbht_jax.cli.main import main; sys.exit(main(sys.argv[1:]))")
_writing = Lock()


@dataclass(frozen=True)
class Form:
    """An experiment as it is run now: whole, or in its shorter form."""

    experiment: Experiment
    short: bool
    work: Path

    @property
    def minutes(self) -> float:
        return self.experiment.shorter_minutes if self.short else self.experiment.minutes

    @property
    def options(self) -> list[str]:
        extra = self.experiment.shorter if self.short else ()
        return [option.format(work=self.work) for option in (*self.experiment.options, *extra)]

    @property
    def results(self) -> Path:
        """Where its results go: those of a shorter form never among the whole ones."""
        return (self.work / "shorter").resolve() if self.short else RESULTS

    @property
    def begun(self) -> Path:
        """A file that is there while it runs, and after it was interrupted."""
        return self.work / f"{self.experiment.name}{'.shorter' if self.short else ''}.begun"

    def finished(self) -> bool:
        """Are its results there, of this version, and not left by an interruption?"""
        records = [record_of(name, self.results) for name in self.experiment.names]
        return not self.begun.exists() and all(
            record.get("rcbht_jax_version") == rcbht_jax.__version__
            and (self.short or record["result"].get("complete", True))  # a shorter form may leave rows out
            for record in records
        )


@dataclass(frozen=True)
class Spent:
    """Resources that a process used."""

    status: int
    minutes: float  # of the clock
    cpu_minutes: float  # of all its threads, and of the processes that it waited for
    memory_gb: float  # at most


def lacking(experiment: Experiment, peers: Path | None) -> str:
    """Why it cannot be run, in words; "" = it can."""
    if experiment.elsewhere:
        return experiment.elsewhere
    reasons = {
        "data": "" if DATA.is_dir() else "needs the recorded trials (RCBHT_DATA)",
        "external": "" if EXTERNAL.is_dir() else "needs the recordings of other robots (RCBHT_EXTERNAL)",
        "golden": "" if GOLDEN.is_dir() else "needs the reference results (RCBHT_GOLDEN)",
        "peers": "" if peers and peers.exists() else "needs the environment of the peers (make peers)",
    }
    return next((reasons[need] for need in experiment.needs if reasons[need]), "")


def call(
    words: Sequence[str],
    environment: Mapping[str, str] | None = None,
    out: IO[str] | None = None,
    err: IO[str] | None = None,
) -> Spent:
    """Run a process to its end; measures its own processor time even when others run at the same time.

    Its memory is at least that of this process, which must be small.
    """
    start = time.perf_counter()
    process = subprocess.Popen(words, env={**os.environ, **(environment or {})}, stdout=out, stderr=err)
    try:
        _, status, used = os.wait4(process.pid, 0)
    except BaseException:
        process.kill()
        process.wait()
        raise
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu = (used.ru_utime + used.ru_stime) / 60
    return Spent(process.returncode, (time.perf_counter() - start) / 60, cpu, used.ru_maxrss * 1024 / 1e9)


def prepare(chosen: list[Form], work: Path) -> None:
    """Make the missing inputs that the chosen experiments share; each experiment reports what it still lacks."""
    for target, command in SHARED.items():
        users = (STORE, MODEL) if target == STORE else (MODEL,)  # the model is made from the store
        wanted = any(user in form.experiment.options for form in chosen for user in users)
        if wanted and not Path(target.format(work=work)).exists():
            call([sys.executable, *RCBHT, *(word.format(work=work) for word in command[1:])])


def run(form: Form, peers: Path | None, force: bool, quiet: bool) -> Spent:
    """Run one experiment; its output goes to WORK, its progress to the terminal unless ``quiet``."""
    python = str(peers) if "peers" in form.experiment.needs else sys.executable
    if force and not form.begun.exists():
        for name in form.experiment.names:
            (form.results / f"{name}.json").unlink(missing_ok=True)
    form.begun.touch()
    command = [python, "-m", f"experiments.{form.experiment.module}", *form.options]
    with form.begun.with_suffix(".log").open("w", encoding="utf-8") as log:
        spent = call(command, {"RCBHT_RESULTS": str(form.results)}, log, log if quiet else None)
    if spent.status == 0:
        form.begun.unlink()
    return spent


def note(form: Form, spent: Spent) -> None:
    """Record the resources of an experiment in WORK/reproduce.json."""
    path = form.work / "reproduce.json"
    entry = {
        "options": " ".join(form.options),
        "shorter form": form.short,
        "date": datetime.now(UTC).date().isoformat(),
        **{name: round(value, 2) for name, value in asdict(spent).items()},
    }
    with _writing:
        known = record_of("reproduce", form.work) or {"experiments": {}}
        known |= {"rcbht_jax_version": rcbht_jax.__version__, "machine": machine()}
        known["experiments"][form.experiment.name] = entry
        with atomic_write(path) as draft:
            draft.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def compare(forms: list[Form]) -> list[str]:
    """Lines on the differences of results in another folder, and of shorter forms, from the committed ones."""
    lines = []
    if RESULTS != COMMITTED:
        for path in sorted(RESULTS.glob("*.json")):
            if committed := record_of(path.stem, COMMITTED):
                lines.append(agreement.whole(path.stem, record_of(path.stem, RESULTS)["result"], committed["result"]))
    for form in (form for form in forms if form.short):
        for name in form.experiment.names:
            made, committed = record_of(name, form.results), record_of(name, COMMITTED)
            if made and committed:
                options = " ".join(form.experiment.shorter)
                lines.append(agreement.shorter(name, made["result"], committed["result"], options))
    return lines


def choose(args: argparse.Namespace) -> list[Form]:
    """The experiments to run; prints why for each that is left out."""
    todo = []
    for experiment in (e for e in EXPERIMENTS if not args.only or e.name in args.only):
        whole = Form(experiment, False, args.work)
        form = Form(experiment, bool(experiment.shorter) and not args.long, args.work)
        if reason := lacking(experiment, args.peers):
            print(f"{experiment.name}: not run here, {reason}", flush=True)
        elif (whole.finished() or form.finished()) and not args.force:
            print(f"{experiment.name}: is there", flush=True)
        else:
            todo.append(form)
    return todo


def run_all(todo: list[Form], args: argparse.Namespace) -> tuple[list[str], float]:
    """Run the experiments; returns the names of those that failed, and CPU minutes."""
    failed: list[str] = []
    cpu: list[float] = []

    def one(form: Form) -> None:
        spent = run(form, args.peers, args.force, quiet=args.jobs > 1)
        note(form, spent)
        cpu.append(spent.cpu_minutes)
        if spent.status:
            failed.append(form.experiment.name)
        name = form.experiment.name + (", shorter form" if form.short else "")
        took = f"{spent.minutes:.1f} min, {spent.cpu_minutes:.1f} CPU min of about {form.minutes:g}"
        bar.write(f"{name}: {'failed' if spent.status else 'done'}, {took}")
        bar.update(form.minutes)

    with tqdm(total=sum(form.minutes for form in todo), unit="min", desc="reproduce", file=sys.stdout) as bar:
        with ThreadPoolExecutor(max(1, args.jobs)) as pool:
            list(pool.map(one, [form for form in todo if not form.experiment.alone]))
        for form in (form for form in todo if form.experiment.alone):
            one(form)
    return failed, sum(cpu)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--force", action="store_true", help="make results again that are there")
    parser.add_argument("--long", action="store_true", help="run what takes hours whole, not in its shorter form")
    parser.add_argument("--only", nargs="+", choices=[e.name for e in EXPERIMENTS], help="these experiments")
    parser.add_argument("--peers", type=Path, help="Python of the environment that has the libraries of the peers")
    parser.add_argument("--jobs", type=int, default=1, help="experiments at a time; those that measure speed run alone")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    todo = choose(args)
    prepare(todo, args.work)
    began = time.perf_counter()
    failed, cpu = run_all(todo, args)
    for line in compare(todo):
        print(line)
    minutes = (time.perf_counter() - began) / 60
    print(f"{minutes:.0f} minutes, {cpu:.0f} CPU minutes; failed: {', '.join(failed) or 'none'}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:  # map leaves out what has not begun; what ran got the interruption too
        sys.exit("Interrupted; the same command goes on from here.")
