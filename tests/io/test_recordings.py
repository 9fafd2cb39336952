"""Data sets in memory: rows taken, sets joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.types import Recordings
from tests.support.store_cases import same, simple


@given(st.lists(st.tuples(st.integers(1, 4), st.integers(1, 60)), min_size=1, max_size=4))
def test_what_was_joined_can_be_taken_out_again(sizes: list[tuple[int, int]]) -> None:
    parts = [simple(count, samples) for count, samples in sizes]
    whole = Recordings.join(parts)
    assert len(whole) == sum(count for count, _ in sizes)
    assert whole.wrench.shape[1] == max(samples for _, samples in sizes)
    begin = 0
    for part, (count, samples) in zip(parts, sizes, strict=True):
        found = whole.take(np.arange(begin, begin + count))
        assert not found.wrench[:, samples:].any()
        same(replace(found, wrench=found.wrench[:, :samples]), part)
        begin += count


def test_a_mask_takes_the_same_rows_as_their_numbers() -> None:
    whole = simple(4)
    same(whole.take(np.array([False, True, False, True])), whole.take(np.array([1, 3])))
    assert whole.take(np.array([3, 1])).trial.tolist() == ["t3", "t1"]


def test_sets_of_other_sampling_periods_and_no_sets_cannot_be_joined() -> None:
    with pytest.raises(InputError, match="one sampling period"):
        Recordings.join([simple(), replace(simple(), dt=0.01)])
    with pytest.raises(InputError, match="none"):
        Recordings.join([])


def test_columns_of_every_kind_are_joined_and_empty_where_a_set_lacks_them() -> None:
    """Dates ended with an error of NumPy, and large whole numbers were rounded without a word."""
    columns = {
        "day": np.array(["2026-05-01", "2026-05-02"], "datetime64[D]"),
        "took": np.array([1500, 2500], "timedelta64[ms]"),
        "stamp": np.array([1714560000000000000, 2**60]),
        "mass": np.array([1, 2]),
        "who": np.array(["kim", "lee"]),
    }
    own, other = replace(simple(2), columns=columns), replace(simple(3), columns={})
    found = Recordings.join([own, other]).columns
    assert all(found[name][:2].tolist() == values.tolist() for name, values in columns.items())
    assert all(np.isnat(found[name][2:]).all() for name in ("day", "took"))
    assert found["who"][2:].tolist() == ["", "", ""]
    assert np.isnan(found["mass"][2:]).all()
    text = replace(simple(3), columns={"day": np.array(["mon"] * 3)})
    with pytest.raises(InputError, match="text and dates in the column day"):
        Recordings.join([own, text])
    with pytest.raises(InputError, match="the column stamp has whole numbers too large"):
        Recordings.join([replace(own, columns={"stamp": np.array([1714560000000000001, 1])}), other])


def test_tables_and_named_arrays_are_read_by_their_names() -> None:
    """A column of time is no axis, axes of xarray may stand anywhere, and what is masked is missing."""
    values, names = np.random.default_rng(0).normal(size=(2, 30, 2)).astype(np.float32), ["grip", "Fz"]
    frames = [pd.DataFrame(part, columns=names).assign(time=np.arange(30) / 100) for part in values]
    turned = xr.DataArray(values.swapaxes(1, 2), {"axis": names}, ("trial", "axis", "time"))
    for form in (frames, turned, list(turned)):
        recordings = Recordings.from_arrays(form, rate=100)
        np.testing.assert_array_equal(recordings.wrench, values)
        assert recordings.axes == ("grip", "Fz")
        assert recordings.units == ("", "N")
    with pytest.raises(InputError, match=r"expected a list of \[time, axis\] of the same axes"):
        Recordings.from_arrays(values[0], rate=100)  # one recording is no list
    assert Recordings.from_arrays(frames, rate=100, axes=["a", "b"]).axes == ("a", "b")
    assert np.isnan(Recordings.from_arrays([np.ma.masked_greater(values[0], 0)]).wrench).any()
    for wrenches, rate, why in ((frames, 200, "100 samples per second"), (values, 0, "rate is 0"),
                                ([frames[0], frames[1][["Fz", "grip"]]], 100, "different axes")):  # fmt: skip
        with pytest.raises(InputError, match=why):
            Recordings.from_arrays(wrenches, rate=rate)


REST = np.zeros((3, 20, 1), np.float32)
COLUMNS = {
    "texts of pandas": (pd.Series(["a", "b", None], dtype="string"), ["a", "b", ""]),
    "objects": (np.array(["a", "b", "c"], object), ["a", "b", "c"]),
    "counts of pandas": (pd.Series([1, 2, 5], dtype="Int64"), [1, 2, 5]),
    "objects that are numbers": (np.array([1, 2.5, True], object), [1.0, 2.5, 1.0]),
    "other bytes": (np.array([1, 2, 3], ">f8"), [1.0, 2.0, 3.0]),
    "nothing": ([None] * 3, [""] * 3),
}


@pytest.mark.parametrize("case", COLUMNS)
def test_columns_as_tables_hold_them_can_be_stored(case: str, tmp_path: Path) -> None:
    given, expected = COLUMNS[case]
    made = Recordings.from_arrays(REST, day=given)
    assert made.column("day").tolist() == expected
    write_recordings(tmp_path / "a.zarr", made, {})
    assert read_recordings(tmp_path / "a.zarr").column("day").tolist() == expected


@pytest.mark.parametrize("kind", [float, int, np.float64])
def test_any_number_is_a_rate(kind: Callable[[Any], Any], tmp_path: Path) -> None:
    made = Recordings.from_arrays(REST, kind(500))
    assert (type(made.dt), made.dt) == (float, 0.002)
    write_recordings(tmp_path / "a.zarr", made, {})
    write_recordings(tmp_path / "b.zarr", replace(made, dt=np.float64(0.002)), {})
    assert read_recordings(tmp_path / "a.zarr") == made == read_recordings(tmp_path / "b.zarr")


def test_names_that_are_numbers_are_texts_and_missing_ones_are_as_if_not_given(tmp_path: Path) -> None:
    made = Recordings.from_arrays(
        REST, trial=[7, 8, 9], session=pd.Series(["x", None, "y"]), outcome=[True, False, None]
    )
    write_recordings(tmp_path / "a.zarr", made, {})
    for one in (made, read_recordings(tmp_path / "a.zarr")):
        assert one.trial.tolist() == ["7", "8", "9"]
        assert one.session.tolist() == ["x", "1", "y"]
        assert one.outcome.tolist() == ["True", "False", "unknown"]
    with pytest.raises(InputError, match="Column day holds objects of the kinds int, str"):
        Recordings.from_arrays(REST, day=np.array([1, "a", None], object))
    with pytest.raises(InputError, match="Column day has rows of different lengths"):
        Recordings.from_arrays(REST, day=[[1], [1, 2], 3])


def test_texts_that_are_bytes_are_decoded_as_hdf5_has_them(tmp_path: Path) -> None:
    names = np.array([b"one", b"two", "drei µ".encode()])
    made = Recordings.from_arrays(
        REST, trial=names, day=names.astype(object), annotations=[(0, b"phase", b"push", 0.0, pd.NA)]
    )
    assert made.trial.tolist() == made.column("day").tolist() == ["one", "two", "drei µ"]
    assert made.annotations.labels == {"phase": ("push",)}
    write_recordings(tmp_path / "a.zarr", made, {})
    same(read_recordings(tmp_path / "a.zarr"), made)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([(3, "phase", "a", 0, 1)], "about recordings 3 to 3; there are 3"),
        ([(-1, "phase", "a", 0, 1)], "about recordings -1 to -1"),  # it was taken for the last one
        ([(1.7, "phase", "a", 0, 1)], "An annotation is"),
        ([(0, "phase", "a", 0)], "An annotation is"),
        ([(0, "phase", "a", None, 1)], "An annotation is"),
        ([(0, "phase", None, 0, 1)], "An annotation is"),
        ([(0, "phase", np.nan, 0, 1)], "An annotation is"),  # as a table of pandas has a missing text
        ([(0, pd.NA, "a", 0, 1)], "An annotation is"),
        ([(0, "phase", "a", np.nan, 1)], "expected a finite start"),
        ([(0, "phase", "a", 0.5, 0.1)], "it ends before it begins"),
        (pd.DataFrame([(0, "phase", "a", 0, 1)]), "An annotation is 0; expected recording, track, label"),
        ({"phase": [(0, 1)]}, "An annotation is phase"),
    ],
)
def test_annotations_that_are_none_are_refused(rows: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Recordings.from_arrays(REST, annotations=rows)


@pytest.mark.parametrize(
    "form",
    [list, np.array, lambda rows: np.array(rows, object), lambda rows: pd.DataFrame(rows).itertuples(index=False)],
)
def test_rows_of_annotations_come_in_many_forms(form: Callable[[Any], Any], tmp_path: Path) -> None:
    """Labels that are numbers are texts; times that are texts are sorted as numbers."""
    rows = form([(0, "phase", 12, 10.0, 11.0), (0, "phase", 3, 9.0, 10.0), (2, "phase", 3, 0.5, np.nan)])
    made = Recordings.from_arrays(REST, annotations=rows)
    assert made.annotations.labels == {"phase": ("3", "12")}
    np.testing.assert_array_equal(made.starts("phase"), [[9, 10], [np.nan, np.nan], [0.5, np.nan]])
    write_recordings(tmp_path / "a.zarr", made, {})
    same(read_recordings(tmp_path / "a.zarr"), made)
