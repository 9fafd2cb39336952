"""Columns of several arms in one table, and what describes recordings beside them."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.arms import arms_of
from rcbht_jax.io.importing.find import Item
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping, write_mapping
from rcbht_jax.io.importing.sidecars import sidecars_of
from rcbht_jax.labels import AXES

N, DT = 400, 0.002
TIME = np.arange(N) * DT
LEFT, RIGHT = np.random.default_rng(5).normal(size=(2, N, 6))
WRENCHES = {
    (trial, arm): [",".join(map(str, row[3 * (arm == "left") :][:3])) for row in LEFT * trial]
    for trial in (1, 2)
    for arm in ("left", "right")
}
NAMES = {
    "left, right": [f"{side}_{axis}" for side in ("left", "right") for axis in ("fx", "fy", "fz", "tx", "ty", "tz")],
    "L, R last": [f"{axis}_{side}" for side in "LR" for axis in AXES],
    "L, R first": [f"{side}{axis} [{'N' if axis[0] == 'F' else 'Nm'}]" for side in "LR" for axis in AXES],
    "joined": [f"{side}{axis}" for side in ("left", "right") for axis in AXES],
    "camel": [f"wrench{side}.{what}.{axis}" for side in ("Left", "Right") for what in ("force", "torque")
              for axis in "xyz"],
    "elements": [f"robot{k}/ft_{n}" for k in (0, 1) for n in range(6)],
}  # fmt: skip


def csv(path: Path, names: list[str], values: np.ndarray) -> None:
    np.savetxt(path, np.column_stack([TIME, values]), header=",".join(["t", *names]), delimiter=",", comments="")


@pytest.mark.parametrize("names", NAMES.values(), ids=NAMES)
def test_columns_of_two_arms_are_two_recordings_of_a_trial(names: list[str], tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    csv(tmp_path / "runs/run1.csv", [*names, "lift"], np.hstack([LEFT, RIGHT, TIME[:, None]]))
    (tmp_path / "runs/run1_labels.csv").write_text("label,start,end\npush,0.1,0.2\n")
    imported = read_source(tmp_path / "runs")
    recordings = imported.recordings
    assert (recordings.axes, recordings.trial.tolist()) == (AXES, ["run1", "run1"])
    assert recordings.arm.tolist() == list(imported.mapping.arms)
    np.testing.assert_allclose(recordings.wrench, np.stack([LEFT, RIGHT]), atol=1e-5)
    assert recordings.starts("label").tolist() == [[pytest.approx(0.1)]] * 2
    assert not imported.report.warnings
    write_mapping(tmp_path / "map.toml", imported.mapping)
    again = read_source(tmp_path / "runs", mapping=read_mapping(tmp_path / "map.toml")).recordings
    np.testing.assert_array_equal(again.wrench, recordings.wrench)
    assert again.arm.tolist() == recordings.arm.tolist()


def test_a_raw_and_a_compensated_wrench_are_no_arms(tmp_path: Path) -> None:
    names = [f"{what}.{axis}" for what in ("raw", "compensated") for axis in AXES]
    assert arms_of(names) == ()
    csv(tmp_path / "run1.csv", names, np.hstack([LEFT, RIGHT]))
    recordings = read_source(tmp_path).recordings
    np.testing.assert_allclose(recordings.wrench, RIGHT[None], atol=1e-5)


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        ("{}_1", "{}_2", ("1", "2")),
        ("ft1/{}", "ft2/{}", ("ft1", "ft2")),
        ("master_{}", "slave_{}", ("master", "slave")),
        ("left_{}_l", "right_{}_r", ("left", "right")),
    ],
)
def test_a_map_with_the_words_that_a_remark_asks_for_reads_both_arms(
    one: str, other: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    csv(tmp_path / "run1.csv", [name.format(axis) for name in (one, other) for axis in AXES], np.hstack([LEFT, RIGHT]))
    remark = next(text for text in read_source(tmp_path).report.remarks if "wrenches were found" in text)
    assert remark.endswith("If each is of an arm, list the words that differ there instead: arms = [..., ...].")
    recordings = read_source(tmp_path, mapping=Mapping(arms=words)).recordings
    assert recordings.arm.tolist() == list(words)
    np.testing.assert_allclose(recordings.wrench, np.stack([LEFT, RIGHT]), atol=1e-5)


def test_arms_of_wrenches_that_differ_otherwise_are_left_alone() -> None:
    assert arms_of([f"left_raw_f{axis}" for axis in "xyz"] + [f"right_base_f{axis}" for axis in "xyz"]) == ()


def test_columns_of_hundreds_of_arms_are_no_arms() -> None:
    start = time.process_time()
    assert arms_of([f"arm{k}_f{axis}" for k in range(3000) for axis in "xyz"]) == ()
    assert arms_of([f"{side}_{k}_f{axis}" for k in range(1500) for side in ("left", "right") for axis in "xyz"])
    assert time.process_time() - start < 10


@pytest.mark.parametrize("arms", [("left", "Left"), ("",)])
def test_arms_of_one_name_are_refused(arms: tuple[str, ...], tmp_path: Path) -> None:
    csv(tmp_path / "run1.csv", ["left_fz"], LEFT[:, :1])
    with pytest.raises(ValueError, match="two arms have one name, or one has none"):
        read_source(tmp_path, mapping=Mapping(arms=arms))


@pytest.mark.parametrize("by_turns", [False, True])
@pytest.mark.parametrize("group", ["", "trial"])
def test_a_column_of_arms_beside_one_of_trials_separates_arms(tmp_path: Path, by_turns: bool, group: str) -> None:
    keys = [(trial, arm) for trial in (1, 2) for arm in ("left", "right")]
    blocks = [[f"{trial},{k * DT},{arm},{WRENCHES[trial, arm][k]}" for k in range(50)] for trial, arm in keys]
    if by_turns:
        blocks = [[row for pair in zip(*blocks[at : at + 2], strict=True) for row in pair] for at in (0, 2)]
    lines = [line for block in blocks for line in block]
    (tmp_path / "all.csv").write_text("\n".join(["trial,t,arm,Fx,Fy,Fz", *lines]))
    imported = read_source(tmp_path, mapping=Mapping(group=group))
    recordings = imported.recordings
    names = list(zip(recordings.trial.tolist(), recordings.arm.tolist(), strict=True))
    assert names == [(f"all-{trial}", arm) for trial, arm in keys]
    for row, (trial, arm) in enumerate(keys):
        assert recordings.wrench[row, 3, 0] == pytest.approx(float(WRENCHES[trial, arm][3].split(",")[0]), rel=1e-6)
    again = read_source(tmp_path, mapping=imported.mapping).recordings
    assert again.arm.tolist() == recordings.arm.tolist()
    assert imported.report.warnings == imported.report.skipped == []


def test_samples_of_two_sensors_by_turns_are_told(tmp_path: Path) -> None:
    rows = [f"{k * DT},{'/left/ft' if k % 2 else '/right/ft'},{LEFT[k, 0]},{k % 7},{k % 5}" for k in range(N)]
    (tmp_path / "log.csv").write_text("\n".join(["t,topic,fx,fy,fz", *rows]))
    text = "rows alternate between the values of topic; if it names sensors, separate them with --group topic."
    assert read_source(tmp_path).report.warnings == [("log.csv", text)]
    parted = read_source(tmp_path, mapping=Mapping(group="topic"))
    assert (len(parted.recordings), parted.report.warnings) == (2, [])


def described(folder: Path, **files: object) -> None:
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))


def test_objects_beside_recordings_describe_them(tmp_path: Path) -> None:
    for number in range(3):
        folder = tmp_path / f"trial_{number}"
        folder.mkdir()
        csv(folder / "ft.csv", list(AXES), LEFT + number)
        described(folder, meta={"success": number != 1, "part": {"name": "A"}, "gains": [1, 2], "speed": 0.1 * number})
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert recordings.outcome.tolist() == ["success", "failure", "success"]
    assert recordings.columns["part.name"].tolist() == ["A"] * 3
    assert recordings.columns["speed"].tolist() == pytest.approx([0, 0.1, 0.2])
    assert len(set(recordings.session.tolist())) == 1  # folders of one recording each are no sessions
    assert imported.report.remarks[0].startswith("3 JSON documents describe recordings: 'trial_0/meta.json'")
    described(tmp_path / "trial_1", meta={"success": True})
    assert read_source(tmp_path).report.content_sha256 != imported.report.content_sha256


def test_names_in_objects_are_no_names_of_trials(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / f"run_{number}").mkdir()
        csv(tmp_path / f"run_{number}/ft.csv", list(AXES), LEFT + number)
        described(tmp_path / f"run_{number}", meta={"trial": 1, "note": "x", "session": 7})
    recordings = read_source(tmp_path).recordings
    assert recordings.trial.tolist() == ["run_0/ft", "run_1/ft"]
    assert (recordings.note.tolist(), recordings.session.tolist()) == (["", ""], ["7", "7"])


def test_an_object_describes_only_what_it_is_named_after(tmp_path: Path) -> None:
    for name in ("run1", "run10"):
        csv(tmp_path / f"{name}.csv", list(AXES), LEFT + len(name))
    described(tmp_path, run1_meta={"operator": "ann"}, setup={"operator": "bob"}, run10=[1, 2])
    imported = read_source(tmp_path)
    assert imported.recordings.columns["operator"].tolist() == ["ann", ""]
    assert imported.report.remarks[0] == "2 other files were not read: run10.json, setup.json."


def test_the_longest_name_of_a_recording_in_that_of_an_object_is_meant(tmp_path: Path) -> None:
    for name in ("run", "run_2", "run_2-retry"):
        csv(tmp_path / f"{name}.csv", list(AXES), LEFT + len(name))
    facts = {"run": "ann", "run_2": "bob", "run_2-retry_meta": "eve"}
    described(tmp_path, **{name: {"operator": operator} for name, operator in facts.items()})
    recordings = read_source(tmp_path).recordings
    operators = zip(recordings.trial.tolist(), recordings.columns["operator"].tolist(), strict=True)
    assert dict(operators) == {"run": "ann", "run_2": "bob", "run_2-retry": "eve"}
    (tmp_path / "run_2.json").unlink()
    assert read_source(tmp_path).recordings.columns["operator"].tolist().count("ann") == 1


def test_objects_beside_thousands_of_recordings_are_found_soon(tmp_path: Path) -> None:
    names = [f"run{number}" for number in range(2000)]
    described(tmp_path, **{name: {"part": "A"} for name in names})
    items = [Item(f"{name}.csv", tmp_path / f"{name}.csv", "csv") for name in names]
    start = time.process_time()
    found = sidecars_of(tmp_path, items, [f"{name}.json" for name in names])
    assert time.process_time() - start < 2
    assert len(found.facts) == 2000


def test_a_hostile_object_is_no_description(tmp_path: Path) -> None:
    csv(tmp_path / "run1.csv", list(AXES), LEFT)
    (tmp_path / "run1.json").write_text("[" * 100_000)
    (tmp_path / "run1_many.json").write_text(json.dumps({f"k{n}": n for n in range(1000)}))
    (tmp_path / "run1_link.json").symlink_to("/etc/hostname")
    imported = read_source(tmp_path)
    assert not imported.recordings.columns
    assert imported.report.remarks[0].startswith("3 other files were not read")


@pytest.mark.parametrize(
    ("names", "tracks"),
    [(["L_phase", "R_phase"], {"phase"}), (["phase_left", "phase_right"], {"phase"}),
     (["left/gripper/state", "right/gripper/state"], {"gripper_state"}),
     (["left_phase", "right_phase", "phase"], {"arm__phase", "phase"})],
)  # fmt: skip
def test_a_track_of_each_arm_has_a_name_without_the_arm(names: list[str], tracks: set[str], tmp_path: Path) -> None:
    sides = ("L", "R") if names[0].startswith("L_") else ("left", "right")
    heads = ["t", *(f"{side}_F{axis}" for side in sides for axis in "xyz"), *names]
    values = np.random.default_rng(0).normal(size=(60, 6)).round(3).tolist()
    words = [["free" if k < 20 + 10 * place else "push" for place in range(len(names))] for k in range(60)]
    rows = [[k / 100, *row, *own] for k, (row, own) in enumerate(zip(values, words, strict=True))]
    (tmp_path / "run.csv").write_text("\n".join(",".join(map(str, row)) for row in [heads, *rows]))
    recordings = read_source(tmp_path).recordings
    assert set(recordings.annotations.tracks) == tracks
    marks = recordings.annotations.of(min(tracks))
    assert marks.start.round(3).tolist() == [0.0, 0.2, 0.0, 0.3]


def test_what_describes_each_arm_has_a_name_without_the_arm(tmp_path: Path) -> None:
    heads = ["t", *(f"{side}_F{axis}" for side in ("left", "right") for axis in "xyz"), "left_tool", "right_tool"]
    for number in range(2):
        values = np.random.default_rng(number).normal(size=(60, 6)).round(3).tolist()
        rows = [[k / 100, *row, number + 1, number + 3] for k, row in enumerate(values)]
        (tmp_path / f"{number}.csv").write_text("\n".join(",".join(map(str, row)) for row in [heads, *rows]))
    imported = read_source(tmp_path)
    assert imported.recordings.columns["tool"].tolist() == ["1", "3", "2", "4"]
    assert imported.mapping.columns["tool"].column == "{arm}_tool"
