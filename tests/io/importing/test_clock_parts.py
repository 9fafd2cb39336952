"""Times whose parts stand in several columns."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.clock_parts import with_whole_times
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping, write_mapping
from rcbht_jax.io.importing.record import records
from rcbht_jax.io.importing.table import Table

N = 300  # 3 s around midnight
START = datetime.datetime(2026, 5, 1, 23, 59, 58)
STAMPS = [START + datetime.timedelta(milliseconds=10 * k) for k in range(N)]
LOADS = np.random.default_rng(0).normal(size=N).round(3)
SINCE = (START - datetime.datetime(1970, 1, 1)).total_seconds()


def write(path: Path, head: str, form: str) -> None:
    """A table with parts of the time; in ``form``, {t} is the time and {ms} and {us} are those of its second."""
    rows = (
        form.format(t=t, ms=t.microsecond // 1000, us=t.microsecond, epoch=int(SINCE) + k // 100)
        for k, t in enumerate(STAMPS)
    )
    lines = [f"{row},{load}" for row, load in zip(rows, LOADS, strict=True)]
    path.write_text("\n".join([f"{head},Fz", *lines]))


@pytest.mark.parametrize(
    ("head", "form", "dated"),
    [
        ("Date,Time,ms", "{t:%Y-%m-%d},{t:%H:%M:%S},{ms}", True),
        ("Datum,Uhrzeit,Millis", "{t:%d.%m.%Y},{t:%H:%M:%S},{ms}", True),
        ("date,time,usec", "{t:%Y/%m/%d},{t:%H:%M:%S},{us}", True),
        ("Date,Time", "{t:%Y-%m-%d},{t:%H:%M:%S.%f}", True),
        ("Date,Time", "{t:%m/%d/%Y},{t:%I:%M:%S.%f} {t:%p}", False),
        ("Date,Time,Milliseconds", "{t:%m/%d/%Y},{t:%I:%M:%S} {t:%p},{ms}", False),
        ("Time,Milliseconds", "{t:%H:%M:%S},{ms}", False),
        ("tv_sec,tv_usec", "{epoch},{us}", True),
        ("timestamp,ms", "{epoch},{ms}", True),
    ],
)
def test_parts_of_a_time_become_one(head: str, form: str, dated: bool, tmp_path: Path) -> None:
    write(tmp_path / "run.csv", head, form)
    imported = read_source(tmp_path / "run.csv")
    recordings = imported.recordings
    assert recordings.axes == ("Fz",)
    assert recordings.dt == pytest.approx(0.01)
    np.testing.assert_allclose(recordings.wrench[0, :, 0], LOADS, rtol=1e-6)
    assert set(recordings.note) == {""}
    assert recordings.annotations.names().tolist() == []
    assert imported.report.skipped == imported.report.warnings == []
    assert [row["role"] for row in imported.report.understood] == ["time", "channel Fz"]
    [record] = records(with_whole_times(table_of(tmp_path / "run.csv"), Mapping()), imported.mapping)
    assert not isinstance(record, tuple)
    assert record.origin == pytest.approx(SINCE if dated else SINCE % 86400, abs=1e-3)


def table_of(path: Path) -> Table:
    from rcbht_jax.io.importing.text import read_csv

    [table] = read_csv(path, path.name)
    return table


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ("year,month,day,hour,minute,second", "{t:%Y},{t.month},{t.day},{t.hour},{t.minute},{t:%S.%f}"),
        ("hour,min,sec,ms", "{t.hour},{t.minute},{t.second},{ms}"),
    ],
)
def test_hours_minutes_and_seconds_as_numbers_are_refused(head: str, form: str, tmp_path: Path) -> None:
    """Each minute is no recording of its own."""
    write(tmp_path / "run.csv", head, form)
    with pytest.raises(InputError, match="no column of time"):
        read_source(tmp_path / "run.csv")


def test_seconds_of_three_minutes_are_no_time(tmp_path: Path) -> None:
    """The minutes became three recordings, without a warning."""
    rows = [f"12,{k // 60},{k % 60},{k % 7}" for k in range(180)]
    (tmp_path / "run.csv").write_text("\n".join(["Hours,Minutes,Seconds,Fz", *rows]))
    with pytest.raises(InputError, match="no column of time"):
        read_source(tmp_path / "run.csv")


def test_a_mapping_that_was_saved_reads_the_parts_again(tmp_path: Path) -> None:
    write(tmp_path / "run.csv", "Date,Time,ms", "{t:%Y-%m-%d},{t:%H:%M:%S},{ms}")
    first = read_source(tmp_path / "run.csv")
    write_mapping(tmp_path / "map.toml", first.mapping)
    again = read_source(tmp_path / "run.csv", mapping=read_mapping(tmp_path / "map.toml"))
    np.testing.assert_array_equal(first.recordings.wrench, again.recordings.wrench)


def test_a_date_that_stays_the_same_describes_the_recording(tmp_path: Path) -> None:
    rows = [f"2026-05-01,10:00:{k // 100:02},{10 * (k % 100)},{load}" for k, load in enumerate(LOADS)]
    (tmp_path / "run.csv").write_text("\n".join(["Date,Time,ms,Fz", *rows]))
    assert read_source(tmp_path / "run.csv").recordings.columns["Date"].tolist() == ["2026-05-01"]


def test_columns_that_a_mapping_uses_are_not_joined() -> None:
    table = Table("a.csv", {"time": np.array(["10:00:00"] * 2), "ms": np.array([1.0, 2.0])})
    for mapping in (Mapping(time="time"), Mapping(source_rate=5.0), Mapping(group="ms")):
        assert with_whole_times(table, mapping) is table


@pytest.mark.parametrize("rest", [np.array([0.0, 1500.0, 2500.0]), np.array([0.5, 1.5, 2.5]), np.array([-1.0, 0, 1])])
def test_a_rest_that_is_not_below_a_second_is_no_part(rest: np.ndarray) -> None:
    table = Table("a.csv", {"sec": np.array([1.0, 1.0, 1.0]), "msec": rest})
    assert with_whole_times(table, Mapping()) is table


def test_infinite_seconds_are_no_part() -> None:
    table = Table("a.csv", {"sec": np.array([1.0, np.inf, np.inf]), "msec": np.arange(3.0)})
    assert with_whole_times(table, Mapping()) is table


def test_dates_that_do_not_exist_are_named(tmp_path: Path) -> None:
    rows = [f"2026-02-31,10:00:00,{k},{load}" for k, load in enumerate(LOADS)]
    (tmp_path / "run.csv").write_text("\n".join(["Date,Time,ms,Fz", *rows]))
    with pytest.raises(InputError, match="which is not a time"):
        read_source(tmp_path / "run.csv")


cell = st.one_of(st.floats(), st.integers(-5, 70).map(float), st.integers(0, 10**10).map(float))
words = st.sampled_from(
    ["date", "time", "ms", "us", "hour", "minute", "second", "year", "month", "day", "tv_sec", "tv_usec"]
)


@given(
    st.dictionaries(
        words,
        st.one_of(
            st.lists(cell, min_size=3, max_size=3), st.lists(st.text("0123:.- T", max_size=12), min_size=3, max_size=3)
        ),
        min_size=1,
    )
)
def test_no_columns_break_the_search_for_parts(columns: dict[str, list[float] | list[str]]) -> None:
    table = Table("a.csv", {name: np.array(values) for name, values in columns.items()})
    found = with_whole_times(table, Mapping())
    assert found is table or all(len(values) == 3 for values in found.columns.values())
