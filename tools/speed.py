"""Whether this tree is as fast as an earlier commit, measured in turns on this machine.

Numbers of one machine say little about another: even ratios to a reference of the same run differ between processors
by a factor of two. So the sources of the commit in benchmarks/baseline are unpacked into a temporary folder, and both
run ``rcbht bench`` in this environment. Other work on the machine only makes a run slower, so the best run of each
counts, and a measurement that seems to have fallen is repeated.

Run: python -m tools.speed; the exit status is 1 if a speed has fallen by more than 20 %.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

from rcbht_jax._util.ratios import FALL

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = (2, 6)  # at least, and at most if something seems to have fallen
FASTER = {"samples/s": True, "bytes/s": True, "us": False, "s": False}  # unit -> whether more is faster
LEFT_OUT = ("/compile", "/p99", "peer/")  # parts of names: too noisy, or not of this project
Speeds = dict[str, float]  # name -> per second


def speeds_of(values: Mapping[str, Mapping[str, object]]) -> Speeds:
    """The speeds among the values of ``rcbht bench --json``; times become their inverse.

    >>> speeds_of({"step": {"value": 4.0, "unit": "us"}, "step/p99": {"value": 9.0, "unit": "us"}})
    {'step': 0.25}
    """
    speeds = {}
    for name, entry in values.items():
        value, unit = float(str(entry["value"])), str(entry["unit"])
        if unit in FASTER and not any(part in name for part in LEFT_OUT):
            speeds[name] = value if FASTER[unit] else 1 / value
    return speeds


def relative(ours: Sequence[Speeds], theirs: Sequence[Speeds]) -> Speeds:
    """Best of our runs in units of the best of theirs; 0 where we no longer measure it.

    >>> relative([{"step": 1.0}, {"step": 3.0}], [{"step": 2.0, "read": 1.0}])
    {'step': 1.5, 'read': 0.0}
    """
    names = dict.fromkeys(name for run in theirs for name in run)
    return {name: max(run.get(name, 0.0) for run in ours) / max(run.get(name, 0.0) for run in theirs) for name in names}


def compare(ours: Callable[[], Speeds], theirs: Callable[[], Speeds], rounds: tuple[int, int] = ROUNDS) -> Speeds:
    """Measure two trees in turns until nothing seems to have fallen, or ``rounds`` are over."""
    runs: tuple[list[Speeds], list[Speeds]] = ([], [])
    for done in range(1, rounds[1] + 1):
        runs[0].append(ours())
        runs[1].append(theirs())
        found = relative(*runs)
        if done >= rounds[0] and min(found.values()) >= 1 - FALL:
            break
    return found


def measure(tree: Path) -> Speeds:
    """One run of the benchmarks of a tree."""
    # earlier commits know no ``python -m rcbht_jax``
    command = [sys.executable, "-m", "rcbht_jax.cli.main", "bench", "--json"]
    env = {**os.environ, "PYTHONPATH": str(tree)}
    run = subprocess.run(command, cwd=tree, env=env, check=True, stdout=subprocess.PIPE, text=True)
    return speeds_of(json.loads(run.stdout)["values"])


def unpack(commit: str, folder: Path) -> bool:
    """The packages as they were at a commit; False without git, or if this is no clone that has it."""
    command = ["git", "archive", "--format=zip", commit, "rcbht_jax", "sim_mjx"]
    try:
        run = subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):  # git itself may be missing
        return False
    with ZipFile(BytesIO(run.stdout)) as archive:
        archive.extractall(folder)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    baseline = (ROOT / "benchmarks/baseline").read_text().strip()
    parser.add_argument(
        "--commit", default=baseline, help="what to compare with (default: that in benchmarks/baseline)"
    )
    commit = parser.parse_args().commit
    with tempfile.TemporaryDirectory() as folder:
        if not unpack(commit, Path(folder)):
            print(f"# nothing was compared: this is no clone with the commit {commit}")
            return 0
        found = compare(lambda: measure(ROOT), lambda: measure(Path(folder)))
    print(f"# speeds in units of those of {commit}, the best of runs in turns")
    for name, ratio in found.items():
        print(f"{name} {ratio:.3g} x{'  # has fallen by more than 20 %' if ratio < 1 - FALL else ''}")
    return int(min(found.values()) < 1 - FALL)


if __name__ == "__main__":
    sys.exit(main())
