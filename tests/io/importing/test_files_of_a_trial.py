"""A trial of several files: which of them are recordings, and the starts of its phases in one of the others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import marks as marks_module
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, Track, read_mapping, to_toml
from rcbht_jax.io.importing.marks import Names, ambiguous, track_intervals
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.text import read_csv
from rcbht_jax.io.store import read_recordings

STATES = ("home", "approach", "contact", "search", "insert")
STARTS = {"t1": "0\n0.5\n1.0\n1.5\n1.75\n", "t2": "0 0.5 1", "t3": "0\n0.5\n1\n1.5\n1.75\n1.9\n"}
MAP = f"""time = "c0"
files = ["R_Torques.dat"]

[[channels]]
column = "c3"
name = "Fz"
unit = "N"

[[annotations]]
track = "state"
starts = "{{folder}}/R_State.dat"
labels = [{", ".join(f'"{name}"' for name in STATES)}]
"""


def trials(root: Path) -> Path:
    """Trials in the authors' layout: a wrench and more in 17 columns, joint angles, and the starts of the states."""
    rng, time = np.random.default_rng(0), np.arange(2001)[:, None] / 1000
    for name, starts in STARTS.items():
        folder = root / "PA10" / name
        folder.mkdir(parents=True)
        np.savetxt(folder / "R_Torques.dat", np.hstack([time, rng.normal(size=(2001, 16))]), "%.4f")
        np.savetxt(folder / "R_Angles.dat", np.hstack([time, rng.normal(size=(2001, 7))]), "%.4f")
        (folder / "R_State.dat").write_text(starts)
    return root


def test_a_folder_in_the_authors_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_file, store = trials(tmp_path / "in"), tmp_path / "pa10.toml", tmp_path / "pa10.zarr"
    map_file.write_text(MAP)
    assert main(["import", "csv", str(source), str(store), "--map", str(map_file)]) == 0
    assert "3 other files were not read: PA10/t1/R_Angles.dat" in capsys.readouterr().out  # the states were
    recordings = read_recordings(store)
    assert (recordings.axes, recordings.dt, recordings.session.tolist()) == (("Fz",), 0.001, ["PA10"] * 3)
    marks = recordings.annotations
    assert marks.labels == {"state": STATES}
    assert [marks.code[marks.recording == row].tolist() for row in range(3)] == [[*range(5)], [*range(3)], [*range(5)]]
    ends = [marks.end[marks.recording == row][-1] for row in range(3)]
    np.testing.assert_allclose(ends, [2.001, 2.001, 1.9])  # the recording's, or as stated


def test_only_words_that_mean_several_recordings_are_told_and_used_for_none(tmp_path: Path) -> None:
    (tmp_path / "marks.csv").write_text("recording,label,start,end\na,push,0,1\nrun,pull,0,2\nnone,hold,0,3\n")
    names = Names([("a.csv", ""), ("mon/run.csv", ""), ("tue/run.csv", "")])
    warnings: list[tuple[str, str]] = []
    found = [
        track_intervals(tmp_path, Path(file), Track("phase", file="marks.csv"), names, place, warnings, {})
        for place, file in enumerate(("a.csv", "mon/run.csv", "tue/run.csv"))
    ]
    assert found == [[("phase", "push", 0.0, 1.0)], [], []]
    assert warnings == [("marks.csv", ambiguous("run"))]


def test_a_pattern_chooses_files(tmp_path: Path) -> None:
    source = trials(tmp_path)
    for pattern in ("*_Torques.dat", "PA10/*/R_Torques.dat"):
        recordings = read_source(source, "csv", Mapping(files=(pattern,))).recordings
        assert recordings.wrench.shape == (3, 2001, 16)
    assert read_source(source, "csv", Mapping(files=("t2/*_Torques.dat",))).recordings.wrench.shape[0] == 1
    with pytest.raises(InputError, match=r"holds no file like \*\.txt or x; it holds PA10/t1/R_Angles\.dat"):
        read_source(source, "csv", Mapping(files=("*.txt", "x")))


@pytest.mark.parametrize(
    ("starts", "reason"),
    [
        ("0 1 2 3 4 5 6", "has 7 starts for 5 labels"),
        ("", "R_State.dat is empty"),
        ("0 soon", "a word that is not a number"),
    ],
)
def test_wrong_starts_leave_the_recording(tmp_path: Path, starts: str, reason: str) -> None:
    source = trials(tmp_path)
    (source / "PA10" / "t2" / "R_State.dat").write_text(starts)
    track = Track("state", starts="{folder}/R_State.dat", labels=STATES)
    imported = read_source(source, "csv", Mapping(time="c0", files=("R_Torques.dat",), annotations=(track,)))
    [(name, warning)] = imported.report.warnings
    assert name == "PA10/t2/R_Torques.dat"
    assert reason in warning
    assert len(imported.recordings) == 3
    assert set(imported.recordings.annotations.recording.tolist()) == {0, 2}


def test_a_mapping_of_starts_comes_back_equal(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(MAP)
    mapping = read_mapping(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text(to_toml(mapping))
    assert read_mapping(tmp_path / "b.toml") == mapping
    (tmp_path / "a.toml").write_text(MAP.replace("labels", "# labels"))
    with pytest.raises(InputError, match="needs a column, a file, ends and ids, or starts and labels; one of them"):
        read_mapping(tmp_path / "a.toml")


def test_a_file_of_annotations_of_all_recordings_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was read again for each, which takes quadratic time."""
    for number in range(5):
        rows = [f"{k / 100},{k % 7 + number},{k % 11}" for k in range(40)]
        (tmp_path / f"run{number}.csv").write_text("\n".join(["t,Fz,Mz", *rows]))
    lines = [f"run{number},push,{number / 100}\n" for number in range(5)]
    (tmp_path / "marks.csv").write_text("recording,label,start\n" + "".join(lines))
    paths: list[Path] = []

    def counted(path: Path, name: str) -> Iterator[Table]:
        paths.append(path)
        return read_csv(path, name)

    monkeypatch.setattr(marks_module, "read_csv", counted)
    tracks = (Track("phase", file="marks.csv"), Track("other", file="marks.csv", words={"push": "pull"}))
    found = read_source(tmp_path, mapping=Mapping(annotations=tracks)).recordings
    assert paths == [tmp_path / "marks.csv"] * 2
    assert found.starts("phase")[:, 0].tolist() == [number / 100 for number in range(5)]
    assert found.annotations.labels == {"phase": ("push",), "other": ("pull",)}


@pytest.mark.parametrize("pattern", ["{stem}_contacts.csv", "{folder}/contacts.csv"])
def test_a_file_of_annotations_that_a_pattern_names_is_read_once_and_without_warning(
    pattern: str, tmp_path: Path
) -> None:
    for number, trial in enumerate(("t1", "t2")):
        folder = tmp_path / trial
        folder.mkdir()
        rows = [f"{k / 100},{(k + number) % 7}" for k in range(100)]
        (folder / "run.csv").write_text("\n".join(["t,Fz", *rows]))
        (folder / pattern.rpartition("/")[2].replace("{stem}", "run")).write_text("label,start,end\nhit,0.1,0.2\n")
    imported = read_source(tmp_path, mapping=Mapping(annotations=(Track("contact", file=pattern),)))
    assert imported.recordings.annotations.names().tolist() == ["hit", "hit"]
    assert imported.report.warnings == imported.report.skipped == []
