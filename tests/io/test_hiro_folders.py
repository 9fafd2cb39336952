"""The importer on made-up folders: broken trials, copies, contradictions, odd layouts, state-time rules."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.hiro import importer
from rcbht_jax.io.hiro.names import parse_trial
from rcbht_jax.io.hiro.onsets import fallback, harmonised, needs_harmonising, onsets_from_marks
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED
from rcbht_jax.types import Recordings
from tests.support.snaps import deviation

TIME = np.arange(400) * 0.005


def write_table(path: Path, seed: int, dt: float = 0.005) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.random.default_rng(seed).normal(size=(400, 6))
    np.savetxt(path, np.column_stack([np.arange(400) * dt, values]), fmt="%.6g", delimiter="\t")


def trial(folder: Path, seed: int, marks: str | None = "0\n0.5\n1.0\n1.5\n", arm: str = "R") -> Path:
    write_table(folder / f"{arm}_Torques.dat", seed)
    if marks is not None:
        (folder / f"{arm}_State.dat").write_text(marks)
    return folder


def notes(recordings: Recordings) -> dict[str, str]:
    return dict(zip(recordings.trial.tolist(), recordings.note.tolist(), strict=True))


def test_a_broken_trial_does_not_stop_the_others(tmp_path: Path) -> None:
    trial(tmp_path / "good", 1)
    (trial(tmp_path / "cut", 2) / "R_Torques.dat").write_text("0 1 2 3 4 5 6\n0.005 1 2")
    (trial(tmp_path / "empty", 3) / "R_Torques.dat").write_text("")
    (tmp_path / "nothing").mkdir()
    (trial(tmp_path / "states", 4) / "R_State.dat").write_text("0\n2\n1\n")
    (trial(tmp_path / "six", 5) / "R_State.dat").write_text("0\n.1\n.2\n.3\n.4\n.5\n")
    (trial(tmp_path / "angles", 6) / "R_Angles.dat").write_text("garbage")
    recordings, report = importer.read_hiro(tmp_path)
    assert recordings.trial.tolist() == ["angles", "good", "six", "states"]
    assert [path for path, _ in report.skipped] == ["cut/R_Torques.dat", "empty/R_Torques.dat", "nothing"]
    assert "line 2: 3 columns" in report.skipped[0][1]
    assert str(tmp_path) not in str(report.to_dict())
    assert {path for path, _ in report.warnings} == {
        "angles/R_Angles.dat",
        "six/R_State.dat",
        "states/R_State.dat",
    }
    assert notes(recordings) == {
        "angles": "",
        "good": "",
        "six": "state-file-unusable",
        "states": "state-file-unusable",
    }
    assert np.isnan(recordings.starts(RECORDED)[2:]).all()
    np.testing.assert_array_equal(recordings.starts(RECORDED)[1], [0, 0.5, 1, 1.5])


def test_pipes_devices_and_huge_files_are_not_read(tmp_path: Path) -> None:
    """Reading a pipe that nobody writes to, or /dev/zero, never ends."""
    trial(tmp_path / "set" / "good", 1)
    odd = trial(tmp_path / "set" / "odd", 2, marks=None)
    os.mkfifo(odd / "notes.dat")
    os.mkfifo(odd / "R_State.dat")
    (odd / "zero.dat").symlink_to("/dev/zero")
    digest = importer.read_hiro(tmp_path)[1].content_sha256
    with (odd / "film.dat").open("wb") as film:
        film.truncate(6 << 30)  # sparse
    pipe = tmp_path / "set" / "pipe"
    pipe.mkdir()
    os.mkfifo(pipe / "R_Torques.dat")
    recordings, report = importer.read_hiro(tmp_path)
    assert recordings.trial.tolist() == ["good", "odd"]
    assert [path for path, _ in report.skipped] == ["set/pipe"]
    assert report.content_sha256 == digest


def test_links_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    """Of what they lead to no line appears in a message; links inside the folder, and to the folder, are followed."""
    secret = tmp_path / "secret"
    write_table(secret / "set" / "there" / "R_Torques.dat", 9)
    (secret / "shadow").write_text("root:hash")
    data = tmp_path / "data" / "set"
    trial(data / "good", 1)
    for name in ("R_State.dat", "R_Angles.dat", "R_CartPos.dat"):
        (trial(data / name, 2 + len(name), "0\n0.5\n0.505\n1.5\n") / name).unlink(missing_ok=True)
        (data / name / name).symlink_to(secret / "shadow")
    (data / "table").mkdir()
    (data / "table" / "R_Torques.dat").symlink_to(secret / "shadow")
    (data / "folder").symlink_to(secret / "set" / "there")
    (tmp_path / "data" / "other").symlink_to(secret / "set")
    (data / "inside").mkdir()
    write_table(data / "z_hidden" / "table", 5)
    (data / "inside" / "R_Torques.dat").symlink_to(data / "z_hidden" / "table")
    digest = importer.read_hiro(tmp_path / "data")[1].content_sha256
    (secret / "shadow").write_text("root:other")
    (tmp_path / "link").symlink_to(tmp_path / "data")
    recordings, report = importer.read_hiro(tmp_path / "link")
    assert recordings.trial.tolist() == ["R_Angles.dat", "R_CartPos.dat", "R_State.dat", "good", "inside"]
    told = [path for path, text in report.skipped + report.warnings if "is a link out of" in text]
    assert sorted(told) == [
        "other", "set/R_Angles.dat/R_Angles.dat", "set/R_CartPos.dat/R_CartPos.dat", "set/R_State.dat/R_State.dat",
        "set/folder", "set/table/R_Torques.dat",
    ]  # fmt: skip
    assert "root:" not in str(report.to_dict())
    assert str(tmp_path) not in str(report.to_dict())
    assert report.content_sha256 == digest


def test_exact_copies_are_imported_once(tmp_path: Path) -> None:
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "a", 1)
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "a", 2, None, "L")
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "b", 1)
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "b", 2, None, "L")
    # Same right arm, other left arm: another trial.
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "c", 1)
    trial(tmp_path / "SIM_HIRO_TWO_SA_SUCCESS" / "c", 3, None, "L")
    recordings, report = importer.read_hiro(tmp_path)
    assert list(zip(recordings.trial, recordings.arm, strict=True)) == [
        ("a", "R"),
        ("a", "L"),
        ("c", "R"),
        ("c", "L"),
    ]
    assert [path for path, _ in report.duplicates] == ["SIM_HIRO_TWO_SA_SUCCESS/b"]
    assert "SIM_HIRO_TWO_SA_SUCCESS/a" in report.duplicates[0][1]


def test_contradictory_copies_are_kept_and_flagged(tmp_path: Path) -> None:
    folder = tmp_path / "SIM_HIRO_ONE_SA_ERROR_CHARAC"
    trial(folder / "XX+y0.0094+r0.1901", 1)
    trial(folder / "XX-y0.0094+r0.1901", 1)
    trial(folder / "XX+x0.0085", 2)
    recordings, report = importer.read_hiro(folder)
    assert report.duplicates == []
    assert notes(recordings) == {
        "XX+x0.0085": "",
        "XX+y0.0094+r0.1901": "contradictory-duplicate:XX-y0.0094+r0.1901",
        "XX-y0.0094+r0.1901": "contradictory-duplicate:XX+y0.0094+r0.1901",
    }
    assert recordings.column("failure_type").tolist() == ["+x", "", ""]
    assert np.isnan(deviation(recordings)[1:]).all()
    assert len(report.warnings) == 2


def test_success_and_failure_copies_contradict_each_other(tmp_path: Path) -> None:
    trial(tmp_path / "SIM_HIRO_ONE_SA_SUCCESS" / "s", 1)
    trial(tmp_path / "REAL_HIRO_ONE_SA_ERROR_CHARAC" / "f", 1)
    recordings, _ = importer.read_hiro(tmp_path)
    assert notes(recordings) == {"f": "contradictory-duplicate:s", "s": "contradictory-duplicate:f"}


def test_other_time_steps_are_left_out(tmp_path: Path) -> None:
    for seed in range(3):
        trial(tmp_path / f"t{seed}", seed)
    write_table(tmp_path / "fast" / "R_Torques.dat", 9, dt=0.001)
    recordings, report = importer.read_hiro(tmp_path)
    assert recordings.dt == 0.005
    assert [path for path, _ in report.skipped] == ["fast/R"]
    assert "0.001 s" in report.skipped[0][1]


def test_layouts(tmp_path: Path) -> None:
    write_table(tmp_path / "set" / "only-left" / "L_Torques.dat", 1)
    folder = trial(tmp_path / "set" / "plain-state", 2, None)
    (folder / "State.dat").write_text("0.0\n0.5")
    recordings, _ = importer.read_hiro(tmp_path)
    assert recordings.arm.tolist() == ["L", "R"]
    assert notes(recordings) == {"only-left": "state-file-missing", "plain-state": ""}
    np.testing.assert_array_equal(recordings.starts(RECORDED)[1], [0, 0.5, np.nan, np.nan])
    assert recordings.outcome.tolist() == ["unknown", "unknown"]
    assert recordings.session.tolist() == ["set", "set"]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda p: p / "missing", "is not a folder"),
        (lambda p: trial(p / "t", 1), "is a single trial"),
        (lambda p: p, "holds no trial"),
        (lambda p: _broken(p), "no usable trial.*line 1"),
        (lambda p: _linked(p), "holds no trial.*; elsewhere is a link out of the folder"),
    ],
)
def test_nothing_to_import(tmp_path: Path, make: object, sentence: str) -> None:
    assert callable(make)
    with pytest.raises(InputError, match=sentence):
        importer.read_hiro(make(tmp_path))


def _broken(folder: Path) -> Path:
    (trial(folder / "t", 1) / "R_Torques.dat").write_text("x")
    return folder


def _linked(folder: Path) -> Path:
    trial(folder / "set" / "t", 1)
    (folder / "links").mkdir()
    (folder / "links" / "elsewhere").symlink_to(folder / "set")
    return folder / "links"


@pytest.mark.parametrize(
    ("name", "kind", "deviation"),
    [
        ("XX", "", (0, 0, 0)),
        ("XX+x0.0075-y0.0078+r0.0342", "+x-y+r", (0.0075, -0.0078, 0.0342)),
        ("XX-r0.5235", "-r", (0, 0, -0.5235)),
        ("XX+r.1+x1e3", "", None),
        ("XX+x0.01+x0.02", "", None),
        ("backup", "", None),
    ],
)
def test_names_of_simulated_failures(name: str, kind: str, deviation: tuple[float, ...] | None) -> None:
    parsed = parse_trial("SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob", name)
    assert (parsed.failure_type, parsed.deviation) == (kind, deviation)
    assert ("deviation-unreadable" in parsed.notes) == (deviation is None)


def test_unknown_numbers_get_no_session() -> None:
    assert parse_trial("REAL_HIRO_ONE_SA_SUCCESS", "20121127-HIROSA-S-47").notes == ("session-unknown",)
    assert parse_trial("MY_ERROR_SET", "t").outcome == "failure"
    assert parse_trial("SIM_HIRO_ONE_SA_ERROR_CHARAC", "XX+x0.100").notes == ("deviation-suspect",)


@pytest.mark.parametrize(
    ("marks", "expected", "note"),
    [
        ([], [np.nan] * 4, "state-times-empty"),
        ([0.0], [0, np.nan, np.nan, np.nan], ""),
        ([0.0, 0.5, 1.0, 1.5, 1.8], [0, 0.5, 1.0, 1.5], ""),
        ([0.0, 52.61], [0, np.nan, np.nan, np.nan], "onset-beyond-end:S1=52.61"),
        ([0.0, 1.995], [0, 1.995, np.nan, np.nan], "onset-at-end:S1"),
        ([0.0, 2.0], [0, np.nan, np.nan, np.nan], "onset-beyond-end:S1=2"),
        ([-1.0, 0.5], [np.nan, 0.5, np.nan, np.nan], "onset-before-start:S0=-1"),
    ],
)
def test_marks_become_onsets(marks: list[float], expected: list[float], note: str) -> None:
    onset, got = onsets_from_marks(np.array(marks), TIME, 0.005)
    np.testing.assert_array_equal(onset, expected)
    assert got == ([note] if note else [])


def test_onsets_count_from_the_first_sample() -> None:
    onset, _ = onsets_from_marks(np.array([3.0, 3.5]), TIME + 3.0, 0.005)
    np.testing.assert_array_equal(onset, [0, 0.5, np.nan, np.nan])


def test_harmonised_boundary_rules() -> None:
    onset = np.array([0.0, 0.5, 0.505, 1.5])
    assert needs_harmonising(onset, 0.005)
    assert not needs_harmonising(np.array([0.0, 0.5, 0.6, 1.5]), 0.005)
    assert not needs_harmonising(np.array([0.0, 0.5, np.nan, np.nan]), 0.005)
    # Upright before contact does not count; the first time after it does.
    tilt = np.where(TIME < 0.2, 0.0, np.where(TIME < 1.2, 16.0, 1.9))
    moved, note = harmonised(onset, TIME, tilt)
    assert (moved[2], note) == (pytest.approx(1.2), "harmonised")
    # Upright only after mating has begun, or never: 0.9 of the way.
    for late in (np.where(TIME < 1.6, 16.0, 1.0), np.full(400, 1.96)):
        moved, note = harmonised(onset, TIME, late)
        assert (moved[2], note) == (pytest.approx(1.4), "harmonised-fallback")
    assert np.isnan(fallback(np.array([0.0, 0.5, 0.505, np.nan]))[0][2])


def test_without_angles_the_boundary_comes_from_the_pose_or_the_share(tmp_path: Path) -> None:
    marks = "0\n0.5\n0.505\n1.5\n"
    pitch = np.where(TIME < 1.2, -1.3, -np.pi / 2)
    pose = np.column_stack([TIME, np.zeros((400, 4)), pitch, np.zeros(400)])
    np.savetxt(trial(tmp_path / "pose", 1, marks) / "R_CartPos.dat", pose)
    trial(tmp_path / "share", 2, marks)
    recordings, _ = importer.read_hiro(tmp_path)
    assert notes(recordings) == {
        "pose": "angles-missing;harmonised-from-pose",
        "share": "angles-missing;harmonised-fallback",
    }
    np.testing.assert_allclose(recordings.starts(HARMONISED)[:, 2], [1.2, 1.4])
    np.testing.assert_allclose(recordings.starts(RECORDED)[:, 2], 0.505)


def test_names_that_are_not_utf8_are_spelled_out(tmp_path: Path) -> None:
    source = tmp_path / "set\udcff_SUCCESS"
    trial(source / "a", 1)
    trial(source / "b\udcff", 2)
    trial(source / "b\udcfe", 3)
    trial(tmp_path / "set_ERROR" / "copy\udcff", 1)
    (trial(source / "cut\udcff", 4) / "R_Torques.dat").write_text("0 1 2\n")
    out = tmp_path / "out.zarr"
    report = importer.import_hiro(tmp_path, out)
    recordings = store.read_recordings(out)
    assert recordings.trial.tolist() == ["copy\\xff", "a", "b\\xfe", "b\\xff"]
    assert recordings.source.tolist()[1] == "set\\xff_SUCCESS"
    assert notes(recordings)["a"].endswith("contradictory-duplicate:copy\\xff")
    assert [path for path, _ in report.skipped] == ["set\\xff_SUCCESS/cut\\xff/R_Torques.dat"]
    assert importer.import_hiro(source, tmp_path / "one.zarr").imported == ["a/R", "b\\xfe/R", "b\\xff/R"]
