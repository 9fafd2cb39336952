"""Data sets in memory: rows taken, sets joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
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
    assert Recordings.from_arrays(frames, rate=100, axes=["a", "b"]).axes == ("a", "b")
    assert np.isnan(Recordings.from_arrays([np.ma.masked_greater(values[0], 0)]).wrench).any()
    for wrenches, rate, why in ((frames, 200, "100 samples per second"), (values, 0, "rate is 0"),
                                ([frames[0], frames[1][["Fz", "grip"]]], 100, "different axes")):  # fmt: skip
        with pytest.raises(InputError, match=why):
            Recordings.from_arrays(wrenches, rate=rate)
