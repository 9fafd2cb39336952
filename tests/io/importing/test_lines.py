"""Tables as text: line ends, lines of names, lines that are no samples, numbers and encodings as people write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.cells import delimiter_of, split
from rcbht_jax.io.importing.importer import Imported, read_source

N = 40
TIME = np.arange(N) * 0.01
WRENCH = np.random.default_rng(0).normal(size=(N, 6)).round(3) * 100
UNITS = ("s", *"NNN", *("Nm",) * 3)
HEAD = "t,Fx,Fy,Fz,Mx,My,Mz\n"
ROWS = "".join(
    ",".join(f"{value:.6g}" for value in (time, *row)) + "\n" for time, row in zip(TIME, WRENCH, strict=True)
)


def read(tmp_path: Path, text: str, encoding: str = "utf-8", name: str = "run.csv") -> Imported:
    (tmp_path / name).write_bytes(text.encode(encoding))
    return read_source(tmp_path / name)


def same(imported: Imported, note: str = "") -> None:
    recordings = imported.recordings
    assert recordings.axes == ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    assert recordings.note.tolist() == [note]
    assert recordings.dt == 0.01
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, rtol=1e-6)


@pytest.mark.parametrize("end", ["\r\n", "\r\r\n"])
@pytest.mark.parametrize("text", [HEAD + ROWS, "robot,A\n\n" + HEAD + ROWS])
def test_lines_may_end_as_on_any_computer(end: str, text: str, tmp_path: Path) -> None:
    imported = read(tmp_path, text.replace("\n", end))
    same(imported, "preamble:2" if text[0] == "r" and end != "\r\r\n" else imported.recordings.note[0])


def test_lines_that_end_in_carriage_returns_alone_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a table whose lines end in line feeds"):
        read(tmp_path, (HEAD + ROWS).replace("\n", "\r"))


@pytest.mark.parametrize(
    ("below", "left"),
    [
        ("mean,1,2,3,4,5,6\nmax,1,2,3,4,5,6\n", ["mean", "max"]),
        ("\n,,,,,,\nMittelwert,1,2,3,4,5,6,\n", ["Mittelwert"]),
        ("\nEnd of file\n", ["End of file"]),
        ("# 40 samples, no error\n", ["# 40 samples"]),
        ("peak force,300\n", ["peak force"]),
    ],
)
@pytest.mark.parametrize("before", ["", "robot,A\n\n"])
def test_words_below_the_last_row_are_left_out_and_told(
    before: str, below: str, left: list[str], tmp_path: Path
) -> None:
    imported = read(tmp_path, before + HEAD + ROWS + below)
    same(imported, ";".join(["preamble:2"] * bool(before) + [f"lines:{len(left)}"]))
    assert f"Lines that are no samples were left out: {', '.join(map(repr, left))}." in imported.report.remarks


def test_words_below_dates_are_left_out_and_one_among_them_is_named(tmp_path: Path) -> None:
    rows = [f"2026-05-01T12:00:00.{10 * k:03},{k % 7}\n" for k in range(30)]
    imported = read(tmp_path, "".join(["time,Fz\n", *rows, "mean,3\n"]))
    assert (imported.recordings.length.tolist(), imported.recordings.note.tolist()) == ([30], ["lines:1"])
    with pytest.raises(InputError, match="column 'time' holds 'noon', which is not a time"):
        read(tmp_path, "".join(["time,Fz\n", *rows[:9], "noon,3\n", *rows[9:]]))


@pytest.mark.parametrize(
    ("below", "sentence"),
    [("0.4,1,2\n", "line 42: 3 cells; expected 7"), ("mean,1,2,3,4,5,6\n" + ROWS[:2000], "'mean' is not a number")],
)
def test_a_line_cut_off_and_a_word_among_rows_remain_mistakes(below: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, HEAD + ROWS + below)


def test_a_first_column_that_is_one_of_words_loses_no_row(tmp_path: Path) -> None:
    rows = "".join(f"{k if k < 3 else f'A{k}'},{k / 100},{k % 7}\n" for k in range(30))
    imported = read(tmp_path, "mark,t,Fz\n" + rows)
    assert (imported.recordings.length.tolist(), imported.recordings.note.tolist()) == ([30], [""])


def test_many_rows_that_end_a_table_are_not_left_out_for_a_word(tmp_path: Path) -> None:
    rows = "".join(f"{k if k < 80 else f'A{k}'},{k / 100},{k % 7}\n" for k in range(100))
    with pytest.raises(InputError, match="line 82, column mark: 'A80' is not a number"):
        read(tmp_path, "mark,t,Fz\n" + rows)


def test_names_that_a_program_wrote_again_begin_a_recording(tmp_path: Path) -> None:
    recordings = read(tmp_path, HEAD + ROWS + HEAD + ROWS.replace(",-", ",-1")).recordings
    assert recordings.length.tolist() == [N, N]
    assert recordings.note.tolist() == ["lines:1;restarts:1"] * 2


@pytest.mark.parametrize(
    "head",
    [
        ",force,force,force,torque,torque,torque\n,x,y,z,x,y,z\ntime,,,,,,\n",
        "quantity,force,force,force,torque,torque,torque\naxis,x,y,z,x,y,z\ntime,,,,,,\n",
        "Time,Force,,,Torque,,\ns,Fx,Fy,Fz,Mx,My,Mz\n",
        "Time,Force,,,Torque,,\n,x,y,z,x,y,z\n[s],[N],[N],[N],[Nm],[Nm],[Nm]\n",
        "Channel,CH1,CH2,CH3,CH4,CH5,CH6\nTime,Fx,Fy,Fz,Tx,Ty,Tz\n",
    ],
)
@pytest.mark.parametrize("before", ["", "robot,A\n\n"])
def test_names_in_several_lines(before: str, head: str, tmp_path: Path) -> None:
    imported = read(tmp_path, before + head + ROWS)
    same(imported, "preamble:2" if before else "")
    assert imported.mapping.units == (("N",) * 3 + ("Nm",) * 3 if "[N]" in head else ("",) * 6)


def test_an_index_without_a_name_below_lines_of_a_logger(tmp_path: Path) -> None:
    rows = "".join(f"{number},{row}\n" for number, row in enumerate(ROWS.split()))
    same(read(tmp_path, "robot,A\n\n," + HEAD + rows), "preamble:2")


def test_units_after_blanks_belong_to_their_names(tmp_path: Path) -> None:
    head = "  t (s)   Fx (N)  Fy (N)  Fz (N)  Mx (N-m)  My (N-m)  Mz (N-m)\n"
    imported = read(tmp_path, head + ROWS.replace(",", "   "))
    same(imported)
    assert imported.mapping.units == ("N",) * 3 + ("Nm",) * 3


POINTS = str.maketrans(",.", ".,")


@pytest.mark.parametrize(
    ("delimiter", "write"),
    [
        (",", lambda value: f'"{value:,.2f}"'),
        ("\t", lambda value: f"{value:,.2f}"),
        (";", lambda value: f"{value:,.2f}".translate(POINTS)),
        (";", lambda value: f"{value:,.2f}".replace(",", "\u202f").replace(".", ",")),
        (";", lambda value: f"{value:,.2f}".replace(",", "'")),
        (",", lambda value: f'"{value:,.2f}"'.replace(",", " ").replace(".", ",")),
        (";", lambda value: (f"{value:,.0f}" if value == round(value) else f"{value:,.2f}").translate(POINTS)),
    ],
)
def test_marks_between_thousands_are_no_decimal_ones(delimiter: str, write: object, tmp_path: Path) -> None:
    values = np.append(WRENCH[:, 0] * 50, [1000.0, 1.0, -123456.5, 1234567.25])
    rows = (f"{k * 10}{delimiter}{write(value)}\n" for k, value in enumerate(values.tolist()))  # type: ignore[operator]
    imported = read(tmp_path, "".join([f"t [ms]{delimiter}Fz\n", *rows]))
    np.testing.assert_allclose(imported.recordings.wrench[0, :, 0], values, rtol=1e-6)


@pytest.mark.parametrize(("delimiter", "mark"), [(";", ","), (",", ","), (";", "."), ("\t", ".")])
@pytest.mark.parametrize("phase", ["", "free"])
def test_a_number_that_may_mean_two_is_refused(delimiter: str, mark: str, phase: str, tmp_path: Path) -> None:
    cells = ((f"{k * 10}", f'"{990 + 4 * k:,}"'.replace(",", mark), phase) for k in range(20))
    rows = "\n".join(delimiter.join(filter(None, row)) for row in cells)
    rows = rows if mark == "," else rows.replace('"', "")
    head = delimiter.join(filter(None, ("t [ms]", "Fz", phase and "phase")))
    with pytest.raises(InputError, match=r"It may mean 10\d\d or 1\.0\d\d; write numbers without marks between"):
        read(tmp_path, f"{head}\n{rows}")


@pytest.mark.parametrize("other", ["0.5", "12.25", "1234.5"])
def test_points_elsewhere_show_that_points_are_decimal_ones(other: str, tmp_path: Path) -> None:
    rows = "\n".join(f"{k * 10};{k + 1 if k % 2 else f'{k + 1:.3f}'};{other}" for k in range(20))
    recordings = read(tmp_path, f"t [ms];Fz;mass\n{rows}").recordings
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], 1 + np.arange(20))


def test_between_commas_other_columns_show_that_a_comma_is_no_decimal_one(tmp_path: Path) -> None:
    rows = "".join(f'"{990 + 10 * k:,}",{k % 7 / 10}\n' for k in range(20))
    recordings = read(tmp_path, f"t [ms],load\n{rows}").recordings
    assert (recordings.dt, recordings.length.tolist()) == (0.01, [20])


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_beside_decimal_commas_a_point_stands_between_thousands(delimiter: str, tmp_path: Path) -> None:
    cells = ((f"{990 + k * 10:,}".replace(",", "."), f'"{k % 7 / 10}"'.replace(".", ","), 996 + k) for k in range(20))
    rows = (delimiter.join((time, load, f"{force:,}".replace(",", "."))) for time, load, force in cells)
    recordings = read(tmp_path, delimiter.join(["t [ms]", "load", "Fz\n"]) + "\n".join(rows)).recordings
    assert recordings.dt == 0.01
    np.testing.assert_array_equal(recordings.wrench[0, :, 1], 996 + np.arange(20))


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_where_no_comma_is_a_decimal_one_points_are(delimiter: str, tmp_path: Path) -> None:
    rows = (f"{k / 100:.3f}{delimiter}{1 + k / 1000:.3f}{delimiter}{'free' if k < 9 else 'push'}" for k in range(20))
    recordings = read(tmp_path, delimiter.join(["t", "Fz", "phase\n"]) + "\n".join(rows)).recordings
    np.testing.assert_allclose(recordings.wrench[0, :, 0], 1 + np.arange(20) / 1000, rtol=1e-6)


@pytest.mark.parametrize("cell", ["1,234", "0,5", "-1,5e-3"])
def test_decimal_commas_remain_decimal(cell: str, tmp_path: Path) -> None:
    rows = "".join(f"{k * 10};{cell if k % 2 else '2,345'};{k}\n" for k in range(20))
    values = read(tmp_path, f"t [ms];Fz;k\n{rows}").recordings.wrench[0, :2, 0]
    np.testing.assert_allclose(values, [2.345, float(cell.replace(",", "."))], rtol=1e-6)


@pytest.mark.parametrize(("encoding", "note"), [("gb18030", "gb18030"), ("utf-8", "")])
def test_tables_of_spreadsheets_in_japan_and_china(encoding: str, note: str, tmp_path: Path) -> None:
    names = [f"{word}{axis}[{unit}]" for word, unit in (("力", "N"), ("力矩", "Nm")) for axis in "XYZ"]
    rows = "".join(f"{row},{'接近' if k < 20 else '接触'}\n" for k, row in enumerate(ROWS.split()))
    imported = read(tmp_path, ",".join(["时间[s]", *names, "状态"]) + "\n" + rows, encoding)
    same(imported, note)
    assert imported.mapping.units == ("N",) * 3 + ("Nm",) * 3
    assert imported.recordings.annotations.labels == {"状态": ("接近", "接触")}


def test_a_table_of_a_spreadsheet_in_japan(tmp_path: Path) -> None:
    rows = "".join(f"{k * 10},{k % 7},{'接近' if k < 20 else 'ワーク'}\n" for k in range(40))
    imported = read(tmp_path, "時間[ms],荷重[N],状態\n" + rows, "cp932")
    assert imported.recordings.annotations.labels == {"状態": ("接近", "ワーク")}
    assert (imported.recordings.axes, imported.mapping.units) == (("荷重",), ("N",))
    assert "1 recording is from a file that is not UTF-8, read as Shift-JIS" in imported.report.remarks[0]


@pytest.mark.parametrize("word", ["Größe", "dégénérés", "“Fügen” – …", "°µ±"])
def test_words_of_western_europe_remain_so(word: str, tmp_path: Path) -> None:
    rows = "".join(f"{k * 10},{k % 7},{word if k < 10 else 'b'}\n" for k in range(20))
    imported = read(tmp_path, f"t [ms],Fz,phase {word}\n{rows}", "cp1252")
    assert [*imported.recordings.annotations.labels.values()] == [(word, "b")]
    assert imported.recordings.note.tolist() == ["cp1252"]


@pytest.mark.parametrize("line", [b"a\rb;1,5", b'"' + b"a" * 200_000 + b";1,5"])
def test_a_line_that_is_none_of_a_table_has_a_delimiter_all_the_same(line: bytes) -> None:
    assert delimiter_of(line) == ";"
    assert split(line, ";") == [line.decode()]


@pytest.mark.parametrize("head", ["# rate: 100\n# Fx [N],Fy,Fz,Mx,My,Mz\n", "# rate: 100\nFx [N],Fy,Fz,Mx,My,Mz\n"])
@pytest.mark.parametrize("blanks", [True, False])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_comments_after_a_mark_of_the_encoding_are_comments(
    head: str, blanks: bool, encoding: str, tmp_path: Path
) -> None:
    """The rate was not found, and an axis was called "# Fx"."""
    text = head + "".join(line.partition(",")[2] + "\n" for line in ROWS.splitlines())
    imported = read(tmp_path, text.replace(",", " ") if blanks else text, encoding)
    same(imported)
    assert imported.mapping.units[0] == "N"


@pytest.mark.parametrize("day", ["", "2024-05-01 "])
def test_times_of_day_with_decimal_commas_below_lines_of_a_logger(day: str, tmp_path: Path) -> None:
    """More commas than semicolons made them the marks between cells."""
    rows = [line.replace(".", ",").split("\t") for line in ROWS.replace(",", "\t").splitlines()]
    lines = [";".join([f"{day}12:34:56,{10 * k:03}", *row[1:]]) for k, row in enumerate(rows)]
    text = "Recorder 3000\nOperator: Bob\n\n" + HEAD.replace(",", ";") + "\n".join(lines)
    same(read(tmp_path, text), "preamble:3")


def test_names_and_words_in_quotes_between_blanks(tmp_path: Path) -> None:
    names = " ".join(f'"{name}"' for name in [*HEAD.strip().split(","), "phase"])
    rows = [
        line.replace(",", " ") + (' "free air"' if k < 20 else ' "push"') for k, line in enumerate(ROWS.splitlines())
    ]
    imported = read(tmp_path, "\n".join([names, *rows]))
    same(imported)
    assert imported.recordings.annotations.names().tolist() == ["free air", "push"]


def test_a_time_that_counts_half_milliseconds_is_doubted(tmp_path: Path) -> None:
    """Stamps of 2 kHz in ms, without a unit, were those of two samples per second, without a word."""
    rows = [",".join([f"{0.5 * k}", *line.split(",")[1:]]) for k, line in enumerate(ROWS.splitlines())]
    [(_, doubt)] = read(tmp_path, HEAD + "\n".join(rows)).report.warnings
    assert doubt == "has 2 samples per second. Is the unit of time right?"


@pytest.mark.parametrize("mark", [" ", ","])
def test_names_of_rows_as_r_writes_them_are_refused_with_the_remedy(mark: str, tmp_path: Path) -> None:
    """The advice was that the first row may be cut off, where it has a cell more than the names."""
    rows = "".join(f'"{number}",{line}\n' for number, line in enumerate(ROWS.splitlines(), 1))
    with pytest.raises(InputError, match=r"line 2: 8 cells; expected 7. Are these .* row.names = FALSE"):
        read(tmp_path, (HEAD + rows).replace(",", mark))


@pytest.mark.parametrize("blank", ["\n", ",,,,,,\n", "\n\n"])
@pytest.mark.parametrize("before", ["", '"Specimen","1"\n"Test date","5/1/2026"\n\n'])
def test_a_blank_line_may_follow_that_of_units(before: str, blank: str, tmp_path: Path) -> None:
    """The units were read as the first row, and the file was refused."""
    imported = read(tmp_path, before + HEAD + '"(s)","(N)","(N)","(N)",(Nm),(Nm),(Nm)\n' + blank + ROWS)
    same(imported, "preamble:3" if before else "")
    assert imported.recordings.units == UNITS[1:]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_names_in_quotes_may_have_line_feeds(end: str, tmp_path: Path) -> None:
    """Spreadsheets write them so. The file was refused: "line 2: 6 cells; expected 2. Is the line cut off?"."""
    head = ",".join(f'"{name}\n[{unit}]"' for name, unit in zip(HEAD.strip().split(","), UNITS, strict=True))
    imported = read(tmp_path, (head + "\n" + ROWS).replace("\n", end))
    same(imported)
    assert imported.recordings.units == UNITS[1:]


@pytest.mark.parametrize("units", ["[s] [N] [N] [N] [Nm] [Nm] [Nm] -", "(s) (N) (N) (N) (Nm) (Nm) (Nm) -"])
def test_units_between_blanks_below_the_names_are_cells(units: str, tmp_path: Path) -> None:
    """Each was read as the end of the cell before it, and the file was refused."""
    rows = "".join(f"{line} free\n" for line in ROWS.replace(",", " ").splitlines())
    imported = read(tmp_path, f"{HEAD.replace(',', ' ').strip()} operator\n{units}\n{rows}")
    same(imported)
    assert imported.recordings.units == UNITS[1:]


@pytest.mark.parametrize("clock", ["12:00:{:09.6f}", "2026-05-01 12:00:{:09.6f}", "{:.2f}"])
def test_words_may_be_most_of_a_row_below_a_preamble(clock: str, tmp_path: Path) -> None:
    """The lines before the names were taken for these: "line 2: 1 cells; expected 2. Is the line cut off?"."""
    rows = [f"{clock.format(time)};{row[2]};free;true;A" for time, row in zip(TIME, WRENCH, strict=True)]
    lines = ["Operator: Ann", "Device;XY1", "time;Fz;phase;success;part", *rows]
    imported = read(tmp_path, "\n".join(lines))
    assert (imported.recordings.axes, imported.recordings.note.tolist()) == (("Fz",), ["preamble:2"])
    np.testing.assert_allclose(imported.recordings.wrench[0, :, 0], WRENCH[:, 2], rtol=1e-6)


@pytest.mark.parametrize("text", ["\x1c", "\x1f\n1.0\n2.0\n"])
def test_a_first_line_of_control_characters_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"begins with a line that holds nothing; expected a table\.$"):
        read(tmp_path, text)
