"""What is known of whole recordings: from a table that lists them, from folders where a map says so."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, Track, Value, read_mapping, write_mapping
from rcbht_jax.io.store import read_recordings
from tests.io.importing.test_importer import DT, noise, write


def test_facts_from_a_table_of_recordings(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write(tmp_path / "runs" / f"{name}.csv", noise(ord(name)))
    (tmp_path / "facts.json").write_text(json.dumps([{"file": "runs/a.csv", "ok": True}, {"file": "b", "ok": False}]))
    columns = {"outcome": Value(table="ok", words={"True": "success"}), "robot": Value(value="UR5")}
    imported = read_source(tmp_path, mapping=Mapping(table="facts.json", columns=columns))
    assert imported.recordings.outcome.tolist() == ["success", "False", "unknown"]
    assert imported.recordings.columns["robot"].tolist() == ["UR5"] * 3
    assert imported.report.warnings == [("runs/c.csv", "facts.json has no row for it.")]
    assert not any("not read" in text for text in imported.report.remarks)


def test_a_table_that_lists_recordings_is_found(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write(tmp_path / "runs" / "day 1" / f"{name}.csv", noise(ord(name)), phase="free")
    (tmp_path / "runs" / "trials.csv").write_text("Versuch;result;operator\na;OK;Ann\nb.csv;NOK;Bob\nz;OK;Ann\n")
    imported = read_source(tmp_path / "runs")
    assert imported.recordings.columns["operator"].tolist() == ["Ann", "Bob", ""]
    assert imported.recordings.outcome.tolist() == ["unknown"] * 3
    assert not imported.report.skipped
    absent = "1 row is of no recording here, and left out: 'z'."
    assert imported.report.warnings == [("day 1/c.csv", "trials.csv has no row for it."), ("trials.csv", absent)]
    again = read_source(tmp_path / "runs", mapping=imported.mapping)
    assert again.recordings.columns["result"].tolist() == ["OK", "NOK", ""]
    command = ["import", "csv", str(tmp_path / "runs"), str(tmp_path / "x.zarr"), "--outcome", "result"]
    assert main(command) == 0
    assert read_recordings(tmp_path / "x.zarr").outcome.tolist() == ["success", "failure", "unknown"]


def test_a_table_that_names_no_recording_is_said_to_be_why_the_outcome_is_unknown(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
    (tmp_path / "trials.csv").write_text("id,result\n8,ok\n9,nok\n")
    imported = read_source(tmp_path, mapping=Mapping(columns={"outcome": Value("result")}))
    [(table, warning)] = imported.report.warnings
    assert table == "trials.csv"
    assert warning.startswith("alone has a column 'result' and is no recording, so no column outcome;")


def test_a_column_of_trials_in_a_found_table_is_remarked(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
    (tmp_path / "trials.csv").write_text("file,trial\na,T1\nb,T2\n")
    imported = read_source(tmp_path)
    assert imported.recordings.trial.tolist() == ["a", "b"]
    assert any("describe them, but for 'trial'" in remark for remark in imported.report.remarks)


def test_the_outcome_may_be_named_beside_a_map_that_was_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c"):
        write(tmp_path / "runs" / f"{name}.csv", noise(ord(name)))
    (tmp_path / "runs" / "trials.csv").write_text("file,result\na,ok\nb,nok\n")
    words = ["import", "csv", str(tmp_path / "runs")]
    assert main([*words, str(tmp_path / "x.zarr"), "--write-map", str(tmp_path / "x.toml")]) == 0
    assert "Name one with --outcome or in a map." in capsys.readouterr().out
    assert main([*words, str(tmp_path / "y.zarr"), "--map", str(tmp_path / "x.toml"), "--outcome", "result"]) == 0
    assert read_recordings(tmp_path / "y.zarr").outcome.tolist() == ["success", "failure", "unknown"]


def test_an_outcome_that_changes_is_not_called_absent(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(1), event=["pick"] * 9 + ["place"] * 191)
    report = read_source(tmp_path / "a.csv", mapping=Mapping(columns={"outcome": Value("event")})).report
    assert report.warnings == [("a.csv", "states several outcomes; its outcome is unknown.")]
    assert not any("No column states the outcome" in remark for remark in report.remarks)


def test_a_table_of_recordings_outside_the_folder_is_not_read(tmp_path: Path) -> None:
    write(tmp_path / "runs" / "run7.csv", noise(1))
    (tmp_path / "trials.csv").write_text("file,operator\nrun7,Ann\n")
    (tmp_path / "runs" / "trials.csv").symlink_to(tmp_path / "trials.csv")
    imported = read_source(tmp_path / "runs")
    assert "operator" not in imported.recordings.columns
    assert [name for name, _ in imported.report.skipped] == ["trials.csv"]


def test_a_column_from_the_names_of_folders_if_a_map_says_so(tmp_path: Path) -> None:
    for number, folder in enumerate(("bad/day 1", "good/day 1", ".")):
        write(tmp_path / "runs" / folder / "a.csv", noise(number))
    text = '[columns.outcome]\nfolder = 1\nwords = {"good" = "success"}\n[columns.day]\nfolder = -1\n'
    (tmp_path / "a.toml").write_text(text)
    imported = read_source(tmp_path / "runs", mapping=read_mapping(tmp_path / "a.toml"))
    assert imported.recordings.outcome.tolist() == ["unknown", "bad", "success"]
    assert imported.recordings.columns["day"].tolist() == ["", "day 1", "day 1"]
    write_mapping(tmp_path / "b.toml", imported.mapping)
    assert read_mapping(tmp_path / "b.toml") == imported.mapping


def test_a_table_of_recordings_may_name_groups(tmp_path: Path) -> None:
    rows = [f"{k % 50 * DT},T{k // 50},{k}" for k in range(150)]
    (tmp_path / "all.csv").write_text("\n".join(["t,trial,Fz", *rows]))
    (tmp_path / "facts.csv").write_text("trial,part\nT0,peg\nT2,plug\n")
    mapping = Mapping(table="facts.csv", key="trial", columns={"part": Value(table="part")})
    imported = read_source(tmp_path, mapping=mapping)
    assert imported.recordings.columns["part"].tolist() == ["peg", "", "plug"]
    assert imported.report.warnings == [("all.csv#T1", "facts.csv has no row for it.")]


def test_annotations_may_be_on_the_clock_of_the_recordings(tmp_path: Path) -> None:
    time = 1.7e9 + np.arange(100) * 0.01
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz", *(f"{t:.3f},{k}" for k, t in enumerate(time))]))
    (tmp_path / "a_labels.csv").write_text("label,start,end\npush,1700000000.25,1700000000.5\nrest,2000000000,\n")
    imported = read_source(tmp_path)
    np.testing.assert_allclose(imported.recordings.annotations.start, [0.25], atol=1e-6)
    np.testing.assert_allclose(imported.recordings.annotations.end, [0.5], atol=1e-6)
    assert len(imported.report.warnings) == 1


def test_a_table_outside_the_source_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "in" / "a.csv", noise(0))
    (tmp_path / "facts.csv").write_text("file,x\na,1\n")
    with pytest.raises(InputError, match="outside the source"):
        read_source(tmp_path / "in", mapping=Mapping(table="../facts.csv", columns={"x": Value(table="x")}))


@pytest.mark.parametrize(("name", "true"), [("result", "success"), ("anomaly", "failure")])
def test_the_column_of_the_outcome_may_have_any_name(tmp_path: Path, name: str, true: str) -> None:
    write(tmp_path / "runs" / "a.csv", noise(0), **{name: "True"})
    write(tmp_path / "runs" / "b.csv", noise(1), **{name: "False"})
    store = tmp_path / "x.zarr"
    assert main(["import", "csv", str(tmp_path / "runs"), str(store), "--outcome", name]) == 0
    assert read_recordings(store).outcome.tolist() == sorted(["success", "failure"], key=lambda word: word != true)


def test_a_column_that_is_empty_in_the_first_file_is_not_said_to_be_left_out(tmp_path: Path) -> None:
    for number, operator in enumerate(("", "Ann", "Bob")):
        write(tmp_path / f"{number}.csv", noise(number), operator=operator, remark="")
    imported = read_source(tmp_path)
    assert imported.recordings.columns["operator"].tolist() == ["", "Ann", "Bob"]
    roles = {row["column"]: row["role"] for row in imported.report.understood}
    assert (roles["operator"], roles["remark"]) == ("column operator", "left out")


def test_names_whose_accents_stand_after_their_letters_are_found(tmp_path: Path) -> None:
    rows = "\n".join(f"{k * 0.01},{k % 7}" for k in range(50))
    for number, letter in enumerate(("o\u0301", "\u00f3")):  # as macOS writes them, and as keyboards do
        (tmp_path / f"inserci{letter}n_{number}.csv").write_text(f"t,Fz\n{rows[: -number or None]}")
    listed = "inserci\u00f3n_0,Ana\ninsercio\u0301n_1,Eva\n"
    (tmp_path / "trials.csv").write_text(f"recording,operator\n{listed}")
    recordings = read_source(tmp_path).recordings
    assert recordings.trial.tolist() == ["inserci\u00f3n_0", "inserci\u00f3n_1"]
    assert recordings.columns["operator"].tolist() == ["Ana", "Eva"]


def test_outcomes_in_words_that_nobody_stated_are_remarked(tmp_path: Path) -> None:
    for number, word in enumerate(("éxito", "fallo")):
        write(tmp_path / f"{number}.csv", noise(number), resultado=word)
    mapping = Mapping(columns={"outcome": Value("resultado")})
    remark = "No outcome is success or failure (fallo, éxito); state in a map which words mean them."
    assert read_source(tmp_path, mapping=mapping).report.remarks == [remark]
    stated = Mapping(columns={"outcome": Value("resultado", words={"éxito": "success", "fallo": "failure"})})
    assert read_source(tmp_path, mapping=stated).report.remarks == []


def test_a_recording_without_a_column_that_describes_it_is_imported(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(1), phase="free", ok="1")
    write(tmp_path / "b.csv", noise(2))
    columns = {"outcome": Value("ok", words={"1": "success"})}
    imported = read_source(tmp_path, mapping=Mapping(annotations=(Track("step", "phase"),), columns=columns))
    recordings = imported.recordings
    assert recordings.trial.tolist() == ["a", "b"]
    assert recordings.outcome.tolist() == ["success", "unknown"]
    assert recordings.annotations.recording.tolist() == [0]
    assert imported.report.skipped == []
    assert imported.report.warnings == [
        ("b.csv", "has no column 'phase', so no annotations step."),
        ("b.csv", "has no column 'ok', so no column outcome."),
    ]
    for wrong in (Mapping(annotations=(Track("step", "fase"),)), Mapping(columns={"outcome": Value("fase")})):
        with pytest.raises(InputError, match=r"^a\.csv has no column 'fase'; it has "):  # no file has it
            read_source(tmp_path, mapping=wrong)


def test_files_of_annotations_that_a_map_names_are_not_called_unread(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        write(tmp_path / folder / "a.csv", noise(ord(folder[0])), phase="free")
        (tmp_path / folder / "a.ends").write_text("0.1\n0.2\n")
        (tmp_path / folder / "a.ids").write_text("0\n1\n")
    (tmp_path / "note.pdf").write_text("not read")
    imported = read_source(
        tmp_path, mapping=Mapping(annotations=(Track("step", ends="{stem}.ends", ids="{stem}.ids"),))
    )
    assert len(imported.recordings.annotations.of("step").recording) == 4
    assert [text for text in imported.report.remarks if "not read" in text] == ["1 other file was not read: note.pdf."]


def test_a_recording_that_a_found_table_names_twice_leaves_the_others_their_outcomes(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write(tmp_path / "runs" / f"{name}.csv", noise(ord(name)))
    (tmp_path / "runs" / "trials.csv").write_text("run,result,next\na,ok,b\nb,nok,b\nc,ok,b\nb,ok,b\nb,ok,b\n")
    command = ["import", "csv", str(tmp_path / "runs"), str(tmp_path / "x.zarr"), "--outcome", "result", "--json"]
    assert main(command) == 0
    assert read_recordings(tmp_path / "x.zarr").outcome.tolist() == ["success"] * 3
    report = read_source(tmp_path / "runs").report
    assert report.warnings == [("trials.csv", "has several rows for b.csv; the last one counts.")]
    assert report.skipped == []


def test_a_table_with_as_many_rows_as_recordings_have_events_lists_none(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
    (tmp_path / "events.csv").write_text("run,click\na,yes\na,no\nb,yes\nb,yes\n")
    imported = read_source(tmp_path)
    assert "click" not in imported.recordings.columns
    assert [name for name, _ in imported.report.skipped] == ["events.csv"]


@pytest.mark.parametrize("rows", [["a.csv,touch,0.1", "b.csv,slip,0.2"], ["a.csv,touch,0.1", "a.csv,slip,0.2"]])
def test_a_list_of_events_holds_annotations_and_describes_no_recordings(rows: list[str], tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
    (tmp_path / "events.csv").write_text("\n".join(["file,event,time", *rows]))
    imported = read_source(tmp_path)
    assert (imported.report.skipped, "event" in imported.recordings.columns) == ([], False)
    assert sorted(imported.recordings.annotations.labels["label"]) == ["slip", "touch"]


@pytest.mark.parametrize(
    ("name", "text"), [("a_labels.csv", "label,start\nfügen,0.1\n"), ("list.csv", "file,Teil\na,ö\n")]
)
def test_words_that_are_not_utf8_are_doubted_beside_recordings_too(name: str, text: str, tmp_path: Path) -> None:
    write(tmp_path / "a.csv", noise(0))
    (tmp_path / name).write_bytes(text.encode("cp1252"))
    [(file, warning)] = read_source(tmp_path).report.warnings
    assert (file, "read as Windows-1252" in warning) == (name, True)


def test_rows_of_recordings_that_are_not_there_are_told(tmp_path: Path) -> None:
    rows = [f"{k % 50 * DT},T{k // 50},{k}" for k in range(150)]
    (tmp_path / "all.csv").write_text("\n".join(["t,trial,Fz", *rows]))
    write(tmp_path / "b.csv", noise(1))
    (tmp_path / "c.csv").write_text("broken")
    words = ("T0", "all.csv#T2", "b", "c", "d", "T7", "", "d")
    (tmp_path / "facts.csv").write_text("\n".join(["trial,part", *(f"{word},peg" for word in words)]))
    mapping = Mapping(table="facts.csv", key="trial", columns={"part": Value(table="part")})
    report = read_source(tmp_path, mapping=mapping).report
    assert ("facts.csv", "2 rows are of no recording here, and left out: 'd', 'T7'.") in report.warnings


@pytest.mark.parametrize(
    ("words", "outcomes"),
    [
        (("ok", "NOK"), ["success", "failure"]),
        (("i.O.", "n.i.O."), ["success", "failure"]),
        (("ok", "weak"), ["ok", "weak"]),  # a class of its own, beside which "ok" may mean anything
    ],
)
@pytest.mark.parametrize("table", [True, False])
def test_the_words_of_an_outcome_are_understood_where_a_map_states_none(
    tmp_path: Path, words: tuple[str, str], outcomes: list[str], table: bool
) -> None:
    for number, word in enumerate(words):
        write(tmp_path / f"{number}.csv", noise(number), **({} if table else {"result": word}))
    (tmp_path / "trials.json").write_text(
        json.dumps([{"file": "0", "result": words[0]}, {"file": "1.csv", "result": words[1]}])
    )
    text = '[columns.outcome]\ntable = "result"\n' if table else '[columns.outcome]\ncolumn = "result"\n'
    (tmp_path / "a.toml").write_text('table = "trials.json"\n' + text)
    imported = read_source(tmp_path, "csv", read_mapping(tmp_path / "a.toml"))
    assert imported.recordings.outcome.tolist() == outcomes
    write_mapping(tmp_path / "b.toml", imported.mapping)
    again = read_source(tmp_path, "csv", read_mapping(tmp_path / "b.toml"))
    assert again.recordings.outcome.tolist() == outcomes


def test_names_and_words_of_digits_stay_as_they_are_written(tmp_path: Path) -> None:
    for name in ("001", "002", "10"):
        write(tmp_path / f"{name}.csv", noise(int(name)))
    (tmp_path / "trials.csv").write_text("trial,operator,serial,mass\n001,007,1E5,1.50\n002,008,,2\n10,9,77,nan\n")
    (tmp_path / "labels.csv").write_text("file,label,start\n001,01,0.05\n002,1,0.05\n002,1.0,0.1\n010,2,0.05\n")
    recordings = read_source(tmp_path).recordings
    assert recordings.trial.tolist() == ["001", "002", "10"]
    columns = {name: values.tolist() for name, values in recordings.columns.items()}
    assert columns["operator"] == ["007", "008", "9"]
    assert (columns["serial"], columns["mass"]) == (["1E5", "", "77"], ["1.5", "2", ""])
    marks = recordings.annotations
    assert list(zip(marks.recording.tolist(), marks.names().tolist(), strict=True)) == [
        (0, "01"), (1, "1"), (1, "1"), (2, "2")
    ]  # fmt: skip
    track = Track("event", file="labels.csv")
    marks = read_source(tmp_path, mapping=Mapping(annotations=(track,))).recordings.annotations
    assert "01" in marks.labels["event"]


def test_digits_name_groups_of_a_column_of_numbers(tmp_path: Path) -> None:
    rows = [f"{k % 50 * DT},{k // 50:03},{k}" for k in range(150)]
    (tmp_path / "all.csv").write_text("\n".join(["t,trial,Fz", *rows]))
    (tmp_path / "facts.csv").write_text("trial,part\n000,peg\n002,plug\n")
    mapping = Mapping(table="facts.csv", key="trial", columns={"part": Value(table="part")})
    assert read_source(tmp_path, mapping=mapping).recordings.columns["part"].tolist() == ["peg", "", "plug"]


def test_a_table_may_name_packed_files_as_they_are(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", noise(ord(name)))
        (tmp_path / f"{name}.csv.gz").write_bytes(gzip.compress((tmp_path / f"{name}.csv").read_bytes()))
        (tmp_path / f"{name}.csv").unlink()
    (tmp_path / "trials.csv").write_text("file,outcome\na.csv.gz,ok\nb.csv.gz,nok\n")
    assert read_source(tmp_path).recordings.outcome.tolist() == ["success", "failure"]


@pytest.mark.parametrize(
    ("facts", "outcomes"),
    [(("ok", "NOK"), ["success", "failure"]), ((True, 0), ["success", "failure"]), (("ok", "weak"), ["ok", "weak"])],
)
@pytest.mark.parametrize("kind", ["json", "h5"])
def test_the_words_of_an_outcome_that_no_column_states_are_understood_too(
    tmp_path: Path, kind: str, facts: tuple[object, object], outcomes: list[str]
) -> None:
    for number, fact in enumerate(facts):
        values = noise(number)
        if kind == "json":
            write(tmp_path / f"{number}.csv", values)
            (tmp_path / f"{number}.json").write_text(json.dumps({"outcome": fact}))
        else:
            with pytest.importorskip("h5py").File(tmp_path / f"{number}.h5", "w") as file:
                file["wrench"], file.attrs["dt"], file.attrs["outcome"] = values, DT, fact
    imported = read_source(tmp_path)
    assert imported.recordings.outcome.tolist() == outcomes
    assert any("No outcome is success or failure" in remark for remark in imported.report.remarks) == ("ok" in outcomes)
    named = Mapping(columns={"outcome": Value("outcome", words={"ok": "success", "weak": "failure"})})
    if "ok" in facts:
        assert read_source(tmp_path, mapping=named).recordings.outcome.tolist()[0] == "success"


@pytest.mark.parametrize(
    ("files", "title"),
    [("run{}.csv", "run"), ("run_{:03}.csv", "Run"), ("trial{}/ft.csv", "trial_id"), ("exp_{}.csv", "trial")],
)
def test_a_table_lists_recordings_by_the_numbers_in_their_names(files: str, title: str, tmp_path: Path) -> None:
    for number in (1, 2, 10):
        write(tmp_path / "runs" / files.format(number), noise(number))
    (tmp_path / "runs" / "list.csv").write_text(f"{title},result\n10,ok\n2,nok\n1,ok\n")
    imported = read_source(tmp_path / "runs")
    assert imported.report.imported == [files.format(number) for number in (1, 2, 10)]
    assert imported.recordings.columns["result"].tolist() == ["ok", "nok", "ok"]
    assert (imported.report.skipped, imported.report.warnings) == ([], [])
    again = read_source(tmp_path / "runs", mapping=imported.mapping)
    assert again.recordings.columns["result"].tolist() == ["ok", "nok", "ok"]


def test_numbers_that_may_mean_other_files_list_none(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        write(tmp_path / "runs" / f"exp_{number}.csv", noise(number))
    (tmp_path / "runs" / "list.csv").write_text("trial,result\n1,ok\n2,nok\n3,ok\n")
    [(name, reason)] = read_source(tmp_path / "runs").report.skipped
    assert name == "list.csv"
    assert "add a column 'file' with their names" in reason
