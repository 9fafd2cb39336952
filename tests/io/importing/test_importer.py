"""From files to a data set: nothing is dropped silently, nothing is guessed from a folder's name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import import_source, read_source
from rcbht_jax.io.importing.mapping import Channel, Mapping, Track, Value
from rcbht_jax.io.store import read_attrs, read_recordings
from rcbht_jax.types import Recordings

DT = 0.002


def write(path: Path, values: np.ndarray, dt: float = DT, **columns: object) -> None:
    """A CSV t,Fz and further columns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(["t", "Fz", *columns])]
    for row, value in enumerate(values.tolist()):
        more = [str(column[row] if isinstance(column, list) else column) for column in columns.values()]
        lines.append(",".join([repr(row * dt), repr(value), *more]))
    path.write_text("\n".join(lines) + "\n")


def noise(seed: int, count: int = 200) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=count)


def test_copies_and_beginnings_are_reported(tmp_path: Path) -> None:
    whole = noise(0)
    for name, values in {"a": whole, "b": whole[:120], "c": whole, "d": noise(1), "e": whole[:50]}.items():
        write(tmp_path / f"{name}.csv", values)
    imported = read_source(tmp_path)
    assert imported.report.imported == ["a.csv", "b.csv", "d.csv", "e.csv"]
    assert sorted(imported.report.duplicates) == [
        ("b.csv", "beginning of a.csv; imported, and noted."),
        ("c.csv", "exact copy of a.csv; imported once."),
        ("e.csv", "beginning of b.csv; imported, and noted."),
    ]
    assert imported.recordings.note.tolist() == ["", "beginning-of:a.csv", "", "beginning-of:b.csv"]


def test_copies_that_contradict_each_other_are_kept(tmp_path: Path) -> None:
    for name, outcome in {"a": "good", "b": "bad", "c": "bad"}.items():
        write(tmp_path / f"{name}.csv", noise(0), outcome=outcome)
    imported = read_source(tmp_path)
    assert imported.recordings.outcome.tolist() == ["good", "bad"]
    assert imported.recordings.note.tolist() == ["contradictory-duplicate:b.csv", "contradictory-duplicate:a.csv"]
    assert [name for name, _ in imported.report.duplicates] == ["c.csv"]


def test_copies_with_the_same_annotation_without_an_end_are_copies(tmp_path: Path) -> None:
    for name in "ab":
        write(tmp_path / f"{name}.csv", noise(0))
        (tmp_path / f"{name}_labels.csv").write_text("label,start,end\npush,0.1,\n")
    report = read_source(tmp_path).report
    assert report.duplicates == [("b.csv", "exact copy of a.csv; imported once.")]


def test_folders_are_sessions_and_never_outcomes(tmp_path: Path) -> None:
    source = tmp_path / "my_unsuccessful_runs"
    for number, folder in enumerate(("failure", "success", "success")):
        write(source / folder / f"run{number}.csv", noise(number))
    imported = read_source(source)
    assert imported.recordings.session.tolist() == ["failure", "success", "success"]
    assert imported.recordings.outcome.tolist() == ["unknown"] * 3
    assert imported.recordings.source.tolist() == ["my_unsuccessful_runs"] * 3
    assert imported.recordings.trial.tolist() == ["failure/run0", "success/run1", "success/run2"]
    assert any("sessions are the sub-folders" in remark for remark in imported.report.remarks)
    assert any("it is unknown" in remark for remark in imported.report.remarks)


def test_every_file_is_imported_or_has_a_reason(tmp_path: Path) -> None:
    write(tmp_path / "good.csv", noise(0))
    write(tmp_path / "also.csv", noise(1))
    (tmp_path / "broken.csv").write_text("t,Fz\n0,1\n0.1,x\n0.2,3\n")
    (tmp_path / "other.csv").write_text("t,Fx\n" + "".join(f"{k},{k % 3}\n" for k in range(9)))
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04nothing")
    (tmp_path / "notes.docx").write_text("x")
    report = read_source(tmp_path).report
    assert report.imported == ["also.csv", "good.csv"]
    reasons = dict(report.skipped)
    assert "'x' is not a number" in reasons["broken.csv"]
    assert "has the axes Fx; 2 others have Fz" in reasons["other.csv"]
    assert "not a readable NPZ" in reasons["bad.npz"]
    assert not any(str(tmp_path) in reason for reason in reasons.values())
    assert report.remarks[0] == "1 other file was not read: notes.docx."


def test_mixed_rates_become_the_most_common_one(tmp_path: Path) -> None:
    for number in range(3):
        write(tmp_path / f"a{number}.csv", noise(number))
    write(tmp_path / "fast.csv", noise(4, 2000), dt=0.0005)
    imported = read_source(tmp_path)
    assert imported.recordings.dt == DT
    assert imported.recordings.length.tolist() == [200, 200, 200, 500]
    assert imported.recordings.note.tolist() == ["", "", "", "filtered;resampled:2000"]
    [remark] = [remark for remark in imported.report.remarks if "resampled" in remark]
    assert remark.startswith(
        "1 recording was resampled to 500 Hz, from 2000 Hz (1); 1 of them low-passed before, at 200 Hz"
    )
    asked = read_source(tmp_path, mapping=Mapping(rate=100.0))
    assert asked.recordings.dt == 0.01
    assert asked.recordings.length.tolist() == [40, 40, 40, 100]


def test_a_missing_mark_keeps_the_other_annotations(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
    (tmp_path / "marks.csv").write_text(
        "recording,track,label,start,end\n"
        "a,phase,approach,0,0.1\na,phase,mating,,\na,phase,push,0.1,\nb,phase,mating,0.2,0.3\nb,phase,push,9,10\n"
    )
    imported = read_source(tmp_path)
    marks = imported.recordings.annotations
    assert list(zip(marks.recording.tolist(), marks.names().tolist(), strict=True)) == [
        (0, "approach"), (0, "push"), (1, "mating"),
    ]  # fmt: skip
    assert np.isnan(marks.end[1])
    problems = [text for _, text in imported.report.warnings]
    assert "phase 'mating' has no start; left out, the other annotations are kept." in problems
    assert any("phase 'push' at 9 s is after the end" in problem for problem in problems)


def test_annotations_beside_each_recording(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0))
    (tmp_path / "a_labels.csv").write_text("label,start,end\nfree,0,0.2\npush,0.2,0.4\n")
    (tmp_path / "stray_labels.csv").write_text("label,start,end\nfree,0,0.2\n")
    imported = read_source(tmp_path)
    assert imported.recordings.annotations.labels == {"label": ("free", "push")}
    assert imported.report.imported == ["a.csv"]
    assert [name for name, _ in imported.report.warnings] == ["stray_labels.csv"]
    stamped = Mapping(annotations=(Track("phase", file="{stem}_labels.csv", clock="stamps", words={"free": "none"}),))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    moved = [",".join([repr(float(line.split(",")[0]) + 5), *line.split(",")[1:]]) for line in lines[1:]]
    (tmp_path / "a.csv").write_text("\n".join([lines[0], *moved]))
    (tmp_path / "a_labels.csv").write_text("label,start,end\nfree,5,5.2\npush,5.2,5.4\n")
    (tmp_path / "stray_labels.csv").unlink()
    marks = read_source(tmp_path / "a.csv", mapping=stamped).recordings.annotations
    assert marks.labels == {"phase": ("none", "push")}
    np.testing.assert_allclose(marks.start, [0, 0.2], atol=1e-9)


def labels(recordings: Recordings) -> list[tuple[str, str]]:
    marks = recordings.annotations
    return list(zip(recordings.trial[marks.recording].tolist(), marks.names().tolist(), strict=True))


def test_a_name_that_two_recordings_have_is_used_for_none(tmp_path: Path) -> None:
    """Annotations and outcomes of one were those of the other, too."""
    for seed, name in enumerate(("mon/run1", "tue/run1", "tue/run2", "wed/run3", "run3")):
        write(tmp_path / f"{name}.csv", noise(seed))
    words = ("run1", "tue/run1", "run2.csv", "run3")
    (tmp_path / "marks.csv").write_text("recording,label,start\n" + "".join(f"{word},{word},0.1\n" for word in words))
    (tmp_path / "facts.csv").write_text("file,ok\n" + "".join(f"{word},{word}\n" for word in words))
    own = [("run3", "run3"), ("tue/run1", "tue/run1"), ("tue/run2", "run2.csv")]
    base = Mapping(table="facts.csv", columns={"outcome": Value(table="ok")})
    for mapping in (base, replace(base, annotations=(Track("label", file="marks.csv"),))):
        imported = read_source(tmp_path, mapping=mapping)
        assert sorted(labels(imported.recordings)) == own
        outcomes = dict(zip(imported.recordings.trial.tolist(), imported.recordings.outcome.tolist(), strict=True))
        assert {trial: word for trial, word in outcomes.items() if word != "unknown"} == dict(own)
        reason = "'run1' is the name of several recordings and is used for none; write it with its folder."
        assert [name for name, text in imported.report.warnings if text == reason] == ["facts.csv", "marks.csv"]


def test_labels_of_a_file_are_for_the_one_in_the_same_folder(tmp_path: Path) -> None:
    for seed, folder in enumerate((".", "mon")):
        write(tmp_path / folder / "run1.csv", noise(seed))
    (tmp_path / "run1_labels.csv").write_text("label,start\npush,0.1\n")
    assert labels(read_source(tmp_path).recordings) == [("run1", "push")]


def test_a_number_sign_in_the_name_of_a_file_separates_nothing(tmp_path: Path) -> None:
    for number in (1, 2):
        write(tmp_path / f"run #{number}.csv", noise(number), run=["a"] * 100 + ["b"] * 100)
    (tmp_path / "run #1_labels.csv").write_text("label,start\npush,0.1\n")
    (tmp_path / "facts.csv").write_text("file,ok\nrun #2.csv,good\n")
    mapping = Mapping(table="facts.csv", columns={"outcome": Value(table="ok")})
    recordings = read_source(tmp_path, mapping=mapping).recordings
    assert recordings.trial.tolist() == ["run #1-a", "run #1-b", "run #2-a", "run #2-b"]
    assert recordings.outcome.tolist() == ["unknown"] * 2 + ["good"] * 2
    for number in (1, 2):
        write(tmp_path / f"run #{number}.csv", noise(number))
    assert labels(read_source(tmp_path / "run #1.csv").recordings) == []
    assert labels(read_source(tmp_path).recordings) == [("run #1", "push")]
    np.savez(tmp_path / "#3.npz", wrench=np.random.default_rng(0).normal(size=(2, 50, 6)), dt=DT)
    assert read_source(tmp_path / "#3.npz").recordings.trial.tolist() == ["#3-0", "#3-1"]


def test_a_table_of_recordings_lacks_no_column_and_repeats_no_file_unsaid(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0))
    (tmp_path / "facts.csv").write_text("file,ok\na.csv,good\na,bad\n")
    report = read_source(tmp_path, mapping=Mapping(table="facts.csv", columns={"outcome": Value(table="ok")})).report
    assert report.warnings == [("facts.csv", "has several rows for a.csv; the last one counts.")]
    with pytest.raises(InputError, match="has no column 'okay'; it has file, ok"):
        read_source(tmp_path, mapping=Mapping(table="facts.csv", columns={"outcome": Value(table="okay")}))


def test_labels_at_times_of_text_are_one_warning(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0))
    (tmp_path / "a_labels.csv").write_text("label,start\npush,soon\n")
    assert read_source(tmp_path).report.warnings == [
        ("a_labels.csv", "a_labels.csv: column start is text; expected seconds or times.")
    ]


def test_a_word_that_changes_in_one_recording_is_a_track_in_all(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0), phase=["free"] * 100 + ["push"] * 100)
    write(tmp_path / "b.csv", noise(1), phase="free")
    recordings = read_source(tmp_path).recordings
    assert recordings.annotations.names().tolist() == ["free", "push", "free"]
    np.testing.assert_allclose(recordings.annotations.end, [0.2, 0.4, 0.4])
    assert not recordings.columns


def test_an_outcome_in_one_row_counts_and_one_that_changes_is_a_warning(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0), outcome=[""] * 199 + ["good"])
    write(tmp_path / "b.csv", noise(1), outcome=["good"] * 199 + ["bad"])
    write(tmp_path / "c.csv", noise(2), outcome="")
    imported = read_source(tmp_path)
    assert imported.recordings.outcome.tolist() == ["good", "unknown", "unknown"]
    assert imported.report.warnings == [("b.csv", "states several outcomes; its outcome is unknown.")]


@pytest.mark.parametrize("name", ["outcome", "success"])
def test_usual_words_of_outcomes_are_understood(tmp_path: Path, name: str) -> None:
    words = ("TRUE", "ok", "Pass", "i.O.", "False", "NOK", "NG", "n.i.O.", "0")
    for number, word in enumerate(words):
        write(tmp_path / f"{number}.csv", noise(number), **{name: word})
    assert read_source(tmp_path).recordings.outcome.tolist() == ["success"] * 4 + ["failure"] * 5


def test_a_sensor_that_is_slower_than_the_log_has_its_own_rate(tmp_path: Path) -> None:
    rows = [f"{k / 1000},{k},{k if k % 10 == 0 else ''},{'' if k < 500 else 'push'}" for k in range(1000)]
    (tmp_path / "a.csv").write_text("\n".join(["t,joint,Fz,phase", *rows]))
    mapping = Mapping((Channel("Fz"),), annotations=(Track("phase", "phase"),))
    recordings = read_source(tmp_path, mapping=mapping).recordings
    assert (recordings.dt, recordings.note.tolist()) == (0.01, ["padded:9;between:891"])
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], np.arange(0, 1000, 10))
    np.testing.assert_allclose(recordings.starts("phase"), [[0.5]])


def test_two_arms_in_one_table_are_two_recordings_of_a_trial(tmp_path: Path) -> None:
    rows = [f"{k * DT},{arm},{force}" for k in range(50) for arm, force in (("left", k), ("right", -k))]
    (tmp_path / "a.csv").write_text("\n".join(["t,arm,Fz", *rows]))
    recordings = read_source(tmp_path).recordings
    assert (recordings.trial.tolist(), recordings.arm.tolist()) == (["a", "a"], ["left", "right"])
    np.testing.assert_array_equal(recordings.wrench[:, :, 0], [np.arange(50), -np.arange(50)])


def test_a_slow_clock_and_a_second_wrench_are_said(tmp_path: Path) -> None:
    axes = [f"{side}.force.{axis}" for side in ("base", "tool") for axis in "xyz"]
    rows = [",".join(map(str, [k * 2000, *np.random.default_rng(k).normal(size=6)])) for k in range(9)]
    (tmp_path / "a.csv").write_text("\n".join([",".join(["t [ms]", *axes]), *rows]))
    report = read_source(tmp_path).report
    assert report.warnings == [("a.csv", "has 0.5 samples per second. Is the unit of time right?")]
    assert report.remarks[0].startswith(
        "2 wrenches were found, and that of base.force.x was taken; to import that of 't"
    )


# --- Robots --------------------------------------------------------------------------------------------------------


def pa10(path: Path) -> np.ndarray:
    """A made-up recording of a PA10: 17 columns without names, 1 kHz, five states; the wrench."""
    rng, count = np.random.default_rng(5), 5000
    time = np.arange(count) / 1000
    wrench = np.cumsum(rng.normal(size=(count, 6)), 0) * 0.02
    joints, pose = np.sin(time[:, None] + np.arange(7)), np.cos(time[:, None] * np.arange(1, 3))
    state = np.repeat(np.arange(5.0), 1000)
    np.savetxt(path, np.column_stack([time, joints, wrench, pose, state]), fmt="%.9g")
    return wrench


def test_pa10(tmp_path: Path) -> None:
    wrench = pa10(tmp_path / "pa10.dat")
    names = ("approach", "contact", "search", "insertion", "mating")
    channels = tuple(
        Channel(f"c{8 + k}", axis, "N" if k < 3 else "Nm")
        for k, axis in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz"))
    )
    track = Track("state", "c16", words={str(number): name for number, name in enumerate(names)})
    recordings = read_source(
        tmp_path / "pa10.dat", "csv", Mapping(channels, time="c0", annotations=(track,))
    ).recordings
    assert recordings.dt == 0.001
    np.testing.assert_allclose(recordings.wrench[0], wrench, rtol=1e-6)
    assert recordings.annotations.labels == {"state": names}
    np.testing.assert_allclose(recordings.starts("state"), [[0, 1, 2, 3, 4]], atol=1e-9)
    assert recordings.note[0] == ""


def ur5(path: Path) -> None:
    """A made-up log of a UR5 at 500 Hz, as its RTDE client writes it."""
    count = 1000
    forces = np.random.default_rng(6).normal(size=(count, 6))
    head = ["timestamp", *(f"actual_q_{k}" for k in range(6)), *(f"actual_TCP_force_{k}" for k in range(6)), "phase"]
    rows = [" ".join(head)]
    for row, force in enumerate(forces):
        word = "approach" if row < 400 else "insert"
        rows.append(" ".join([f"{1234.5 + row * 0.002:.3f}", *["0.1"] * 6, *(f"{value:.6f}" for value in force), word]))
    path.write_text("\n".join(rows) + "\n")


def test_ur5_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ur5(tmp_path / "ur5.csv")
    out, saved = tmp_path / "ur5.zarr", tmp_path / "ur5.toml"
    words = ["import", "csv", str(tmp_path / "ur5.csv"), str(out), "--write-map", str(saved)]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rate"] == 500
    assert list(result["axes"]) == ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    assert set(result["axes"].values()) == {""}  # the file states no unit
    assert result["tracks"] == {"phase": ["approach", "insert"]}
    assert {"column": "actual_TCP_force_2", "role": "channel Fz", "unit": ""} in result["understood"]
    first = read_recordings(out)
    assert read_attrs(out)["import_report"]["imported"] == ["ur5.csv"]
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    again = tmp_path / "again.zarr"
    assert main(["import", "csv", str(tmp_path / "ur5.csv"), str(again), "--map", str(saved), "--tare", "0.1"]) == 0
    text = capsys.readouterr().out
    assert "actual_TCP_force_2  channel Fz" in text
    assert "1 recording at 500 Hz" in text
    tared = read_recordings(again)
    np.testing.assert_allclose(tared.wrench[0], first.wrench[0] - first.wrench[0, :50].mean(0), atol=1e-5)
    assert main(["import", "csv", str(tmp_path / "ur5.csv"), str(tmp_path / "x.zarr"), "--outcome", "phase"]) == 0
    assert read_recordings(tmp_path / "x.zarr").note[0] == "changes:outcome"
    assert "\nnotes: changes 1" in capsys.readouterr().out


def test_the_command_refuses_before_it_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ur5(tmp_path / "ur5.csv")
    base = ["import", "csv", str(tmp_path / "ur5.csv"), str(tmp_path / "a.zarr")]
    for words, sentence in (
        (["--write-map", str(tmp_path / "ur5.csv")], "is used as source"),
        (["--map", str(tmp_path / "none.toml")], "none.toml cannot be read"),
        (["--topic", "/ft", "--rate", "-3"], "the rate is -3"),
        (["--tare", "-1"], "the tare lasts -1 s"),
        (["--tare", "nan"], "the tare lasts nan s"),
    ):
        assert main([*base, *words]) == 2
        assert sentence in capsys.readouterr().err
    assert main(["import", "auto", str(tmp_path / "none"), str(tmp_path / "a.zarr")]) == 2
    assert "does not exist" in capsys.readouterr().err
    assert not (tmp_path / "a.zarr").exists()


def test_a_store_says_where_it_comes_from(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0))
    one = import_source(tmp_path / "a.csv", tmp_path / "a.zarr").report.content_sha256
    attrs = read_attrs(tmp_path / "a.zarr")
    assert (attrs["importer"], attrs["source_sha256"]) == ("auto", one)
    with (tmp_path / "a.csv").open("a") as file:
        file.write("0.4,1\n")
    assert read_source(tmp_path / "a.csv").report.content_sha256 != one


@pytest.mark.parametrize("kind", ["csv", "auto"])
def test_names_that_are_not_utf8_are_spelled_out(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Such as a file from an old Windows machine: it is imported, and so are the others, their intervals included."""
    source = tmp_path / "r\udce9sultats"
    for seed, name in enumerate(("a.csv", "b\udcff.csv", "s\udcff/c.csv")):
        write(source / name, noise(seed))
    (source / "broken\udcff.csv").write_text("t,Fx\n0,1\n1")
    (source / "b\udcff.marks").write_text("label,start\npush,0.02\n")
    beside = tmp_path / "map.toml"
    beside.write_text('[[annotations]]\ntrack = "phase"\nfile = "{stem}.marks"\n')
    out = tmp_path / "out.zarr"
    assert main(["import", kind, str(source), str(out), "--map", str(beside)]) == 0, capsys.readouterr().err
    recordings, report = read_recordings(out), read_attrs(out)["import_report"]
    assert recordings.trial.tolist() == ["a", "b\\xff", "s\\xff/c"]
    assert set(recordings.source.tolist()) == {"r\\xe9sultats"}
    assert recordings.session.tolist()[2] == "s\\xff"
    assert recordings.annotations.recording.tolist() == [1]
    assert [name for name, _ in report["skipped"]] == ["broken\\xff.csv"]
    assert str(tmp_path) not in json.dumps(report)
    one = tmp_path / "one.zarr"
    assert main(["import", kind, str(source / "b\udcff.csv"), str(one)]) == 0
    assert read_recordings(one).trial.tolist() == ["b\\xff"]


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap", "lerobot"])
def test_exports_in_folders_whose_names_are_not_utf8_are_read(tmp_path: Path, kind: str) -> None:
    export(DataSet.of(Recordings.example()), tmp_path / "plain", kind)
    other = (tmp_path / "plain").rename(tmp_path / "other\udcff")
    found = read_source(other)
    assert len(found.recordings) == 8
    json.dumps(found.report.to_dict(), ensure_ascii=False).encode()
