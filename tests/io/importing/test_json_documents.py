"""JSON documents: one recording or several, samples or columns, annotations, and data frames of pandas."""

from __future__ import annotations

import json
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.json_documents import read_json_document
from rcbht_jax.labels import AXES, UNITS

COUNT = 120
TIME = (np.arange(COUNT) * 0.01).round(4)
WRENCH = np.random.default_rng(0).normal(size=(5, COUNT, 6)).cumsum(1).round(4)
FRAME = pd.DataFrame({"time": TIME, **dict(zip(AXES, WRENCH[0].T, strict=True)), "phase": np.repeat(["a", "b"], 60)})
PHASES = [{"name": "free", "start": 0, "end": 0.5}, {"name": "push", "start": 0.5, "end": 1.19}]


def read(folder: Path, content: Any) -> Imported:
    path = folder / "runs.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_source(path)


def lists(number: int, length: int = COUNT) -> dict[str, Any]:
    return {"time": TIME[:length].tolist(), "wrench": WRENCH[number, :length].tolist()}


def samples(number: int) -> list[dict[str, Any]]:
    axes = (dict(zip("xyz", row, strict=True)) for row in WRENCH[number].reshape(COUNT * 2, 3).tolist())
    return [{"t": t, "force": next(axes), "torque": next(axes)} for t in TIME.tolist()]


ONE = {
    "samples": samples(0),
    "samples with a matrix each": [{**one, "pose": np.eye(4).tolist()} for one in samples(0)],
    "columns": {name: column.tolist() for name, column in FRAME.items()},
    "rows of a wrench": lists(0),
    "samples in an object": {"robot": "arm", "samples": samples(0), "phases": PHASES},
    "samples by time": {str(one["t"]): one for one in samples(0)},
    "columns beside a list of objects": {**lists(0), "parts": [{"part": "peg", "x": 1}, {"part": "hole", "x": 2}]},
    "within objects": {"log": {"data": lists(0)}},
    **{
        f"pandas, {orient}": FRAME.to_json(orient=orient)
        for orient in ("columns", "index", "split", "table", "records")
    },
}


@pytest.mark.parametrize("content", ONE.values(), ids=ONE)
def test_one_recording(content: Any, tmp_path: Path) -> None:
    imported = read(tmp_path, content)
    assert imported.recordings.axes == AXES
    assert not imported.report.warnings
    np.testing.assert_allclose(imported.recordings.wrench, WRENCH[:1], rtol=1e-6)
    assert imported.recordings.dt == pytest.approx(0.01)


SEVERAL = {
    "a list": [{**lists(number, 100 + number), "success": number > 0} for number in range(3)],
    "an object by number": {f"trial_{number}": {**lists(number), "success": number > 0} for number in range(3)},
    "an object by name": {name: {**lists(number), "success": number > 0} for number, name in enumerate("abc")},
    "a list of samples each": {
        "version": 2,
        "recordings": [{"samples": samples(number), "success": number > 0} for number in range(3)],
    },
}


def test_lists_of_samples_by_name_are_recordings(tmp_path: Path) -> None:
    recordings = read(tmp_path, {name: samples(number) for number, name in enumerate("ab")}).recordings
    assert recordings.trial.tolist() == ["runs-a", "runs-b"]
    assert read(tmp_path, {"later": lists(0), "first": lists(1)}).recordings.trial[0] == "runs-later"
    empty = {**{name: {**lists(number), "tags": []} for number, name in enumerate("ab")}, "notes": []}
    assert read(tmp_path, empty).recordings.trial.tolist() == ["runs-a", "runs-b"]
    raw = read(tmp_path, {name: samples(number) for number, name in enumerate(("raw", "filtered"))})
    assert raw.recordings.trial.tolist() == ["runs"]
    events = {name: [{"t": 0.1, "kind": name}] for name in ("contacts", "slips")}
    assert read(tmp_path, {**lists(0), **events}).recordings.trial.tolist() == ["runs"]


@pytest.mark.parametrize("content", SEVERAL.values(), ids=SEVERAL)
def test_several_recordings(content: Any, tmp_path: Path) -> None:
    recordings = read(tmp_path, content).recordings
    assert recordings.outcome.tolist() == ["failure", "success", "success"]
    for number, (one, length) in enumerate(zip(recordings.wrench, recordings.length.tolist(), strict=True)):
        np.testing.assert_allclose(one[:length], WRENCH[number, :length], rtol=1e-6)


def test_arms_annotations_and_what_is_stated_once(tmp_path: Path) -> None:
    arms = {"left": {"wrench": WRENCH[0].tolist()}, "right": {"wrench": WRENCH[1].tolist()}, "rate": 50, "part": "A"}
    recordings = read(tmp_path, arms).recordings
    assert recordings.arm.tolist() == ["left", "right"]
    assert 1 / recordings.dt == 50
    assert recordings.columns["part"].tolist() == ["A", "A"]
    marked = read(tmp_path, {**lists(0), "phases": PHASES}).recordings
    np.testing.assert_allclose(marked.starts("phases"), [[0, 0.5]])
    assert marked.annotations.labels == {"phases": ("free", "push")}


@pytest.mark.parametrize("names", [("left", "right"), ("trial_0", "trial_1")])
def test_what_stands_beside_recordings_is_of_all(names: tuple[str, str], tmp_path: Path) -> None:
    axes = [{axis: WRENCH[number, :, k].tolist() for k, axis in enumerate(AXES)} for number in range(2)]
    shared = {"t": TIME.tolist(), "phases": PHASES, "units": dict.fromkeys(AXES[:3], "N"), "gains": [1, 2]}
    imported = read(tmp_path, shared | dict(zip(names, axes, strict=True)))
    recordings = imported.recordings
    assert (recordings.dt, recordings.units[:3]) == (pytest.approx(0.01), ("N",) * 3)
    np.testing.assert_allclose(recordings.wrench, WRENCH[:2], rtol=1e-6)
    assert not recordings.columns
    lost = ["Arrays of another shape or kind were left out: 'phases'."]  # nothing says of which trial they are
    of_arms = "left" in names
    assert len(recordings.annotations) == (4 if of_arms else 0)
    assert [text for text in imported.report.remarks if "left out" in text] == ([] if of_arms else lost)


@pytest.mark.parametrize("orient", ["columns", "index", "split"])
@pytest.mark.parametrize("form", ["seconds", "dates", "milliseconds since 1970"])
def test_the_index_of_a_data_frame_may_be_its_time(orient: Any, form: str, tmp_path: Path) -> None:
    dates = pd.to_datetime(TIME, unit="s", origin="2024-05-01")
    stamps = 1_714_521_600_000 + (1000 * TIME).round().astype(np.int64)
    index = {"seconds": pd.Index(TIME), "dates": dates}.get(form, pd.Index(stamps))
    frame = pd.DataFrame(WRENCH[0], columns=list(AXES), index=index)
    recordings = read(tmp_path, frame.to_json(orient=orient, date_format="iso")).recordings
    assert (recordings.axes, recordings.dt) == (AXES, pytest.approx(0.01))
    np.testing.assert_allclose(recordings.wrench, WRENCH[:1], rtol=1e-6)


def test_missing_values_and_lists_of_another_length(tmp_path: Path) -> None:
    force = [None, *WRENCH[0, 1:, 2].tolist()]
    imported = read(tmp_path, {"dt": 0.01, "Fz": force, "speed": [1, 2, 3], "mixed": [1, "a"], "done": True})
    assert imported.recordings.axes == ("Fz",)
    np.testing.assert_allclose(imported.recordings.wrench[0, 1:, 0], WRENCH[0, 1:, 2], rtol=1e-6)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{", "is not a readable JSON file"),
        ("[]", "holds no array of at least two rows"),
        ('[1, "a", [2]]', "holds no array of at least two rows"),
        ("7", "holds no array of at least two rows"),
        ('{"Fz": [1]}', "holds no array of at least two rows"),
        ('[{"t": 0, "Fz": 1}, {"t": "x", "Fz": 2}]', "object 1: t is a text; before, it was a number"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 30 + "1" + "}" * 30, "nested more than 16 times"),
        ('{"Fz": [1e999, 2, 3]}', "holds no usable recording"),
        (json.dumps(PHASES), "holds no array of at least two rows"),
    ],
)
def test_what_is_no_recording_is_refused_with_its_reason(content: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=reason):
        read(tmp_path, content)


def test_beside_other_files_documents_describe_recordings(tmp_path: Path) -> None:
    FRAME.drop(columns="phase").to_csv(tmp_path / "run1.csv", index=False)
    FRAME.drop(columns="phase").assign(Fz=0.5).to_csv(tmp_path / "run2.csv", index=False)
    (tmp_path / "run1.json").write_text(json.dumps({"success": True, "phases": PHASES}))
    (tmp_path / "contacts.json").write_text(json.dumps([{"file": "run2.csv", "label": "touch", "start": 0.3}]))
    (tmp_path / "run2_labels.json").write_text(json.dumps([{"label": "late", "start": 0.9, "end": 1.0}]))
    imported = read_source(tmp_path)
    assert imported.recordings.outcome.tolist() == ["success", "unknown"]
    assert imported.recordings.annotations.labels == {"phases": ("free", "push"), "label": ("touch", "late")}
    np.testing.assert_allclose(imported.recordings.starts("label"), [[np.nan, np.nan], [0.3, 0.9]])
    assert imported.report.remarks[0].startswith("3 JSON documents describe recordings")


def test_a_folder_of_documents_alone(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"run{number}.json").write_text(json.dumps(lists(number)))
    for kind in ("auto", "json"):
        assert read_source(tmp_path, kind).recordings.trial.tolist() == ["run0", "run1", "run2"]


@pytest.mark.parametrize(
    ("units", "expected"),
    [({"force": "N", "torque": "Nm"}, ("N", "N", "N", "Nm", "Nm", "Nm")),
     ({"force": "N,N,kN", "torque": ""}, ("N", "N", "kN", "", "", ""))],
)  # fmt: skip
@pytest.mark.parametrize("within", [False, True])
def test_units_of_lists_of_rows_are_those_of_their_columns(
    units: dict[str, str], expected: tuple[str, ...], within: bool, tmp_path: Path
) -> None:
    values = np.random.default_rng(0).normal(size=(60, 6)).round(3)
    signals = {"force": values[:, :3].tolist(), "torque": values[:, 3:].tolist()}
    content = {"t": (np.arange(60) / 100).tolist(), **({"ft": signals} if within else signals), "units": units}
    (tmp_path / "run.json").write_text(json.dumps(content))
    recordings = read_source(tmp_path, "json").recordings
    assert recordings.units == expected
    assert not recordings.columns


def test_a_row_that_is_missing_and_units_of_each_element(tmp_path: Path) -> None:
    content = lists(0)
    content["wrench"][7] = None
    imported = read(tmp_path, {**content, "units": {"wrench": ["N", "N", "N", "Nm", "Nm", "Nm"]}})
    assert imported.recordings.units == UNITS
    assert imported.recordings.note.tolist() == ["missing:1"]
    np.testing.assert_allclose(np.delete(imported.recordings.wrench[0], 7, 0), np.delete(WRENCH[0], 7, 0), rtol=1e-6)


@pytest.mark.parametrize("rows", [False, True])
def test_lists_of_true_and_false_are_words_as_in_rows(rows: bool, tmp_path: Path) -> None:
    columns = {"t": TIME.tolist(), "Fz": WRENCH[0, :, 2].tolist(), "in_contact": [k >= 60 for k in range(COUNT)]}
    content = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)] if rows else columns
    marks = read(tmp_path, content).recordings.annotations
    assert (marks.tracks, marks.names().tolist()) == (("in_contact",), ["false", "true"])


def test_facts_of_many_recordings_cost_little(tmp_path: Path) -> None:
    """Each was parsed as a unit for each recording: 2,000 beside as many recordings took half a minute."""
    path, spent = tmp_path / "runs.json", []
    for count in (1, 500):
        facts = {f"fact{number}": number for number in range(count)}
        path.write_text(json.dumps({**facts, **{f"trial_{number}": lists(0, 20) for number in range(200)}}))
        start = process_time()
        list(read_json_document.__wrapped__(path, path.name))
        spent.append(process_time() - start)
    assert spent[1] < 3 * spent[0]
