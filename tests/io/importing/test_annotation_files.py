"""Annotations as programs for labelling export them, and what is wrong in them."""

from __future__ import annotations

import json
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.marks import at_samples
from rcbht_jax.io.importing.sidecars import regions_in

N = 40
LABELS = [("push", 0.1, 0.2), ("pull", 0.2, 0.35)]
DATED = [f"2026-05-01 12:00:00.{round(1000 * time):03}" for time in np.arange(N) * 0.01]


def write(folder: Path, times: list[str] | None = None) -> None:
    for number in (1, 2):
        rows = [f"{times[k] if times else k / 100},{k % 7 + number}" for k in range(N)]
        (folder / f"run{number}.csv").write_text("\n".join(["t,Fz", *rows]))


def marks(dated: bool = False) -> list[dict[str, Any]]:
    times = [
        (DATED[round(100 * start)], DATED[round(100 * end)]) if dated else (start, end) for _, start, end in LABELS
    ]
    return [
        {"start": start, "end": end, "instant": False, "timeserieslabels": [label]}
        for (label, _, _), (start, end) in zip(LABELS, times, strict=True)
    ]


def found(imported: Imported, tracks: list[str]) -> list[tuple[str, float, float]]:
    recordings, annotations = imported.recordings, imported.recordings.annotations
    assert set(recordings.trial[annotations.recording].tolist()) == {"run2"}
    assert imported.report.warnings == imported.report.skipped == []
    assert sorted(set(np.array(annotations.tracks)[annotations.track].tolist())) == tracks
    rows = zip(annotations.names().tolist(), annotations.start, annotations.end, strict=True)
    return [(name, round(start, 6), round(end, 6)) for name, start, end in rows]


@pytest.mark.parametrize("file", ["s3://bucket/runs/run2.csv?versionId=1.2", "/data/local-files/?d=runs/run2.csv"])
@pytest.mark.parametrize("dated", [False, True])
def test_label_studio_as_json(file: str, dated: bool, tmp_path: Path) -> None:
    write(tmp_path, DATED if dated else None)
    task = {"data": {"ts": file}, "annotations": [{"result": [{"value": mark} for mark in marks(dated)]}]}
    (tmp_path / "project.json").write_text(json.dumps([task]))
    assert found(read_source(tmp_path), ["label"]) == LABELS


def test_two_people_who_labelled_one_file_have_tracks_of_their_own(tmp_path: Path) -> None:
    write(tmp_path)
    one = {"result": [{"value": mark} for mark in marks()]}
    rest = {"predictions": [one], "drafts": [one]}
    annotations = [one, {**one, "was_cancelled": True}, one]
    task = {"data": {"ts": "run2.csv"}, "annotations": annotations, **rest}
    (tmp_path / "project.json").write_text(json.dumps([task]))
    assert found(read_source(tmp_path), ["label", "label_2"]) == LABELS * 2


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run2_labels.csv", "label,start,end\npush,0.3,0.2\n"),
        ("run2_labels.csv", "label,start,duration\npush,0.3,-0.1\n"),
        ("run2_labels.csv", "label,start,end\npush,00:00:00.300,00:00:00.200\n"),
        ("run2_labels.csv", "0.3\t0.2\tpush\n0.3\t0.35\tpull\n"),
        ("run2.json", '{"phases": [{"label": "push", "start": 0.3, "end": 0.2}]}'),
        ("all.json", '[{"csv": "run2.csv", "label": [{"start": 0.3, "end": 0.2, "timeserieslabels": ["push"]}]}]'),
    ],
)
def test_an_annotation_that_ends_before_it_begins_is_told(name: str, text: str, tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / name).write_text(text)
    imported = read_source(tmp_path)
    [(recording, problem)] = imported.report.warnings
    assert (recording, "'push' ends before it begins (0.2 < 0.3 s); its end is unknown." in problem) == (
        "run2.csv",
        True,
    )
    assert np.isnan(imported.recordings.annotations.end[0])


def test_an_annotation_that_ends_long_after_the_recording_is_told(tmp_path: Path) -> None:
    """Milliseconds without a unit: a label of the whole recording, without a word."""
    write(tmp_path)
    (tmp_path / "run1_labels.csv").write_text("label,start,end\npush,0,200")
    (tmp_path / "run2_labels.csv").write_text("label,start,end\npush,0,0.45")  # as a person marks the end
    [(name, problem)] = read_source(tmp_path).report.warnings
    assert name == "run1.csv"
    assert problem == "label 'push' ends at 200 s, after the end (0.4 s). Is the unit of its times right?"


def test_annotations_of_a_recording_that_is_not_there_are_told(tmp_path: Path) -> None:
    write(tmp_path)
    rows = ["recording,label,start,end", "run1,push,0.1,0.2", "rum2,push,0.1,0.2", "rum2,pull,0.2,0.3"]
    (tmp_path / "phases.csv").write_text("\n".join(rows))
    imported = read_source(tmp_path)
    assert imported.report.warnings == [("phases.csv", "2 annotations are of no recording here, and left out: 'rum2'.")]
    assert imported.recordings.annotations.names().tolist() == ["push"]


def test_columns_of_annotations_that_are_not_understood_are_told(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "run2_labels.csv").write_text("label;start;bis\npush;0,1;0,2\npull;0,2;0,35\n")
    remarks = read_source(tmp_path).report.remarks
    assert "run2_labels.csv is a table of annotations; left out of it: 'bis'." in remarks


anything = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["start", "end", "timeserieslabels", "result", "value", "csv"]), inner)
    ),
)


@given(st.lists(anything, max_size=3))
def test_other_json_is_no_export_or_has_whole_rows(tasks: list[Any]) -> None:
    for row in regions_in(tasks):
        assert set(row) == {"file", "track", "label", "start", "end"}


def test_a_region_whose_label_is_none_has_none() -> None:
    region = {"start": 0.0, "end": 1.0, "timeserieslabels": [None, "push"]}
    assert [row["label"] for row in regions_in([{"csv": "b.csv", **region}])] == ["push"]


@pytest.mark.parametrize(("title", "scale"), [("start_ms", 1000), ("start [us]", 1e6), ("start", 1)])
def test_a_duration_without_a_unit_has_that_of_its_start(title: str, scale: float, tmp_path: Path) -> None:
    write(tmp_path)
    rows = [f"{label},{start * scale},{(end - start) * scale}\n" for label, start, end in LABELS]
    (tmp_path / "run1_labels.csv").write_text(f"label,{title},duration\n" + "".join(rows))
    marks = read_source(tmp_path).recordings.annotations
    np.testing.assert_allclose([marks.start, marks.end], np.transpose([row[1:] for row in LABELS]), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "head"),
    [("run2_labels.csv", "label,start_sample,end_sample"), ("a.csv", "file,label,start [samples],end [samples]"),
     ("a.csv", "file,label,start_idx,end_idx")],
)  # fmt: skip
def test_annotations_may_count_samples(name: str, head: str, tmp_path: Path) -> None:
    write(tmp_path)
    file = "run2.csv," if head.startswith("file") else ""
    rows = [f"{file}{label},{round(100 * start)},{round(100 * end)}" for label, start, end in LABELS]
    (tmp_path / name).write_text("\n".join([head, *rows]))
    imported = read_source(tmp_path)
    assert imported.report.skipped == imported.report.warnings == []
    assert found(imported, ["label"]) == LABELS


def test_annotations_that_count_frames_say_so(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "run2_labels.csv").write_text("label,start_frame,end_frame\npush,3,6\n")
    [(name, reason)] = read_source(tmp_path).report.skipped
    assert name == "run2_labels.csv"
    assert "start_frame counts frames, perhaps of a video;" in reason


def test_times_stay_beside_frames(tmp_path: Path) -> None:
    write(tmp_path)
    rows = [f"{label},{start},{end},3,6" for label, start, end in LABELS]
    (tmp_path / "run2_labels.csv").write_text("\n".join(["label,start_time,end_time,start_frame,end_frame", *rows]))
    assert found(read_source(tmp_path), ["label"]) == LABELS


def test_a_start_in_samples_and_an_end_in_seconds_are_not_mixed(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "run2_labels.csv").write_text("label,start_sample,end [s]\npush,3,0.2\npull,6,0.3\n")
    imported = read_source(tmp_path)
    assert len(imported.recordings.annotations.start) == 0
    assert [name for name, _ in imported.report.skipped] == ["run2_labels.csv"]


def test_annotations_that_count_samples_are_placed_in_linear_time() -> None:
    time, spent = np.arange(100_000) / 1000, []
    for count in (2, 200):
        start = process_time()
        at_samples([("label", "push", 1.0, 2.0)] * count, time, 0.001)
        spent.append(process_time() - start)
    assert spent[1] < 20 * spent[0]
