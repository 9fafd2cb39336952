"""A mapping that an import wrote makes the same store when it is used as it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.mapping import Mapping, Track, Value, read_mapping, write_mapping


def again(source: Path, imported: Imported) -> Imported:
    """The import of the source with the mapping that an import found, as a file."""
    path = source.parent / "written.toml"
    write_mapping(path, imported.mapping)
    return read_source(source, mapping=read_mapping(path))


def contents(imported: Imported) -> tuple[object, ...]:
    """What two equal imports share."""
    found = imported.recordings
    marks = found.annotations
    names = [marks.tracks[place] for place in marks.track]
    labels = [marks.labels[name][code] for name, code in zip(names, marks.code, strict=True)]
    spans = list(zip(marks.recording.tolist(), names, labels, marks.start.tolist(), marks.end.tolist(), strict=True))
    return found.dt, found.axes, found.length.tolist(), sorted(spans), found.outcome.tolist(), sorted(found.columns)


def log(path: Path, seed: int, **columns: list[object]) -> None:
    """A CSV t,Fx,Fy,Fz of 40 samples at 100 Hz and further columns."""
    values = np.random.default_rng(seed).normal(size=(40, 3)).round(3).tolist()
    rows = [[k / 100, *row, *(column[k] for column in columns.values())] for k, row in enumerate(values)]
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(",".join(map(str, row)) for row in [["t", "Fx", "Fy", "Fz", *columns], *rows]))


@pytest.mark.parametrize("older", [False, True])
def test_a_first_recording_that_failed_early_leaves_the_others_their_phases(older: bool, tmp_path: Path) -> None:
    source = tmp_path / "runs"
    failed: dict[str, list[object]] = {"phase": ["free"] * 40, "success": [False] * 40}
    log(source / "run0.csv", 0, **({} if older else failed))
    for seed in (1, 2):
        phases = ["free"] * 20 + ["push"] * 20
        log(source / f"run{seed}.csv", seed, phase=phases, success=[False] * 35 + [True] * 5)
    first = read_source(source)
    assert first.recordings.outcome.tolist() == ["unknown" if older else "failure", "success", "success"]
    assert first.recordings.annotations.tracks == ("phase",)
    roles = {row["column"]: row["role"] for row in first.report.understood}
    assert roles["phase"] == "annotations phase"
    assert roles["success"].startswith("column ")
    assert first.mapping.columns["outcome"].last
    assert contents(again(source, first)) == contents(first)


def test_json_lines_whose_first_recording_has_no_sub_tasks_keep_those_of_the_others(tmp_path: Path) -> None:
    rows: list[object] = []
    for recording in range(3):
        rows.append({"reset": True})
        for k in range(20):
            rows += [{"begin": True}] if recording and k == 10 else []
            rows.append({"t": k / 100, "Fx": k % 3, "Fy": k % 5 + recording, "Fz": k % 7})
    source = tmp_path / "runs"
    source.mkdir()
    (source / "log.jsonl").write_text("\n".join(map(json.dumps, rows)))
    first = read_source(source)
    assert first.recordings.annotations.tracks == ("phase",)
    assert contents(again(source, first)) == contents(first)


def test_a_column_that_one_file_alone_has_describes_its_recording_again(tmp_path: Path) -> None:
    source = tmp_path / "runs"
    log(source / "a.csv", 0)
    log(source / "b.csv", 1, part=["peg"] * 40)
    first = read_source(source)
    assert first.recordings.columns["part"].tolist() == ["", "peg"]
    second = again(source, first)
    assert second.recordings.columns["part"].tolist() == ["", "peg"]
    assert [name for name, _ in second.report.warnings] == ["a.csv"]


@pytest.mark.parametrize(
    ("name", "stated", "dt"),
    [("t_ms", "", 0.01), ("t [ms]", "", 0.01), ("t", "", 10.0), ("t_ms", "us", 1e-5), ("t_ms", "s", 10.0)],
)
def test_a_named_time_has_the_unit_that_its_column_states(name: str, stated: str, dt: float, tmp_path: Path) -> None:
    rows = [f"{10 * k},{k % 3},{k % 5},{k % 7}" for k in range(40)]
    source = tmp_path / "run.csv"
    source.write_text("\n".join([f"{name},Fx,Fy,Fz", *rows]))
    imported = read_source(source, mapping=Mapping(time=name, time_unit=stated))
    assert imported.recordings.dt == pytest.approx(dt)
    second = again(source, imported)
    assert second.mapping.time_unit == imported.mapping.time_unit != ""
    assert contents(second) == contents(imported)


def test_a_file_of_other_axes_leaves_the_map_of_the_others_usable(tmp_path: Path) -> None:
    """Its columns were in the map, which was refused: no recording has "state"."""
    source = tmp_path / "runs"
    log(source / "a.csv", 0)
    log(source / "b.csv", 1, state=["free"] * 20 + ["push"] * 20)
    text = (source / "b.csv").read_text().replace("t,Fx,Fy,Fz", "time,Force X,Force Y,Force Z")
    (source / "b.csv").write_text(text)
    second = again(source, read_source(source))
    assert (second.report.imported, [name for name, _ in second.report.skipped]) == (["a.csv"], ["b.csv"])


def test_a_first_file_of_one_trial_leaves_the_others_apart(tmp_path: Path) -> None:
    """The map had no group: trials of later files were one recording."""
    source = tmp_path / "runs"
    log(source / "a.csv", 0, trial=[1] * 40)
    log(source / "b.csv", 1, trial=[2] * 20 + [3] * 20)
    first = read_source(source)
    assert first.mapping.group == "trial"
    assert first.recordings.length.tolist() == [40, 20, 20]
    second = again(source, first)
    assert contents(second) == contents(first)
    assert second.recordings.trial.tolist() == ["1", "2", "3"]


def test_what_a_map_names_and_no_file_has_is_reported(tmp_path: Path) -> None:
    source = tmp_path / "runs"
    for seed, result in enumerate(("gut", "schlecht")):
        phase, state = [0] * 20 + [1] * 20, ["Go"] * 20 + ["no"] * 20
        log(source / f"{seed}.csv", seed, phase=phase, result=[result] * 40, state=state)
    track = Track("phase", "phase", words={"0": "free", "1.0": "push", "7": "hold"}, ignore=("idle",))
    exact = Track("state", "state", words={"go": "on", "no": "off"})  # as it is written, unlike an outcome
    outcome = Value("result", words={"Gut": "success", "schlecht": "failure", "NOK": "failure", "ok": "success"})
    imported = read_source(
        source, mapping=Mapping(annotations=(track, exact), columns={"outcome": outcome}, arms=("left", "right"))
    )
    assert [remark for remark in imported.report.remarks if " map" in remark] == [
        "These words of the map are no values of column 'phase': '7', 'idle'.",
        "These words of the map are no values of column 'state': 'go'.",
        "These words of the map are no values of column 'result': 'Gut', 'NOK'.",
        "No column names these arms of the map: 'left', 'right'.",
    ]
    assert imported.recordings.outcome.tolist() == ["gut", "failure"]
