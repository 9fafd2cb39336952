"""Frames with a column of time: it is checked, and is no axis, whatever it is called and whoever made the frame."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import rcbht_jax as rj
from rcbht_jax.errors import InputError

NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
WRENCH = np.random.default_rng(0).normal(size=(300, 6)).cumsum(0).astype(np.float32)
SECONDS = np.arange(300) / 200


class Polars:
    """What this library uses of a polars frame: columns with types of their own, and ``drop`` without ``columns``."""

    class Column:
        dtype = "Float64"

        def __init__(self, values: np.ndarray) -> None:
            self.to_numpy = lambda: values

    def __init__(self, columns: dict[str, Any]) -> None:
        self._columns, self.columns = columns, list(columns)
        self.dtypes = ["Float64"] * len(columns)

    def __getitem__(self, name: str) -> Polars.Column:
        return self.Column(np.asarray(self._columns[name]))

    def drop(self, names: Iterable[str]) -> Polars:
        return Polars({name: values for name, values in self._columns.items() if name not in names})

    def to_numpy(self) -> np.ndarray:
        return np.stack([np.asarray(values) for values in self._columns.values()], 1)


@pytest.mark.parametrize("make", [pd.DataFrame, Polars])
@pytest.mark.parametrize(
    ("name", "scale"),
    [("time", 1), ("t", 1), ("Timestamp", 1), ("stamp", 1), ("Time [s]", 1), ("t_ms", 1e3), ("ts", 1)],
)
def test_a_column_of_time_is_no_axis(make: Any, name: str, scale: float) -> None:
    columns = dict(zip(NAMES, WRENCH.T, strict=True))
    frame, wrong = make({name: SECONDS * scale, **columns}), make({name: SECONDS * scale * 2, **columns})
    assert rj.encode(frame).info.axes == NAMES
    assert rj.encode(frame).words("Fz") == rj.encode(WRENCH).words("Fz")
    assert rj.WrenchFeatures().fit([frame]).n_features_in_ == 6
    with pytest.raises(InputError, match="The rate is 200, but the time has 100 samples per second"):
        rj.encode(wrong)


def test_an_axis_may_begin_with_a_t() -> None:
    names = ("T_x", "tool", "torque", "ts_1")
    assert rj.encode(pd.DataFrame(WRENCH[:, :4], columns=names)).info.axes == names


def test_a_table_of_pyarrow_is_refused() -> None:
    pyarrow = pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match=r"make a frame of it: table\.to_pandas\(\)"):
        rj.encode(pyarrow.table({"time": SECONDS, "Fx": WRENCH[:, 0]}))


def test_two_axes_of_one_name_are_refused() -> None:
    frame = pd.DataFrame(np.zeros((50, 2)), columns=["grip", "grip"])
    array = xr.DataArray(np.zeros((50, 2)), dims=("time", "axis"), coords={"axis": ["grip", "grip"]})
    sentence = "2 axes are called grip; give each axis a name of its own"
    for wrench in (frame, array):
        with pytest.raises(InputError, match=sentence):
            rj.encode(wrench, rate=100)
    with pytest.raises(InputError, match=sentence):
        rj.Recordings.from_arrays(np.zeros((1, 50, 2)), rate=100, axes=["grip", "grip"])
