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
    [
        ("time", 1),
        ("t", 1),
        ("Timestamp", 1),
        ("stamp", 1),
        ("Time [s]", 1),
        ("t_ms", 1e3),
        ("ts", 1),
        ("Zeit [ms]", 1e3),
    ],
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


@pytest.mark.parametrize(
    ("name", "scale"), [("time", 1), ("t", 1), ("Timestamp", 1), ("t_ms", 1e3), ("Zeit [s]", 1), ("Temps (ms)", 1e3)]
)
def test_rows_are_counted_by_a_time_of_any_name(name: str, scale: float) -> None:
    """An index, one of its levels, and in xarray a dimension wherever it stands, or another coordinate along it."""

    def forms(seconds: np.ndarray) -> list[Any]:
        frame = pd.DataFrame(WRENCH, pd.Index(seconds * scale, name=name), NAMES)
        level = pd.concat({"a": frame}, names=["trial"])
        turned = xr.DataArray(WRENCH.T, {name: seconds * scale, "channel": list(NAMES)}, ("channel", name))
        beside = xr.DataArray(WRENCH, {name: ("sample", seconds * scale), "axis": list(NAMES)}, ("sample", "axis"))
        return [frame, level, turned, beside]

    for right, wrong in zip(forms(SECONDS), forms(2 * SECONDS), strict=True):
        assert rj.encode(right).info.axes == NAMES
        assert rj.encode(right).words("Fz") == rj.encode(WRENCH).words("Fz")
        with pytest.raises(InputError, match="the time has 100 samples per second"):
            rj.encode(wrong)


@pytest.mark.parametrize("name", ["Zeit", "时间", "elapsed time [s]", "x [s]"])
def test_an_index_that_grows_is_a_time_by_its_unit_or_in_another_language(name: str) -> None:
    """As for an import: the rate was compared with English names alone."""
    rj.encode(pd.DataFrame(WRENCH, pd.Index(SECONDS, name=name), NAMES))
    with pytest.raises(InputError, match="the time has 100 samples per second"):
        rj.encode(pd.DataFrame(WRENCH, pd.Index(SECONDS * 2, name=name), NAMES))
    still = pd.Index(np.full(300, 7.0), name=name)  # as of a temperature
    assert rj.encode(pd.DataFrame(WRENCH, still, NAMES)).info.axes == NAMES


def test_recordings_under_each_other_are_not_taken_for_one() -> None:
    frame = pd.DataFrame(WRENCH, pd.Index(SECONDS, name="time"), NAMES)
    with pytest.raises(InputError, match=r"The time jumps by -1\.495 s"):
        rj.encode(pd.concat({"a": frame, "b": frame}, names=["trial"]))


def test_dimensions_without_known_names_may_be_turned() -> None:
    with pytest.warns(UserWarning, match="300 axes and only 6 samples"):
        rj.encode(xr.DataArray(WRENCH.T, dims=("channel", "sample")))


@pytest.mark.parametrize("first", [("F", "x"), ("time", "")])
def test_names_of_several_levels_are_refused(first: tuple[str, str]) -> None:
    """A moment and a time could not be told by them: ("M", "x") was read as a force, ("time", "") as an axis."""
    names = [first, ("F", "y"), ("F", "z"), ("M", "x"), ("M", "y"), ("M", "z")]
    frame = pd.DataFrame(WRENCH, columns=pd.MultiIndex.from_tuples(names))
    array = xr.DataArray(WRENCH, dims=("time", "axis"), coords={"axis": frame.columns})
    for wrench in (frame, array):
        with pytest.raises(InputError, match="name of several levels"):
            rj.encode(wrench)


def test_names_in_bytes_are_texts() -> None:
    array = xr.DataArray(WRENCH, dims=("time", "axis"), coords={"axis": np.array(NAMES, "S2")})
    assert rj.encode(array).info.axes == NAMES
    assert rj.encode(array).words("Mx") == rj.encode(WRENCH).words("Mx")
    assert rj.preset(axes=["", "M"]).limits[:, 0].tolist() == [70, 7]  # no name is no moment


@pytest.mark.parametrize(
    ("seconds", "sentence"),
    [
        (np.where(np.arange(300) == 7, np.nan, SECONDS), "time of some samples is missing"),
        (SECONDS[::-1], "does not grow"),
        (np.repeat(SECONDS[::3], 3), "does not grow"),
        (
            pd.DatetimeIndex([pd.NaT, *pd.date_range("2024", periods=299, freq="5ms")]),
            "time of some samples is missing",
        ),
    ],
)
def test_a_time_that_is_none_is_not_called_a_rate(seconds: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        rj.encode(pd.DataFrame(WRENCH, columns=NAMES).assign(time=seconds))


def test_what_is_no_array_is_named() -> None:
    for wrench, kind in (({"Fz": WRENCH}, "dict"), ((part for part in [WRENCH]), "generator")):
        with pytest.raises(InputError, match=f"A signal is {kind}; expected an array"):
            rj.encode(wrench)
    with pytest.raises(InputError, match="A signal is Recordings; expected an array"):
        rj.encode(rj.Recordings.example())


def test_axes_learned_without_names_are_those_of_a_wrench() -> None:
    """Their names in another order contradict them; other names may be anything."""
    named = [pd.DataFrame(WRENCH, columns=names) for names in (NAMES, list("abcdef"), NAMES[::-1])]
    features, monitor = rj.WrenchFeatures().fit([WRENCH]), rj.NominalMonitor(rate=200).fit([WRENCH] * 3)
    for reader in (lambda one: features.transform([one]), monitor.scores):
        np.testing.assert_array_equal(reader(named[0]), reader(WRENCH))
        np.testing.assert_array_equal(reader(named[1]), reader(WRENCH))
        with pytest.raises(InputError, match="have the axes Mz, My, Mx, Fz, Fy, Fx; fit had Fx, Fy, Fz, Mx, My, Mz"):
            reader(named[2])
