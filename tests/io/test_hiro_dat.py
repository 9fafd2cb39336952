"""The table parser: everything malformed is one InputError that names file and line."""

from __future__ import annotations

import re
import tempfile
import time
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given
from jaxtyping import TypeCheckError

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat

GOOD = b"".join(b"%g\t1 \t2 \t3 \t.1 \t-.2 \t3e-1 \t\r\n" % (k * 0.005) for k in range(20))


def table(path: Path, content: bytes) -> dat.TimedTable:
    path.write_bytes(content)
    return dat.read_timed(path, "wrench")


def test_tabs_crlf_and_blank_lines_are_read(tmp_path: Path) -> None:
    read = table(tmp_path / "t.dat", b"\r\n" + GOOD.replace(b"0.05\t", b"\n  \n0.05\t") + b"\n\n")
    assert read.dt == pytest.approx(0.005)
    np.testing.assert_allclose(read.time, np.arange(20) * 0.005)
    np.testing.assert_array_equal(read.values, np.tile([1, 2, 3, 0.1, -0.2, 0.3], (20, 1)))


def edit(line: int, old: bytes, new: bytes) -> bytes:
    """GOOD with one line (from 1) changed."""
    lines = GOOD.split(b"\n")
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    return b"\n".join(lines)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "is empty"),
        (b" \r\n\t\n", "is empty"),
        (b"0 1 2 3 4 5 6\n", "one line"),
        (edit(7, b"3 \t.1 \t-.2 \t3e-1 \t\r", b""), "line 7: 3 columns; expected 7. Is the line cut off?"),
        (edit(4, b"1 \t", b"1 9 \t"), "line 4: 8 columns; expected 7. Is the line cut off?"),
        (
            b"0 1 2 3 4 5 6 7 8\n" * 2,
            "line 1: 9 columns; expected 7, of HIRO; read another table with",
        ),
        (GOOD[:-10], "line 20: 6 columns"),
        (edit(3, b"2 ", b"two "), "line 3: 'two' is not a number"),
        (edit(3, b"2 ", b"1_0 "), "line 3: '1_0' is not a number"),
        (edit(3, b"2 ", b"# 2 "), "line 3: '#' is not a number"),
        (edit(3, b"2 ", b"\x00\xff\xfe "), r"line 3: '\\x00\\xff\\xfe' is not a number"),
        (edit(5, b"2 ", b"nan "), "line 5, column 3: the value is nan"),
        (edit(5, b"3e-1", b"-inf"), "line 5, column 7: the value is -inf"),
        (edit(5, b"2 ", b"1e999 "), "line 5, column 3: the value is inf"),
        (edit(9, b"0.04", b"0.03"), "line 9: time 0.03 s does not come after 0.035 s"),
        (edit(9, b"0.04", b"0.035"), "line 9: time 0.035 s does not come after 0.035 s"),
        (edit(9, b"0.04", b"0.042"), "line 9: the time step is 0.007 s where the file's is 0.005 s"),
        (b"0 1 2 3 4 5 6\n5 1 2 3 4 5 6\n10 1 2 3 4 5 6", "time step is 5 s.*Is the time in seconds"),
        (b"0 1 2 3 4 5 6\n1e-5 1 2 3 4 5 6", "time step is 1e-05 s.*Is the time in seconds"),
        (edit(12, b"2 ", b"-200000 "), "line 12, column 3: -200000 is too large for wrench.*newtons"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "line 1: .* is not a number"),
    ],
)
def test_malformed_tables_name_file_and_line(tmp_path: Path, content: bytes, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        table(tmp_path / "R_Torques.dat", content)
    assert str(tmp_path / "R_Torques.dat") in str(caught.value)


def test_line_numbers_count_blank_lines(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 11, column 3"):
        table(tmp_path / "t.dat", b"\n\n\n" + edit(8, b"2 ", b"nan "))


def test_other_quantities_have_their_own_limits(tmp_path: Path) -> None:
    path = tmp_path / "R_Angles.dat"
    path.write_bytes(edit(6, b"2 ", b"45 "))
    with pytest.raises(InputError, match="radians, not degrees"):
        dat.read_timed(path, "joint angles")
    with pytest.raises(InputError, match="not millimetres"):
        dat.read_timed(path, "pose")


def test_missing_folder_and_huge_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        dat.read_table(tmp_path / "missing.dat", 7)
    with pytest.raises(InputError, match="not a regular file"):
        dat.read_table(tmp_path, 7)
    (tmp_path / "big.dat").write_bytes(GOOD)
    monkeypatch.setattr(dat, "MAX_TEXT_BYTES", 100)
    with pytest.raises(InputError, match=r"has \d+ bytes; expected at most 100"):
        dat.read_timed(tmp_path / "big.dat", "wrench")


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", []), (b"\n", []), (b"0.0\n3.6", [0, 3.6]), (b"0\r\n2.655\r\n5.145\r\n", [0, 2.655, 5.145])],
)
def test_state_times(tmp_path: Path, content: bytes, expected: list[float]) -> None:
    (tmp_path / "R_State.dat").write_bytes(content)
    assert dat.read_state_times(tmp_path / "R_State.dat").tolist() == expected


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"0\n3\n2\n", "line 3: state time 2 s does not come after 3 s"),
        (b"0\n\n3\n3\n", "line 4: state time 3 s does not come after 3 s"),
        (b"0 1\n", "line 1: 2 columns; expected 1"),
        (b"0\nabc\n", "line 2: 'abc' is not a number"),
        (b"0\nnan\n", "line 2, column 1: the value is nan"),
    ],
)
def test_malformed_state_times(tmp_path: Path, content: bytes, sentence: str) -> None:
    (tmp_path / "R_State.dat").write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        dat.read_state_times(tmp_path / "R_State.dat")


TOKENS = st.sampled_from(
    [
        b"0",
        b"1",
        b"0.005",
        b"-1e3",
        b"nan",
        b"inf",
        b"1e999",
        b"x",
        b"\t",
        b" ",
        b"\n",
        b"\r",
        b"\r\n",
        b"\x0b",
        b"\x1c",
    ]
)


def outcome(content: bytes) -> np.ndarray | None:
    """What the parser makes of bytes: a finite table, or None for an InputError; anything else escapes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.dat"
        path.write_bytes(content)
        problems = []
        values = None
        try:
            dat.read_state_times(path)
        except InputError as error:
            problems.append(str(error))
        try:
            values = dat.read_timed(path, "wrench").values
        except InputError as error:
            problems.append(str(error))
    assert all(re.search(r"[.?]$", problem) for problem in problems), problems
    return values


@given(st.one_of(st.binary(max_size=300), st.lists(TOKENS, max_size=60).map(b"".join)))
@example(b"1\x1c2")
@example(b"\xef\xbb\xbf0")
def test_any_bytes_give_a_table_or_an_input_error(content: bytes) -> None:
    values = outcome(content)
    assert values is None or np.isfinite(values).all()


@given(position=st.integers(0, len(GOOD) - 1), byte=st.integers(0, 255))
def test_any_flipped_byte_gives_a_table_or_an_input_error(position: int, byte: int) -> None:
    values = outcome(GOOD[:position] + bytes([byte]) + GOOD[position + 1 :])
    assert values is None or np.isfinite(values).all()


@given(rows=st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 6), min_size=2, max_size=20))
def test_written_numbers_come_back_exactly(rows: list[tuple[float, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.dat"
        path.write_text("".join(f"{k * 0.005!r} {' '.join(map(repr, row))}\n" for k, row in enumerate(rows)))
        np.testing.assert_array_equal(dat.read_timed(path, "wrench").values, np.array(rows))


def test_annotations_are_checked_at_run_time_under_pytest() -> None:
    with pytest.raises(TypeCheckError):
        dat.read_table("a string, not a path", 7)  # type: ignore[arg-type]


def test_bulk_reading_is_fast(tmp_path: Path) -> None:
    # 94 MB must import in less than 45 s: 2 MB/s; the bulk path is 20 times faster than that.
    path = tmp_path / "t.dat"
    path.write_bytes(
        b"".join(b"%.3f\t1.23456 \t-2.34567e-05 \t3 \t0.1 \t-0.2 \t0.3 \t\n" % (k * 0.005) for k in range(40000))
    )
    start = time.perf_counter()
    dat.read_timed(path, "wrench")
    assert path.stat().st_size / (time.perf_counter() - start) > 2e6
