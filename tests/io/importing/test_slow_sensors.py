"""Logs of sensors that are slower than the log, or stop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from tests.io.importing.test_importer import noise, write


def test_a_log_that_repeats_the_values_of_a_slower_sensor_has_the_rate_of_the_sensor(tmp_path: Path) -> None:
    measured = noise(0)
    phase = ["free"] * 500 + ["push"] * 498
    write(tmp_path / "a.csv", np.repeat(measured, 5)[2:], phase=phase)
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert (recordings.dt, recordings.note.tolist()) == (0.01, ["held:799"])
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], measured[1:].astype(np.float32))
    np.testing.assert_allclose(recordings.starts("phase"), [[0.0, 0.994]])  # from the first whole value on
    assert imported.report.remarks[0] == "1 log held each value for several rows; the repeats were left out."


def test_a_stuck_axis_is_noted(tmp_path: Path) -> None:
    values = noise(0)
    write(tmp_path / "a.csv", np.where(np.arange(200) < 80, values, values[80]))
    assert read_source(tmp_path).recordings.note.tolist() == ["stuck:Fz"]


def test_an_axis_that_never_changes_is_remarked_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for number in range(3):
        values = rng.normal(size=(200, 3))
        values[:, 1] = number
        values[:, 2] *= number > 0
        table = np.column_stack([np.arange(200) * 0.01, values])
        np.savetxt(tmp_path / f"{number}.csv", table, "%.6g", ",", header="t,Fx,Fy,Fz", comments="")
    remarks = [text for text in read_source(tmp_path).report.remarks if "never changes" in text]
    assert remarks == [
        "Fy never changes within any recording; is its sensor connected?",
        "Fz never changes within 1 of 3 recordings; is its sensor connected?",
    ]


@pytest.mark.parametrize("held", [True, False])
def test_a_sensor_of_three_fifths_of_the_rate_of_its_log_keeps_its_rate(held: bool, tmp_path: Path) -> None:
    measured, lines = noise(0, 300), ["t,Fz"]
    newest = np.arange(500) * 3 // 5
    fresh = np.diff(newest, prepend=-1) > 0
    for row, (place, new) in enumerate(zip(newest.tolist(), fresh.tolist(), strict=True)):
        lines.append(f"{0.002 * row:.3f},{measured[place] if held or new else ''}")
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    recordings = read_source(tmp_path).recordings
    assert (1 / recordings.dt, len(recordings.wrench[0])) == (pytest.approx(300), 300)


def test_samples_that_come_in_bursts_are_warned_of(tmp_path: Path) -> None:
    number = np.arange(400)
    time = number // 8 * 0.016 + number % 8 * 0.0001
    rows = [f"{stamp:.4f},{value}" for stamp, value in zip(time, noise(0, 400), strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz", *rows]) + "\n")
    why = "samples come in bursts; if they were taken evenly, --source-rate 500 replaces their stamps."
    assert read_source(tmp_path).report.warnings == [("a.csv", why)]
    recordings = read_source(tmp_path, mapping=Mapping(source_rate=500.0)).recordings
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], noise(0, 400).astype(np.float32))
