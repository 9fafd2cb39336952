"""Files of several cases as text: .ts of aeon and sktime, and the blocks of UCI "Robot Execution Failures"."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Channel, Mapping, Value

RATE = Mapping(source_rate=50.0)
BLOCKS = """collision_in_part
\t-1\t0\t63\t-3\t-1\t0
\t2\t0\t62\t-3\t-1\t0
\t2\t1\t60\t-3\t-1\t0


normal
\t0\t0\t1\t0\t0\t0
\t0\t0\t2\t0\t0\t1
"""
HEAD = """# of another laboratory
@problemName pokes
@timeStamps false
@missing true
@univariate false
@dimension 2
@equalLength false
@classLabel true soft hard

@data
"""


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_blocks_below_their_class(tmp_path: Path) -> None:
    path = write(tmp_path, "lp.data", BLOCKS)
    recordings = read_source(path, "uci", RATE).recordings
    assert recordings.columns["class"].tolist() == ["collision_in_part", "normal"]
    assert recordings.trial.tolist() == ["lp-0", "lp-1"]
    assert recordings.axes == ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    assert recordings.units == ("",) * 6
    assert recordings.length.tolist() == [3, 2]
    assert recordings.wrench[0].tolist() == [[-1, 0, 63, -3, -1, 0], [2, 0, 62, -3, -1, 0], [2, 1, 60, -3, -1, 0]]
    words = {"normal": "success", "collision_in_part": "failure"}
    stated = Mapping(source_rate=50.0, columns={"outcome": Value("class", words=words)})
    assert read_source(tmp_path, "uci", stated).recordings.outcome.tolist() == ["failure", "success"]


def test_a_case_per_line(tmp_path: Path) -> None:
    path = write(tmp_path, "pokes_TRAIN.ts", HEAD + "1,2,3.5:0,?,-1e-1:hard\n\n1,1:0,0.25:soft\n")
    recordings = read_source(path, "auto", RATE).recordings
    assert recordings.columns["class"].tolist() == ["hard", "soft"]
    assert recordings.axes == ("dim_0", "dim_1")
    np.testing.assert_allclose(recordings.wrench[0], [[1, 0], [2, -0.05], [3.5, -0.1]])  # what is missing is between
    assert recordings.length.tolist() == [3, 2]
    named = Mapping((Channel("dim_1", "Fz", "N"),), source_rate=50.0)
    assert read_source(tmp_path, "ts", named).recordings.axes == ("Fz",)


def test_targets_are_numbers(tmp_path: Path) -> None:
    path = write(tmp_path, "load.ts", "@targetLabel true\n@data\n1,2,3:0.5\n3,2,1:-2\n")
    assert read_source(path, "ts", RATE).recordings.columns["target"].tolist() == [0.5, -2.0]


@pytest.mark.parametrize(("name", "kind", "text"), [("a.data", "uci", BLOCKS), ("a.ts", "ts", "@data\n1,2\n")])
def test_the_rate_is_asked_for(tmp_path: Path, name: str, kind: str, text: str) -> None:
    with pytest.raises(InputError, match=r"no column of time; name it in a map, or give --source-rate\.$"):
        read_source(write(tmp_path, name, text), kind)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("@timeStamps true\n@data\n(0,1.5),(1,2.5):soft\n", "has values with time stamps, which are not read; write"),
        ("@data\n(0,1.5),(1,2.5)\n", "dimension 0 is not a number but one with its time stamp; write it without."),
        ("1,2,3\n", "line 1: expected a line that begins with @, and @data before the cases."),
        ("@problemName none\n", "has no line @data"),
        (HEAD, "has no case below @data."),
        (HEAD + "1,2:1,2:soft\n1,2:1,2:firm\n", "line 12: the class 'firm' is not one of @classLabel, soft, hard."),
        (HEAD + "1,2:soft\n", "line 11: the case has 1 dimensions; expected 2."),
        (HEAD + "1,2:1,2,3:soft\n", "line 11: the dimensions have 2 to 3 values."),
        ("@seriesLength 3\n@data\n1,2\n", "line 3: the case has 2 values; expected 3."),
        ("@data\n1,2,3:1,x,3\n", "line 2: a value of dimension 1 is not a number."),
        ("@data\n1,,2\n", "line 2: a value of dimension 0 is not a number."),
        ("@data\n1,2\r1,2\n", "line 2: a value of dimension 0 is not a number."),
        ("@data\n1\r2\n", "line 2: a value of dimension 0 is not a number."),
        ("@targetLabel true\n@data\n1,2:much\n", "line 3: the target 'much' is not a number."),
    ],
)
def test_a_ts_file_that_contradicts_itself_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        read_source(write(tmp_path, "a.ts", text), "ts", RATE)
    assert reason in str(caught.value)
    assert str(caught.value).endswith(".")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BLOCKS + "\t1\t2\n", "line 10 is neither a class nor, below one, a row of six numbers."),
        ("\t1\t2\t3\t4\t5\t6\n", "line 1 is neither a class nor"),
        ("normal\ncollision\n\t1\t2\t3\t4\t5\t6\n", "no row of six numbers follows the line 'normal'."),
        (BLOCKS + "normal\n", "no row of six numbers follows the line 'normal'."),
        ("\n\n", "is empty; expected lines with a class"),
    ],
)
def test_blocks_that_are_none_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        read_source(write(tmp_path, "a.data", text), "uci", RATE)
    assert reason in str(caught.value)


def test_a_table_reader_that_meets_blocks_names_their_reader(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="rcbht import uci"):
        read_source(write(tmp_path, "lp.data", BLOCKS), "csv")
