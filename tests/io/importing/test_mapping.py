"""The mapping file: what is written is read back, and what is wrong in it is one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.guess import guess
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Channel, Mapping, Track, Value, check, read_mapping, write_mapping
from rcbht_jax.io.importing.record import records
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import of_numbers

TEXT = st.text(max_size=12)
NAME = st.text(min_size=1, max_size=12)
NUMBER = st.floats(-1e6, 1e6)
WORDS = st.dictionaries(TEXT, TEXT, max_size=3)


@given(
    st.lists(st.tuples(NAME, NAME, TEXT, NUMBER, NUMBER), max_size=4, unique_by=lambda row: row[1]),
    st.lists(st.tuples(NAME, NAME, WORDS, st.lists(TEXT, max_size=2)), max_size=3),
    st.dictionaries(NAME, st.tuples(NAME, WORDS), max_size=3),
    st.lists(TEXT, min_size=5, max_size=5),
    st.none() | st.floats(1, 1e4),
)
def test_a_mapping_comes_back_equal(
    tmp_path_factory: pytest.TempPathFactory,
    channels: list,
    tracks: list,
    columns: dict,
    texts: list,
    rate: float | None,
) -> None:
    time, nanoseconds, topic, group, table = texts
    nanoseconds = nanoseconds if time else ""
    mapping = Mapping(
        tuple(Channel(*row) for row in channels), time, "ms", nanoseconds, rate, topic, group,
        tuple(Track(name, column, words=words, ignore=tuple(ignore)) for name, column, words, ignore in tracks),
        {name: Value(value=value, words=words) for name, (value, words) in columns.items()}, table, "file", 0.5, (),
        ((0.0, 0.0, 1.0, 1.0),), rate,
    )  # fmt: skip
    path = tmp_path_factory.mktemp("map") / "a.toml"
    write_mapping(path, mapping)
    assert read_mapping(path) == mapping


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("x = ", "not a mapping in TOML"),
        ("\xff", "not a mapping in TOML"),
        ("tyme = 't'", "has no key 'tyme'; there are channels, time"),
        ("time = 3", "wrong value among time"),
        ("time_unit = 'weeks'", "unit of time is 'weeks'"),
        ("rate = -1", "rate is -1"),
        ("rate = true", "wrong value among rate"),
        ("files = '*_ft.csv'", "wrong value among files"),
        ("rate = inf", "wrong value among rate"),
        ("channels = 3", "channels is not a list"),
        ("[[channels]]\nname = 'Fz'", "missing or wrong value among name"),
        ("[[channels]]\ncolumn = 'a'\n[[channels]]\ncolumn = 'a'", "two channels have one name"),
        ("bias = [1]\n[[channels]]\ncolumn = 'a'\n[[channels]]\ncolumn = 'b'", "bias has 1 value for 2 channels"),
        ("rotation = [[1, 0], [0, 1]]", "neither three rows"),
        ("rotation = [[0, 0, 0, 0]]", "neither three rows"),
        ("rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "is not a rotation"),
        ("[[annotations]]\ntrack = 'a'", "needs a column, a file, ends and ids, or starts"),
        ("[[annotations]]\ntrack = 'a'\ncolumn = 'b'\nclock = 'sun'", "expected start or stamps"),
        ("[columns.outcome]", "needs a column, a table, a value or a folder"),
        ("[columns.outcome]\ntable = 'x'", "the mapping names none"),
        ("[columns]\noutcome = 3", "columns.outcome: 3 is not a table"),
        ("[columns.outcome]\nvalue = 'x'\nwords = 3", "wrong value among value, words"),
    ],
)
def test_a_wrong_mapping_is_one_sentence(tmp_path: Path, content: str, sentence: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=sentence) as caught:
        read_mapping(path)
    assert str(path) in str(caught.value)


def test_every_example_is_a_mapping() -> None:
    files = sorted((Path(__file__).parents[3] / "examples" / "mappings").glob("*.toml"))
    assert len(files) >= 4
    for path in files:
        assert check(read_mapping(path)).channels


def test_scale_bias_tare_and_rotation() -> None:
    time = np.arange(100) * 0.01
    columns = {"t": time, "fx": np.full(100, 1000.0), "fy": np.where(time < 0.5, 2000.0, 5000.0), "fz": np.zeros(100)}
    channels = (Channel("fx", "Fx", "N", 0.001, 1.0), Channel("fy", "Fy", "N", 0.001), Channel("fz", "Fz", "N"))
    quarter = ((0.0, 0.0, 1.0, 1.0),)  # a quarter turn about z
    mapping = Mapping(channels, time="t", bias=(1.0, 0.0, 0.0), tare=0.3, rotation=quarter)
    [record] = records(Table("a", columns), mapping)
    np.testing.assert_allclose(record.values[-1], [-3, 0, 0], atol=1e-12)
    np.testing.assert_allclose(record.values[0], 0, atol=1e-12)
    matrix = Mapping(channels, time="t", rotation=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    [record] = records(Table("a", columns), matrix)
    np.testing.assert_allclose(record.values[-1], [-5, 2, 0], atol=1e-12)
    [(_, reason)] = records(Table("a", columns), Mapping((Channel("fx"),), time="t", rotation=quarter))
    assert "a rotation needs channels named" in reason


@pytest.mark.parametrize(("rate", "seconds", "averaged"), [(20, 0.5, 10), (200, 0.5, 100), (3, 1.0, 3), (20, 0.001, 1)])
def test_a_tare_ends_before_the_sample_at_its_seconds_as_that_of_a_store(
    rate: int, seconds: float, averaged: int
) -> None:
    values = np.random.default_rng(0).normal(size=4 * rate)
    for stamps in (np.arange(4 * rate) / rate, np.round(np.arange(4 * rate) / rate, 3) + 7.7):
        mapping = Mapping((Channel("f", "Fz", "N"),), time="t", tare=seconds)
        [record] = records(Table("a", {"t": stamps, "f": values}), mapping)
        np.testing.assert_allclose(record.values[:, 0], values - values[:averaged].mean(), atol=1e-12)


def test_a_tare_of_the_whole_recording_is_reported(tmp_path: Path) -> None:
    """Such as one of 500 ms that is stated as 500 s: every recording lost its mean without a word."""
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz", *(f"{k * 0.01:.2f},{k % 7}" for k in range(40))]))
    imported = read_source(tmp_path / "a.csv", mapping=Mapping(tare=500.0))
    assert imported.report.warnings == [("a.csv", "is no longer than the tare: the mean of all of it was subtracted.")]
    assert not read_source(tmp_path / "a.csv", mapping=Mapping(tare=0.39)).report.warnings


def test_a_channel_of_text_is_refused(tmp_path: Path) -> None:
    """It was a traceback."""
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz", *(f"{k * 0.01:.2f},high" for k in range(40))]))
    for mapping in (Mapping((Channel("Fz"),)), Mapping((Channel("Fz"),), missing=(-9999.0,))):
        with pytest.raises(InputError, match=r"a\.csv: column 'Fz' is text; expected numbers"):
            read_source(tmp_path / "a.csv", mapping=mapping)


def test_a_bias_of_another_length_than_the_guessed_channels_is_refused() -> None:
    columns = {"t": np.arange(9.0), "Fx": np.ones(9), "Fy": np.ones(9), "Fz": np.ones(9)}
    for bias in ((1.0,), (1.0, 2.0)):
        mapping, _ = guess(Table("a", columns), Mapping(bias=bias))
        [(_, reason)] = records(Table("a", columns), mapping)
        assert reason == f"bias has {plural(len(bias), 'value')} for 3 channels."


def test_a_reading_that_is_held_is_noted_though_it_is_rotated() -> None:
    held = np.minimum(np.arange(100.0), 60)
    columns = {"Fx": np.zeros(100), "Fy": np.arange(100.0) ** 2, "Fz": held}
    mapping = Mapping(tuple(map(Channel, columns)), source_rate=10.0, rotation=((0.0, 0.38, 0.0, 0.92),))
    [record] = records(Table("a", columns), mapping)
    assert record.notes == ["saturated:Fz"]


def test_rows_of_each_of_many_groups_are_a_recording() -> None:
    runs = np.array(["b", "a", "c", "a", "b", "c", "c", "d", "d", "b", "a", "d"])
    columns = {"t": np.repeat(np.arange(6.0), 2), "Fz": np.arange(12.0), "run": runs}
    found = records(Table("f", columns), Mapping((Channel("Fz"),), time="t", group="run"))
    assert {record.name: record.values[:, 0].tolist() for record in found} == {
        f"f#{run}": np.flatnonzero(runs == run).tolist() for run in "abcd"
    }


def test_rows_without_a_group_are_reported() -> None:
    columns = {"t": np.arange(9.0), "Fz": np.ones(9), "run": np.array([""] * 3 + ["a"] * 6)}
    reason, record = records(Table("a", columns), Mapping((Channel("Fz"),), time="t", group="run"))
    assert (reason[1], record.name) == ("rows without a value in run belong to no recording.", "a#a")


@pytest.mark.parametrize(("one", "two"), [("1.0", "2.0"), ("01", "02"), ("1", "2")])
@pytest.mark.parametrize("source", ["column", "ids"])
def test_words_of_numbers_may_be_as_the_file_has_them(one: str, two: str, source: str, tmp_path: Path) -> None:
    rows = [f"{k / 100},{k % 7},{one if k < 20 else two},{two}" for k in range(60)]
    (tmp_path / "a.csv").write_text("\n".join(["t,Fz,step,class", *rows]))
    (tmp_path / "a.ends").write_text("0.2\n0.6\n")
    (tmp_path / "a.ids").write_text(f"{one}\n{two}\n")
    places = {"column": "step"} if source == "column" else {"ends": "{stem}.ends", "ids": "{stem}.ids"}
    words = {one: "reach", two: "push"}
    track = Track("phase", **places, words=words)
    mapping = Mapping(
        (Channel("Fz"),), time="t", annotations=(track,), columns={"outcome": Value("class", words={two: "failure"})}
    )
    recordings = read_source(tmp_path, mapping=mapping).recordings
    assert recordings.annotations.names().tolist() == ["reach", "push"]
    assert recordings.outcome.tolist() == ["failure"]
    ignoring = replace(mapping, annotations=(replace(track, words={}, ignore=(one,)),))
    assert read_source(tmp_path, mapping=ignoring).recordings.annotations.names().tolist() == ["2"]


def test_a_word_that_is_no_finite_number_stays() -> None:
    track = of_numbers(Track("phase", "p", words={"nan": "free", "1e2": "reach"}))
    assert track.words == {"nan": "free", "1e2": "reach", "100": "reach"}


@pytest.mark.parametrize(
    ("mapping", "sentence"),
    [
        (Mapping(topic="/ft"), "holds no bag, and only a bag has topics; leave out the topic /ft"),
        (Mapping(key="run"), 'key is a column of the table of recordings, and none is named; add table = "FILE.csv"'),
        (Mapping(nanoseconds="ns"), "nanoseconds are added to a time, and no column of it is named; add time"),
        (Mapping(columns={"part": Value(folder=3)}), "day1/a.csv lies in no folder 3 of the source, so no column part"),
    ],
)
def test_an_entry_without_effect_is_refused(mapping: Mapping, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "day1").mkdir()
    (tmp_path / "day1/a.csv").write_text("t,Fz\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(60)))
    with pytest.raises(InputError, match=sentence):
        read_source(tmp_path, mapping=mapping)


def test_files_and_words_without_a_folder_are_reported(tmp_path: Path) -> None:
    (tmp_path / "day1").mkdir()
    for seed, name in enumerate(("a.csv", "day1/b.csv")):
        rows = (f"{k / 100},{(k + seed) % 7}\n" for k in range(60))
        (tmp_path / name).write_text("t,Fz\n" + "".join(rows))
    columns = {"part": Value(folder=1, words={"day1": "first", "day2": "second"})}
    imported = read_source(tmp_path, mapping=Mapping(columns=columns))
    assert imported.recordings.columns["part"].tolist() == ["", "first"]
    assert imported.report.warnings == [("a.csv", "lies in no folder 1 of the source, so no column part.")]
    assert "These words of the map for column part are no folders: 'day2'." in imported.report.remarks
