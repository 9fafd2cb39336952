"""Times as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util.columns import SECONDS
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.clock import seconds_of, since_epoch
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.timing import with_time


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["2024-05-01T12:00:00.000001", "2024-05-01T12:00:00.250001"], [0, 0.25]),
        (["2024-10-27T02:59:59.5+02:00[Europe/Berlin]", "2024-10-27T02:00:00+01:00[Europe/Berlin]"], [0, 0.5]),
        (["2024-05-01 11:59:59.5 AM", "2024-05-01 12:00:00.5 PM"], [0, 1]),
        (["2024-05-01 23:59:59Z", "2024-05-02 00:00:00.5Z"], [0, 1.5]),
        (["2024-05-01T12:00:00+02:00", "2024-05-01T12:00:01+02:00"], [0, 1]),
        (["2024-05-01 12:00:00,125", "2024-05-01 12:00:01,25"], [0, 1.125]),
        (["2024-10-27T02:59:59+02:00", "2024-10-27T02:00:01+0100", "2024-10-27T01:00:02Z"], [0, 2, 3]),
        (["2024-10-27T12:00:00-03", "2024-10-27T15:00:01Z"], [0, 1]),
        (["00:00:59.5", "", "00:01:00,25"], [0, np.nan, 0.75]),
        (["1/5/2024 11:59:59 am", "1/5/2024 12:00:00 pm", "1/5/2024 12:00:01 PM"], [0, 1, 2]),
        (["31.12.2024 23:59:59.900", "01.01.2025 00:00:00.100"], [0, 0.2]),
        (["23:59:59", "00:00:01", "23:59:58"], [0, 2, -1]),  # the last one is only out of order
        (["20:00:00", "10:00:00", "20:00:00", "07:00:00"], [0, -36000, 0, 39600]),  # 10 h are out of order, 13 a night
        (["09:30:00:050", "09:30:01:000"], [0, 0.95]),
        (["00:59.950", "01:00.000"], [0, 0.05]),
        (["", ""], [np.nan, np.nan]),
        ([], []),
    ],
)
def test_times(texts: list[str], seconds: list[float]) -> None:
    np.testing.assert_allclose(seconds_of(texts), seconds, atol=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "noon",
        "25:00:00",
        "13:00:00 PM",
        "00:61:00",
        "12",
        "12:30",
        "5 parsecs",
        "00:00:00:5",
        "2024-13-01T00:00:00",
        "2024-05-01 12:00:00.5 CEST",
    ],
)
@pytest.mark.filterwarnings("error")  # NumPy warned of zones
def test_no_times(text: str) -> None:
    for texts in ([text], ["0.5 s", text]):
        with pytest.raises(ValueError):
            seconds_of(texts)


def test_times_by_themselves_are_counted_in_utc() -> None:
    texts = ["1970-01-01T02:00:00.5+02:00", "1969-12-31 23:30:00-00:30", "1970-01-01T00:00:01Z"]
    assert since_epoch(texts).tolist() == [0.5, 0.0, 1.0]


def test_a_table_whose_time_is_a_time_of_day(tmp_path: Path) -> None:
    rows = [f"5/1/2024,13:59:{59 + row / 100:06.3f},{row}" for row in range(100)]
    rows += [f"5/1/2024,14:00:{row / 100:06.3f},{row}" for row in range(100)]
    (tmp_path / "run.csv").write_text("\n".join(["Date,Time,Fz", *rows]))
    recordings = read_source(tmp_path / "run.csv").recordings
    assert (recordings.dt, recordings.length.tolist()) == (0.01, [200])


def test_a_time_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("time,Fz\nnoon,1\nlater,2\n")
    how = "write 2026-05-01T12:00:00.5 or numbers, or give --source-rate, which replaces them"
    with pytest.raises(InputError, match=f"column 'time' holds 'noon', which is not a time; {how}"):
        read_source(tmp_path / "run.csv")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *((name, "ms") for name in ("time_msec", "t_millis", "timeMs", "Time ms", "time-ms", "timestamp_milliseconds")),
        ("time_micros", "us"), ("time_min", "min"), ("elapsed_minutes", "min"), ("Time hours", "h"),
    ],
)  # fmt: skip
def test_a_time_and_a_unit_in_words_are_a_time_in_it(name: str, unit: str, tmp_path: Path) -> None:
    """A log at 4 kHz in time_msec was read as one at 4 Hz, one in minutes 60 times too fast, whole ms as no time."""
    for rate in (1000, 4000):
        rows = (f"{k / rate / SECONDS[unit]:.9g},{k % 7}" for k in range(100))
        (tmp_path / "a.csv").write_text("\n".join([f"{name},Fz", *rows]))
        imported = read_source(tmp_path / "a.csv")
        assert (imported.mapping.time, imported.mapping.time_unit) == (name, unit)
        assert 1 / imported.recordings.dt == pytest.approx(rate)


@pytest.mark.parametrize("names", [("time_nsec", "time_sec"), ("time_sec", "time_nsec"), ("time_sec", "time_usec")])
def test_seconds_and_their_rest_stay_one_time(names: tuple[str, str], tmp_path: Path) -> None:
    scale = {
        "time_sec": lambda k: k // 100,
        "time_nsec": lambda k: k % 100 * 10**7,
        "time_usec": lambda k: k % 100 * 10**4,
    }
    rows = (",".join(str(scale[name](k)) for name in names) + f",{k % 7}" for k in range(250))
    (tmp_path / "a.csv").write_text("\n".join([",".join(names) + ",Fz", *rows]))
    assert read_source(tmp_path / "a.csv").recordings.dt == pytest.approx(0.01)


def test_the_unit_of_times_is_found_where_the_newest_comes_first() -> None:
    for times in (np.arange(50) * 4.0, np.arange(50)[::-1] * 4.0):
        assert with_time(Table("a.csv", {"time": times, "Fz": times}), Mapping(), ["time", "Fz"]).time_unit == "ms"
