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


@pytest.mark.parametrize("first", [0, 1])
def test_a_sensor_of_half_the_rate_of_the_log_keeps_its_rate(tmp_path: Path, first: int) -> None:
    """Every second sample was interpolated, at the rate of the log."""
    lines = [f"{0.01 * k},{row[0] if k % 2 == first else ''}" for k, row in enumerate(FORCES)]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz", *lines]))
    recordings = read_source(tmp_path).recordings
    assert recordings.dt == 0.02
    np.testing.assert_allclose(recordings.wrench[0, :, 0], FORCES[first::2, 0], rtol=1e-6)


def test_samples_without_a_value_are_counted_and_many_are_remarked(tmp_path: Path) -> None:
    """The note counted values, three for each sample, and no remark said that a quarter was interpolated."""
    for every, noted in ((4, 1), (12, 0)):
        lines = [f"{0.01 * k}," + (",," if k % every == 1 else ",".join(map(str, row))) for k, row in enumerate(FORCES)]
        (tmp_path / "run.csv").write_text("\n".join(["t,Fx,Fy,Fz", *lines]))
        imported = read_source(tmp_path)
        assert imported.recordings.note.tolist() == [f"missing:{N // every}"]
        assert sum("lacks values in many samples, up to 25 %" in text for text in imported.report.remarks) == noted
