"""Text as sensors, spreadsheets and loggers of other laboratories write it."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.text import read_csv

N = 40
TIME = (np.arange(N) * 0.01).round(2)
WRENCH = np.random.default_rng(0).normal(size=(N, 6)).round(3) * 100
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N",) * 3 + ("Nm",) * 3
COUNTS = "Counts per Unit"


def comma(value: float) -> str:
    return f"{value:.4f}".replace(".", ",")


def holds(imported: Imported, units: tuple[str, ...] = ("",) * 6) -> None:
    recordings = imported.recordings
    assert (recordings.axes, imported.mapping.units) == (AXES, units)
    assert recordings.dt == pytest.approx(0.01)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-3)
    assert imported.report.skipped == imported.report.warnings == []


@pytest.mark.parametrize("head", ["time,Fx,Fy,Fz,Mx,My,Mz\n", '"time","Fx","Fy","Fz","Mx","My","Mz"\n'])
@pytest.mark.parametrize("units", ["", '"s","N","N","N","Nm","Nm","Nm"\n'])
def test_quoted_decimal_commas_between_commas(head: str, units: str, tmp_path: Path) -> None:
    rows = [",".join(f'"{comma(value)}"' for value in (time, *row)) for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text(head + units + "\n".join(rows))
    holds(read_source(tmp_path), UNITS if units else ("",) * 6)


@pytest.mark.parametrize("between", [" ", "   "])
def test_decimal_commas_between_blanks(between: str, tmp_path: Path) -> None:
    rows = [between.join(map(comma, (time, *row))) for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([between.join(("time", *AXES)), *rows]))
    holds(read_source(tmp_path))


def test_exponents_of_double_precision_in_fortran(tmp_path: Path) -> None:
    rows = ["".join(f"{value:15.6E}" for value in (time, *row)) for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time " + " ".join(AXES), *rows]).replace("E", "D"))
    holds(read_source(tmp_path))


def test_serial_numbers_with_a_d_are_words(tmp_path: Path) -> None:
    rows = [f"{number},{number},{'ab' if number < 2 else '1.5D3'}" for number in range(9)]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz,phase", *rows]))
    assert {"ab", "1.5D3"} == set(read_source(tmp_path).recordings.annotations.labels["phase"])


@given(
    st.lists(st.tuples(*[st.floats(-1e6, 1e6).map(lambda value: round(value, 4))] * 3), min_size=3, max_size=8),
    st.sampled_from(",;\t"),
)
def test_no_number_with_a_decimal_comma_changes(rows: list[tuple[float, ...]], delimiter: str) -> None:
    text = io.StringIO()
    writer = csv.writer(text, delimiter=delimiter)
    writer.writerow(["t", "Fx", "Fz"])
    writer.writerows([[comma(value) for value in row] for row in rows])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        path.write_text(text.getvalue())
        [table] = read_csv(path, "run.csv")
    np.testing.assert_array_equal(np.stack(list(table.columns.values()), 1), rows)


def test_quoted_thousands_beside_points_stay_thousands(tmp_path: Path) -> None:
    rows = "\n".join(f'{time},"1,{k:03}",0.5' for k, time in enumerate(TIME))
    (tmp_path / "run.csv").write_text(f"t,Fx,Fz\n{rows}\n")
    np.testing.assert_array_equal(read_source(tmp_path).recordings.wrench[0, :, 0], 1000 + np.arange(N))


@pytest.mark.parametrize(
    "before",
    [
        f'"Start: 5/1/2024"\n"Force Units: N","{COUNTS} Force: 1000000.0"\n"Torque Units: Nm","{COUNTS} Torque: 1e6"',
        f'"Force Units: N","{COUNTS} Force: 1e6","Torque Units: N-m","{COUNTS} Torque: 1000000.0"',
        f"Force Units:,N,{COUNTS} Force:,1000000\nTorque Units:,Nm,{COUNTS} Torque:,1000000",
        f"Force Units,N\n{COUNTS} Force,1000000\nTorque Units,Nm\n{COUNTS} Torque,1000000",
    ],
)
def test_counts_are_divided_however_the_lines_before_state_them(before: str, tmp_path: Path) -> None:
    head = "Status (hex),RDT Sequence,F/T Sequence,Fx,Fy,Fz,Tx,Ty,Tz,Time"
    rows = [
        ",".join(["0", f"{k}", f"{5 * k}", *(f"{1e6 * value:.0f}" for value in row), f"{time}"])
        for k, (time, row) in enumerate(zip(TIME, WRENCH, strict=True))
    ]
    (tmp_path / "run.csv").write_text("\n".join([before, head, *rows]) + "\n")
    imported = read_source(tmp_path)
    holds(imported, UNITS)
    assert imported.recordings.note[0].endswith(";counts")


def test_units_before_the_names_without_counts(tmp_path: Path) -> None:
    rows = [",".join(map(str, (time, *row))) for time, row in zip(TIME, WRENCH, strict=True)]
    head = '"Force Units: N","Torque Units: Nm"\ntime,Fx,Fy,Fz,Tx,Ty,Tz\n'
    (tmp_path / "run.csv").write_text(head + "\n".join(rows))
    holds(read_source(tmp_path), UNITS)


@pytest.mark.parametrize(
    "before",
    [
        "# exported by a logger\nOperator,me\nSample Rate,100\n\n",
        "Operator,me\n# of samples,50\n\n",
        "# a\n# b\n",
        "Operator,me\n// made by, a, logger, of, today\n",
    ],
)
@pytest.mark.parametrize("units", ["", "s,N,N\n", "# a comment\n"])
def test_comments_among_the_lines_before_the_names(before: str, units: str, tmp_path: Path) -> None:
    rows = "\n".join(f"{time},{row[0]},{row[1]}" for time, row in zip(TIME, WRENCH, strict=True))
    (tmp_path / "run.csv").write_text(f"{before}t,Fx,Fz\n{units}{rows}\n")
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.length.tolist()) == (("Fx", "Fz"), [len(TIME)])
    assert recordings.units == (("N", "N") if units.startswith("s") else ("", ""))


@pytest.mark.parametrize(
    ("units", "time", "phase"),
    [
        ("hh:mm:ss,ms;N;N", "12:00:{:06.3f}", ""),
        ("UTC;N;N", "2024-05-01T12:00:{:06.3f}Z", ""),
        ("s;N;N;text", "{:.3f}", ";push"),
        ("[hh:mm:ss];[N];[N];", "12:00:{:06.3f}", ";push"),
    ],
)
def test_words_about_times_and_texts_among_the_units(units: str, time: str, phase: str, tmp_path: Path) -> None:
    rows = "\n".join(f"{time.format(t)};{row[0]};{row[1]}{phase}" for t, row in zip(TIME, WRENCH, strict=True))
    (tmp_path / "run.csv").write_text(f"Zeit;Fx;Fz{';phase' if phase else ''}\n{units}\n{rows}\n")
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.mapping.units) == (("Fx", "Fz"), ("N", "N"))
    assert imported.recordings.dt == pytest.approx(0.01)


@pytest.mark.parametrize("mark", ["sep=;", '"sep=;"', "\ufeffsep=;"])
def test_the_separator_that_a_spreadsheet_reads_is_no_name(mark: str, tmp_path: Path) -> None:
    rows = [";".join(map(str, (10 * k, *row))) + ";" for k, row in enumerate(WRENCH)]
    head = f"{mark}\nTimestamp;Fx;Fy;Fz;Tx;Ty;Tz\n;N;N;N;Nm;Nm;Nm\n"
    (tmp_path / "run.csv").write_text(head + "\n".join(rows), "utf-8")
    holds(read_source(tmp_path), UNITS)


@pytest.mark.parametrize("mark", ["#", "%", "//"])
def test_comments_before_and_between_rows_are_left_out(mark: str, tmp_path: Path) -> None:
    rows = [",".join(map(str, (time, *row))) for time, row in zip(TIME, WRENCH, strict=True)]
    rows.insert(20, f"{mark} contact, here")
    (tmp_path / "run.csv").write_text("\n".join([f"{mark} robot A", ",".join(("time", *AXES)), *rows]))
    imported = read_source(tmp_path)
    holds(imported)
    assert any(f"left out: '{mark} contact'" in remark for remark in imported.report.remarks)


CYRILLIC = ("Н", "Н", "Н", "Н·м", "Нм", "Н*м")


@pytest.mark.parametrize("encoding", ["utf-8", "cp1251"])
@pytest.mark.parametrize("form", ["{} [{}]", "{}, {}", "{} ({})"])
def test_cyrillic_names_and_units(form: str, encoding: str, tmp_path: Path) -> None:
    names = [f"{word} {axis}" for word in ("Сила", "Момент") for axis in "XYZ"]
    heads = [form.format(name, unit) for name, unit in zip(("Время", *names), ("мс", *CYRILLIC), strict=True)]
    rows = [";".join(map(comma, (10 * k, *row))) for k, row in enumerate(WRENCH)]
    (tmp_path / "run.csv").write_text("\n".join([";".join(heads), *rows]), encoding)
    imported = read_source(tmp_path)
    holds(imported, UNITS)
    assert imported.recordings.note[0] == ("cp1251" if encoding == "cp1251" else "")


@pytest.mark.parametrize("word", ["Größe", "créée à côté", "Ø [mm] durchschnittlich"])
def test_western_words_are_not_taken_for_cyrillic_ones(word: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("\n".join(["t;Fz;label", *(f"{t};{t};{word}" for t in TIME)]), "cp1252")
    assert read_source(tmp_path).recordings.note[0] == "cp1252"


@pytest.mark.parametrize(
    ("force", "moment", "meant"),
    [("kgf", "kgf.cm", ("kgf", "kgf cm")), ("lb", "in-lb", ("lbf", "lbf in")), ("lbs", "ft-lbs", ("lbf", "lbf ft")),
     ("daN", "daN.m", ("daN", "")), ("кгс", "кгс·м", ("kgf", "kgf m")), ("mN", "mN m", ("mN", "mNm")),
     ("MN", "MNm", ("", "")), ("kp", "kp*m", ("", "")), ("bar", "Nm", ("", "Nm"))],
)  # fmt: skip
def test_no_axis_is_left_out_for_its_unit(force: str, moment: str, meant: tuple[str, str], tmp_path: Path) -> None:
    heads = [f"F{axis} ({force})" for axis in "xyz"] + [f"M{axis} ({moment})" for axis in "xyz"]
    rows = [",".join(map(str, (time, *row))) for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([",".join(("time (s)", *heads)), *rows]))
    holds(read_source(tmp_path), (meant[0],) * 3 + (meant[1],) * 3)


def test_brackets_that_tell_wrenches_apart_are_no_units(tmp_path: Path) -> None:
    heads = [f"F{axis} ({word})" for word in ("raw", "filtered") for axis in "xyz"]
    rows = [",".join(map(str, (time, *row))) for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([",".join(("time", *heads)), *rows]))
    imported = read_source(tmp_path)
    assert imported.recordings.axes == ("Fx", "Fy", "Fz")
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH[:, 3:], rtol=1e-6)
    assert any(remark.startswith("2 wrenches were found") for remark in imported.report.remarks)


@pytest.mark.parametrize("word", ["Zeit", "Temps", "Tiempo", "Время", "时间", "時間", "시간"])
def test_times_in_other_languages_grow(word: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(
        "\n".join([f"Fz,{word}", *(f"{row[2]},{t}" for t, row in zip(TIME, WRENCH, strict=True))])
    )
    assert read_source(tmp_path).recordings.axes == ("Fz",)
    (tmp_path / "run.csv").write_text("\n".join([f"Fz,{word}", *(f"{row[2]},{row[3]}" for row in WRENCH)]))
    with pytest.raises(InputError, match="no column of time"):
        read_source(tmp_path)


@pytest.mark.parametrize(
    ("head", "axes"), [("t,mx,my", ("Mx", "My")), ("t,force_z,speed", ("Fz", "speed")), ("t,fx,Fx", ("fx", "Fx"))]
)
def test_single_axes_have_the_names_of_axes(head: str, axes: tuple[str, ...], tmp_path: Path) -> None:
    rows = [f"{time},{row[0]},{row[1]}" for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([head, *rows]))
    assert read_source(tmp_path).recordings.axes == axes


def measurement(path: Path, names: str, delta: str, rows: list[str]) -> None:
    """A file of LabVIEW (.lvm) of two signals."""
    units = "\t".join("Newton" if name in ("Fx", "Fz") else "" for name in names.split("\t")[1:])
    head = f"LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t2\nY_Unit_Label\t{units}\n"
    path.write_text(f"{head}Delta_X\t{delta}\n***End_of_Header***\t\n{names}\tComment\n" + "\n".join(rows) + "\n")


def forces(imported: Imported) -> None:
    assert (imported.recordings.axes, imported.mapping.units) == (("Fx", "Fz"), ("N", "N"))
    assert imported.recordings.dt == pytest.approx(0.01)
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH[:, :2], rtol=1e-6)


@pytest.mark.parametrize("delta", ["0.01\t0.01", "0,010000\t0,010000", "1.0E-2\t1.0E-2"])
def test_a_measurement_of_labview_without_times_states_its_rate(delta: str, tmp_path: Path) -> None:
    measurement(tmp_path / "run.lvm", "X_Value\tFx\tFz", delta, [f"\t{row[0]}\t{row[1]}" for row in WRENCH])
    forces(read_source(tmp_path / "run.lvm", "csv"))


@pytest.mark.parametrize("unit", ["N*m", "N·m", "Nm", "Newton-Meter"])
def test_a_measurement_of_labview_states_the_unit_of_moments(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "run.lvm"
    measurement(path, "X_Value\tFx\tMx", "0.01\t0.01", [f"\t{row[0]}\t{row[1]}" for row in WRENCH])
    path.write_text(path.read_text().replace("Newton\t\n", f"Newton\t{unit}\n"))
    imported = read_source(path, "csv")
    assert (imported.recordings.axes, imported.mapping.units) == (("Fx", "Mx"), ("N", "Nm"))


@pytest.mark.parametrize(("samples", "segments"), [(5, 4), (15, 2), (100, 3)])
def test_several_segments_of_labview_are_refused(samples: int, segments: int, tmp_path: Path) -> None:
    path, pairs = tmp_path / "run.lvm", list(zip(TIME, WRENCH, strict=True))
    parts = []
    for part in range(segments):
        rows = [f"{t}\t{row[0]}\t{row[1]}" for t, row in pairs[part * samples : (part + 1) * samples]]
        measurement(path, "X_Value\tFx\tFz", "0.01\t0.01", rows)
        parts.append(path.read_text())
    path.write_text("".join([parts[0], *(part.partition("\n\t\n")[2] for part in parts[1:])]))
    with pytest.raises(InputError, match=r"ends a further header: it holds several segments \(Multi_Headings in"):
        read_source(path, "csv")


def test_times_of_labview_before_every_signal_are_no_signals(tmp_path: Path) -> None:
    names, pairs = "X_Value\tFx\tX_Value\tFz", list(zip(TIME, WRENCH, strict=True))
    measurement(tmp_path / "run.lvm", names, "0.01\t\t0.01", [f"{t}\t{row[0]}\t{t}\t{row[1]}" for t, row in pairs])
    forces(read_source(tmp_path / "run.lvm", "csv"))
    measurement(tmp_path / "run.lvm", names, "0.01\t\t0.02", [f"{t}\t{row[0]}\t{2 * t}\t{row[1]}" for t, row in pairs])
    with pytest.raises(InputError, match=r"column X_Value.2 are not those in X_Value; save the signals of each one"):
        read_source(tmp_path / "run.lvm", "csv")


@pytest.mark.parametrize("between", ["X_Value\t", ""])
def test_a_measurement_that_labview_wrote_in_pieces_is_one(between: str, tmp_path: Path) -> None:
    """Its times start anew with each piece, which became a recording."""
    rows = [(f"{k % 20 / 100}\t", WRENCH[k]) for k in range(N)]
    lines = [f"{t}{row[0]}\t{t if between else ''}{row[1]}" for t, row in rows]
    measurement(tmp_path / "run.lvm", f"X_Value\tFx\t{between}Fz", "0.01\t0.01", lines)
    text = (tmp_path / "run.lvm").read_text()
    (tmp_path / "run.lvm").write_text(text.replace("Newton\t\tNewton", "Newton\tNewton"))
    imported = read_source(tmp_path / "run.lvm", "csv")
    assert imported.recordings.axes == ("Fx", "Fz")
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH[:, :2], rtol=1e-6)


@pytest.mark.parametrize(
    ("factor", "shift", "refused"), [(2, 0, True), (1, 0.2, True), (1, 0, False), (1, 1e-3, False)]
)
def test_signals_with_times_of_their_own_are_refused(factor: int, shift: float, refused: bool, tmp_path: Path) -> None:
    path, columns = tmp_path / "run.csv", (TIME, WRENCH[:, 0], factor * TIME + shift, WRENCH[:, 3])
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header="Time,Fx [N],Time,Mx [Nm]", comments="")
    if refused:
        with pytest.raises(InputError, match=r"the times in column Time\.2 are not those in Time; save the signals of"):
            read_source(path)
    else:
        assert read_source(path).recordings.axes == ("Fx", "Mx")
    columns = (TIME, factor * TIME + shift, *WRENCH.T[:2])
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header="Time,Time,Fx [N],Fy [N]", comments="")
    assert len(read_source(path).recordings) == 1  # both are of all signals


@pytest.mark.parametrize("kind", ["auto", "csv"])
@pytest.mark.parametrize("name", ["run.xlsx", "run.xls", "run.ods"])
def test_a_workbook_is_to_be_saved_as_csv(name: str, kind: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    for source in (tmp_path, tmp_path / name):
        with pytest.raises(InputError, match=r"as CSV, each as a file\.$"):
            read_source(source, kind)


def test_messages_that_a_terminal_shows_are_no_table(tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_text("header:\n  stamp:\n    sec: 5\n    nanosec: 7\n  frame_id: tool0\n---\n" * 9)
    with pytest.raises(InputError, match="print them with --csv, or record a bag"):
        read_source(tmp_path / "run.txt", "csv")


def test_bars_between_cells_and_a_dash_for_a_missing_value(tmp_path: Path) -> None:
    rows = [
        f"{t} | {'--' if k == 7 else row[0]} | {row[1]}" for k, (t, row) in enumerate(zip(TIME, WRENCH, strict=True))
    ]
    (tmp_path / "run.csv").write_text("\n".join(["time|Fx|Fz|", "s|N|N|", *(f"{row}|" for row in rows)]))
    imported = read_source(tmp_path)
    assert (imported.mapping.units, imported.recordings.note[0]) == (("N", "N"), "missing:1")
    np.testing.assert_allclose(imported.recordings.wrench[0, :, 1], WRENCH[:, 1], rtol=1e-6)


def test_a_dash_is_no_unit(tmp_path: Path) -> None:
    rows = [f"{t},{row[0]},{row[1]},1" for t, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time,Fx,Fz,valid", "s,N,N,-", *rows]))
    assert read_source(tmp_path).mapping.units[:2] == ("N", "N")


def test_a_torque_without_an_axis_is_no_time(tmp_path: Path) -> None:
    rows = [f"{t},{row[0]},{row[1]}" for t, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time,F,T", *rows]))
    assert read_source(tmp_path).recordings.axes == ("F", "T")


def test_text_of_two_bytes_without_a_mark_is_to_be_saved_again(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_bytes("t,Fz\n0,1\n1,2\n".encode("utf-16-le"))
    with pytest.raises(InputError, match="or save it as UTF-8"):
        read_source(tmp_path)


def test_nan_in_a_column_of_text_is_missing(tmp_path: Path) -> None:
    """As pandas and NumPy write it: it was a label, and made a constant text annotations."""
    cells = [("nan", "NaN") if k < 10 else ("push", "A") for k in range(40)]
    rows = [f"{k * 0.01:.2f},{k % 7},{phase},{part}" for k, (phase, part) in enumerate(cells)]
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz,phase,part", *rows]))
    recordings = read_source(tmp_path / "a.csv").recordings
    assert recordings.annotations.labels == {"phase": ("push",)}
    assert recordings.annotations.start.tolist() == [pytest.approx(0.1)]
    assert recordings.columns["part"].tolist() == ["A"]


def test_a_person_may_be_called_nan(tmp_path: Path) -> None:
    """It was missing."""
    rows = [f"{k * 0.01:.2f},{k % 7},{'Nan' if k < 40 else 'Eva'},{1 + k // 40}" for k in range(80)]
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz,operator,trial", *rows]))
    assert read_source(tmp_path).recordings.columns["operator"].tolist() == ["Nan", "Eva"]
