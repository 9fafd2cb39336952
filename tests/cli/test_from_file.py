"""Files of other robots to words, picture, model, stream and report, by documented commands alone."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.store import read_recordings
from tests.support.command_line import CommandLine

MAPPINGS = Path(__file__).parents[2] / "examples" / "mappings"
RATE = 500  # Hz; of both robots, which then share what is compiled
PA10_STATES = ("home", "approach", "contact", "search", "insert")


def phases(samples: int, rate: float, number: int) -> np.ndarray:
    """A wrench [time, 6] whose five parts differ in slope and noise."""
    rng = np.random.default_rng(number)
    part = samples // 5
    slope = np.repeat([0.0, 0.0, 12.0, -3.0, 25.0], part)[:, None] * np.linspace(1, 0.3, 6)
    noise = np.repeat([0.01, 0.05, 0.05, 0.4, 0.1], part)[:, None]
    return np.cumsum(slope, axis=0) / rate + rng.normal(size=(5 * part, 6)) * noise


def pa10(folder: Path, _: Path) -> Path:
    """17 columns without names: time, joints, wrench, wrist pose, state from 0 to 4."""
    for number in range(3):
        wrench = phases(1000, RATE, number)
        time = np.arange(len(wrench))[:, None] / RATE
        state = np.repeat(np.arange(5), len(wrench) // 5)[:, None]
        rest = np.random.default_rng(number).normal(size=(len(wrench), 9))
        np.savetxt(folder / f"run{number}.txt", np.hstack([time, rest[:, :7], wrench, rest[:, 7:], state]), "%.5f")
    channels = [
        f'[[channels]]\ncolumn = "c{8 + k}"\nname = "{axis}"\n'
        for k, axis in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz"))
    ]
    words = ", ".join(f'"{code}" = "{name}"' for code, name in enumerate(PA10_STATES))
    marks = f'[[annotations]]\ntrack = "state"\ncolumn = "c16"\nwords = {{{words}}}\n'
    (folder / "pa10.toml").write_text("\n".join(['time = "c0"\n', *channels, marks]))
    return folder


def ur5(folder: Path, _: Path) -> Path:
    """As the client of a UR5 logs, with a column of text that names the phase."""
    head = ",".join(
        ["timestamp", *(f"actual_q_{k}" for k in range(6)), *(f"actual_TCP_force_{k}" for k in range(6)), "phase"]
    )
    for number in range(3):
        wrench = phases(1000, RATE, number)
        lines = [head]
        for k, row in enumerate(wrench):
            name = ("home", "move", "touch", "slide", "press")[5 * k // len(wrench)]
            lines.append(",".join([f"{k / RATE:.3f}", *["0.1"] * 6, *(f"{value:.4f}" for value in row), name]))
        (folder / f"log{number}.csv").write_text("\n".join(lines))
    return folder


def kitting(folder: Path, external: Path) -> Path:
    """Two norms at 20 Hz."""
    skills = json.loads((external / "kitting" / "skills.json").read_text())
    chosen = [entry for entry in skills if entry["skill"] == 3][:8] + [
        entry for entry in skills if entry["skill"] == 5
    ][:8]
    for entry in chosen:
        target = folder / entry["file"]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(external / "kitting" / entry["file"], target)
    (folder / "skills.json").write_text(json.dumps(chosen))
    return folder


def failures(folder: Path, external: Path) -> Path:
    """15 samples after the detection of a failure, of every third instance."""
    head, *lines = (external / "robot_execution_failures" / "lp1.csv").read_text().splitlines()
    (folder / "lp1.csv").write_text("\n".join([head, *(line for line in lines if int(line.split(",")[0]) % 3 == 0)]))
    return folder / "lp1.csv"


def bag(_: Path, external: Path) -> Path:
    return external / "bags"


@dataclass(frozen=True)
class Case:
    """A source, the words after ``import KIND SOURCE OUT``, the task of its model, and what a reader must find."""

    make: Callable[[Path, Path], Path]
    kind: str
    words: tuple[str, ...]
    task: str  # "" = the recordings have no classes
    rate: float
    axes: tuple[str, ...]
    window: int = 5


WRENCH = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
CASES = {
    "pa10": Case(pa10, "csv", ("--map", "{folder}/pa10.toml"), "state", RATE, WRENCH, 10),
    "ur5": Case(ur5, "csv", (), "phase", RATE, WRENCH, 10),
    "kitting": Case(kitting, "csv", ("--map", str(MAPPINGS / "kitting.toml")), "skill", 20, ("force", "torque")),
    "failures": Case(
        failures, "csv", ("--map", str(MAPPINGS / "robot_execution_failures.toml")), "class", 1 / 0.021, WRENCH
    ),
    "bag": Case(bag, "bag", (), "", 200, WRENCH),
}


@pytest.mark.parametrize("name", CASES)
def test_a_file_becomes_words_pictures_a_model_a_stream_and_a_report(
    name: str, external_dir: Path, tmp_path: Path, rcbht: CommandLine
) -> None:
    case = CASES[name]
    folder = tmp_path / "files"
    folder.mkdir()
    source, store = case.make(folder, external_dir), tmp_path / "mine.zarr"

    rcbht("import", case.kind, source, store, *(word.format(folder=folder) for word in case.words))
    recordings = read_recordings(store)
    assert (recordings.axes, 1 / recordings.dt) == (case.axes, pytest.approx(case.rate))
    made = json.loads(rcbht("encode", store, "--window", case.window, "--json"))
    assert made["thresholds_from"] == {"method": "auto"}
    assert made["labels"]["primitive"] >= len(recordings)
    trial, arm = str(recordings.trial[0]), str(recordings.arm[0])
    rcbht("plot", "trial", store, trial, "--arm", arm, "-o", tmp_path / "trial.png")
    rcbht("report", store, "-o", tmp_path / "report.html")
    assert f'"axes":{json.dumps(list(case.axes), separators=(",", ":"))}' in (tmp_path / "report.html").read_text()
    assert case.task in rcbht("info", store)
    if not case.task:
        return  # a model needs classes
    model, events = tmp_path / "my.model", tmp_path / "events.jsonl"
    rcbht("train-online", store, "--task", case.task, "--window", case.window, "-o", model)
    rcbht("stream", store, "--trial", trial, "--arm", arm, "--model", model, "-o", events)
    rcbht("report", store, "--model", model, "--trial", trial, "-o", tmp_path / "beliefs.html")
    beliefs = [json.loads(line) for line in events.read_text().splitlines() if '"probabilities"' in line]
    classes = set(recordings.columns.get(case.task, recordings.annotations.names()).tolist())
    assert beliefs
    assert {belief["label"] for belief in beliefs} <= classes
    assert (tmp_path / "trial.png").stat().st_size > 20_000
