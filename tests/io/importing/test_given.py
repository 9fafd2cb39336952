"""Annotations of a whole file: on which clock they are, and of which of its recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.mapping import Mapping

SPANS = [("a", 3.5, 10.0), ("b", 10.0, 21.0), ("c", 21.0, 23.0), ("d", 23.0, 23.15)]


def write(path: Path, time: np.ndarray, **columns: list[str]) -> None:
    lines = [f"{t:.3f},{k % 7},{k % 11}" for k, t in enumerate(time)]
    for values in columns.values():
        lines = [f"{line},{value}" for line, value in zip(lines, values, strict=True)]
    path.write_text("\n".join([",".join(["t", "Fz", "Mz", *columns]), *lines]))


def labels(folder: Path, spans: list[tuple[str, float, float]]) -> None:
    rows = [f"{label},{start},{end}\n" for label, start, end in spans]
    (folder / "a_labels.csv").write_text("label,start,end\n" + "".join(rows))


def found(imported: Imported) -> list[tuple[str, str, float, float]]:
    recordings, marks = imported.recordings, imported.recordings.annotations
    names = recordings.trial[marks.recording].tolist()
    times = (marks.start.round(3).tolist(), marks.end.round(3).tolist())
    return list(zip(names, marks.names().tolist(), *times, strict=True))


@pytest.mark.parametrize("beside", [False, True])
def test_annotations_of_a_file_are_on_one_clock(beside: bool, tmp_path: Path) -> None:
    """The first two were in s from the first sample, the last two on the clock."""
    write(tmp_path / "a.csv", 3.2 + np.arange(2000) * 0.01)
    if beside:
        labels(tmp_path, SPANS)
    else:
        phases = [dict(zip(("label", "start", "end"), span, strict=True)) for span in SPANS]
        (tmp_path / "a.json").write_text(json.dumps({"robot": "x", "phases": phases}))
    imported = read_source(tmp_path)
    assert [row[2:] for row in found(imported)] == [(0.3, 6.8), (6.8, 17.8), (17.8, 19.8), (19.8, 19.95)]
    assert not imported.report.warnings


def test_one_that_begins_before_the_clock_shows_that_all_are_from_the_first_sample(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", 3.2 + np.arange(2000) * 0.01)
    labels(tmp_path, [("a", 1.0, 4.0), ("b", 5.0, 8.0), ("late", 21.0, 22.0)])
    imported = read_source(tmp_path)
    assert [row[1:] for row in found(imported)] == [("a", 1.0, 4.0), ("b", 5.0, 8.0)]
    [(_, text)] = imported.report.warnings
    assert "label 'late' at 21 s is after the end (20 s); left out" in text


@pytest.mark.parametrize(("origin", "said"), [(3.2, 1), (0.0, 0), (0.01, 0)])
def test_annotations_that_fit_both_clocks_are_said(origin: float, said: int, tmp_path: Path) -> None:
    write(tmp_path / "a.csv", origin + np.arange(2000) * 0.01)
    labels(tmp_path, [("a", 4.0, 5.0)])
    imported = read_source(tmp_path)
    assert [row[2:] for row in found(imported)] == [(4.0, 5.0)]
    assert sum("fit its clock, which begins at 3.2 s" in text for _, text in imported.report.warnings) == said


PHASES = [{"label": "push", "start": 0.5, "end": 0.8}, {"label": "pull", "start": 2.1, "end": 2.2}]


@pytest.mark.parametrize("origin", [0.0, 1.7e9])
@pytest.mark.parametrize("stamped", [False, True])
def test_annotations_of_a_file_are_of_the_recording_in_which_they_begin(
    origin: float, stamped: bool, tmp_path: Path
) -> None:
    """Every part of a file had all of them."""
    write(tmp_path / "a.csv", origin + np.arange(300) * 0.01, run=["1"] * 200 + ["2"] * 100)
    shift = origin if stamped else 0.0
    phases = [{**one, "start": one["start"] + shift, "end": one["end"] + shift} for one in PHASES]  # type: ignore[operator]
    phases.append({"label": "never", "start": 7.0 + shift, "end": 8.0 + shift})
    (tmp_path / "a.json").write_text(json.dumps({"phases": phases}))
    imported = read_source(tmp_path, mapping=Mapping(group="run"))
    assert found(imported) == [("a-1", "push", 0.5, 0.8), ("a-2", "pull", 0.1, 0.2)]
    assert imported.report.skipped == [
        ("a.csv", "1 annotation of the file is of none of its recordings, and left out.")
    ]


@pytest.mark.parametrize("group", ["", "run"])
def test_annotations_of_a_file_whose_time_starts_anew_are_of_no_recording(group: str, tmp_path: Path) -> None:
    write(tmp_path / "a.csv", np.tile(np.arange(150) * 0.01, 2), run=["1"] * 150 + ["2"] * 150)
    (tmp_path / "a.json").write_text(json.dumps({"phases": PHASES}))
    imported = read_source(tmp_path, mapping=Mapping(group=group))
    assert (len(imported.recordings), found(imported)) == (2, [])
    [(_, text)] = imported.report.skipped
    assert "2 annotations of the file are of none of its recordings, since its time starts anew in each" in text


def test_arms_of_one_trial_share_the_annotations_of_their_file(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", np.tile(np.arange(150) * 0.01, 2), arm=["left"] * 150 + ["right"] * 150)
    (tmp_path / "a.json").write_text(json.dumps({"phases": PHASES[:1]}))
    assert [row[1:] for row in found(read_source(tmp_path))] == [("push", 0.5, 0.8)] * 2


def test_rows_without_times_go_on_from_one_recording_to_the_next(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", np.arange(300) * 0.01, run=["1"] * 200 + ["2"] * 100)
    table = [",".join(line.split(",")[1:]) for line in (tmp_path / "a.csv").read_text().splitlines()]
    (tmp_path / "a.csv").write_text("\n".join(table))
    (tmp_path / "a.json").write_text(json.dumps({"phases": PHASES}))
    imported = read_source(tmp_path, mapping=Mapping(group="run", source_rate=100.0))
    assert found(imported) == [("a-1", "push", 0.5, 0.8), ("a-2", "pull", 0.1, 0.2)]


@pytest.mark.parametrize("before", ["", "hold,23:59:59.7,23:59:59.9\n"])
def test_times_of_day_after_midnight_without_a_date_are_reported(before: str, tmp_path: Path) -> None:
    """They were read as seconds from the first sample without a word."""
    times = [f"23:59:{59.5 + k / 100:06.3f}" if k < 50 else f"00:00:{(k - 50) / 100:06.3f}" for k in range(200)]
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz", *(f"{time},{k % 7}" for k, time in enumerate(times))]))
    (tmp_path / "a_labels.csv").write_text(f"label,start,end\n{before}push,00:00:00.2,00:00:00.6\n")
    imported = read_source(tmp_path)
    assert found(imported) == [("a", "push", 0.2, 0.6)]
    assert any("its times pass midnight" in text for _, text in imported.report.warnings)


@pytest.mark.parametrize("gap", [0.0, 300.0])
def test_a_gap_does_not_lengthen_the_last_sample(gap: float, tmp_path: Path) -> None:
    time = np.arange(400) * 0.005
    time[200:] += gap
    write(tmp_path / "a.csv", time, phase=["free"] * 200 + ["push"] * 200)
    labels(tmp_path, [("late", time[-1] + 0.2, time[-1] + 0.3)])
    imported = read_source(tmp_path)
    end = round(2 + gap, 3)
    assert [row[1:] for row in found(imported)] == [("free", 0.0, 1 + gap), ("push", 1 + gap, end)]
    assert end == round(imported.recordings.length[0] * imported.recordings.dt, 3)
    [(_, text)] = imported.report.warnings
    assert f"is after the end ({end:.6g} s); left out" in text
