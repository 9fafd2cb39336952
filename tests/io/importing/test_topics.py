"""Tables in which rows are messages of several topics, as PlotJuggler and others export them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source

N = 60
FORCES = np.random.default_rng(0).normal(size=(N, 3)).round(3)
HEAD = "__time,/ft/wrench/force/x,/ft/wrench/force/y,/ft/wrench/force/z,/joint_states/position[0],phase"


def write(path: Path, phases: bool = False) -> None:
    rows = [(0.01 * k, ",".join(map(str, row)) + ",,") for k, row in enumerate(FORCES)]
    rows += [(0.003 + 0.02 * k, f",,,{k},") for k in range(N // 2)]
    rows += [(t, f",,,,{word}") for t, word in ((-0.1, "idle"), (-0.05, "free"), (0.305, "push"))] if phases else []
    path.write_text("\n".join([HEAD, *(f"{t:.3f},{row}" for t, row in sorted(rows))]))


def test_rows_of_other_topics_are_no_samples(tmp_path: Path) -> None:
    write(tmp_path / "run.csv")
    recordings = read_source(tmp_path).recordings
    assert (recordings.dt, recordings.note.tolist()) == (0.01, [f"between:{N // 2}"])
    np.testing.assert_allclose(recordings.wrench[0], FORCES, rtol=1e-6)


def test_words_in_messages_of_their_own_hold_until_the_next(tmp_path: Path) -> None:
    write(tmp_path / "run.csv", phases=True)
    recordings = read_source(tmp_path).recordings
    assert recordings.starts("phase") == pytest.approx(np.array([[0.0, 0.305]]))
    assert recordings.annotations.end.tolist() == pytest.approx([0.305, 0.6])


def test_a_sensor_that_misses_samples_of_a_log_keeps_their_times(tmp_path: Path) -> None:
    gone = [3, 4, 20, 33]
    lines = [f"{0.01 * k},{'' if k in gone else row[0]},{k}" for k, row in enumerate(FORCES)]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz,joint", *lines]))
    assert read_source(tmp_path).recordings.note.tolist() == ["missing:4"]
