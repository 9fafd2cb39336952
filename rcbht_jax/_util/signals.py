"""Signals as people have them, NumPy, JAX, pandas, polars or xarray: values, names of axes, and a checked time.

What cannot be read, or disagrees, is an InputError.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rcbht_jax._util.columns import decoded, unit_of_time
from rcbht_jax._util.values import number, usable
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES

RATE_TOLERANCE = 0.01  # share by which the rate of a time coordinate may differ from the one that was given
MANY = 24  # axes: as of four wrenches; a short recording of fewer is no cause for doubt
LONGEST_STEP = 5  # samples; a longer one is a gap, as for an import, and would be read as a steep line


def period(rate: Any) -> float:
    """Seconds between samples."""
    if not 0 < (value := number("The rate", rate)) < float("inf"):
        raise InputError(f"The rate is {rate} samples per second; expected a positive, finite number.")
    return 1 / value


def read_parts(
    recordings: Any, dt: float, axis_first: bool = False, dtype: DTypeLike = np.float32
) -> tuple[list[NDArray[Any]], tuple[str, ...] | None]:
    """Recordings of an array or of several, each as :func:`read_signal` does, and the names that they share.

    Raises:
        InputError: no array and no list, values that are no numbers, recordings of different axes, or a time that
            disagrees or has a gap.
    """
    if is_frame(recordings) or is_xarray(recordings):
        values, names = read_signal(recordings, dt, axis_first)
        read = [(value, names) for value in values]
    elif isinstance(recordings, Iterable):
        read = [read_signal(recording, dt, axis_first) for recording in recordings]
    else:
        raise InputError(f"Recordings are {type(recordings).__name__}; expected an array, or a list of them.")
    named = list({names for _, names in read if names})
    if len(named) > 1:
        raise InputError(f"The recordings have different axes: {', '.join(named[0])}, and {', '.join(named[1])}.")
    return [in_precision(values, dtype) for values, _ in read], next(iter(named), None)


def read_signal(wrench: Any, dt: float, axis_first: bool = False) -> tuple[NDArray[Any], tuple[str, ...] | None]:
    """Values ``[..., time, axis]`` of any type, and names of the axes; None = they have none.

    Args:
        wrench: NumPy, JAX, pandas, polars or xarray.
        dt: s per sample, with which columns, an index or a coordinate of time must agree.
        axis_first: values whose dimensions have no names are ``[..., axis, time]``.

    Raises:
        InputError: values that are no numbers, a time that disagrees, has a gap or is none, an xarray Dataset, or a
            table of pyarrow.
    """
    if is_frame(wrench):
        _check_rows(getattr(wrench, "index", None), dt)
        times = _times(wrench.columns)
        for name, unit in times.items():
            if (count := list(wrench.columns).count(name)) > 1:
                raise InputError(f"There are {count} columns of the name {name}; keep one.")
            _check_time(wrench[name], dt, unit)
        if times:  # pandas' and polars' ways to say the same
            wrench = wrench.drop(columns=list(times)) if hasattr(wrench, "iloc") else wrench.drop(list(times))
        numbered = all(isinstance(name, Integral) for name in wrench.columns)  # as pandas has them by itself
        return numbers_of(wrench), None if numbered else _plain_names(wrench.columns)
    if hasattr(wrench, "column_names"):
        raise InputError("A table of pyarrow holds columns; make a frame of it: table.to_pandas().")
    if is_xarray(wrench):
        if hasattr(wrench, "data_vars"):
            raise InputError('An xarray Dataset holds several arrays; make one of them: dataset.to_array("axis").')
        wrench = ordered(wrench, axis_first)
        for name, unit in _times(wrench.coords).items():
            if wrench.coords[name].dims[-1:] == wrench.dims[-2:-1] != ():
                _check_time(wrench.coords[name], dt, unit)
        return numbers_of(wrench.to_numpy()), _coordinate_names(wrench)
    values = numbers_of(wrench)
    return (np.swapaxes(values, -1, -2) if axis_first and values.ndim > 1 else values), None


def texts(axes: Iterable[str]) -> tuple[str, ...]:
    """Names of axes; a single text is none, since each of its letters would be an axis.

    >>> texts(["Fz", "My"])
    ('Fz', 'My')
    """
    names = tuple(axes) if isinstance(axes, Iterable) and not isinstance(axes, str) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(f'The axes are {names or axes!r}; expected names of one or more, such as ["Fx", "Fy", "Fz"].')
    return names


def distinct(axes: Iterable[str]) -> tuple[str, ...]:
    """Names of axes, all different: a name that two axes share would stand for the first alone."""
    names = texts(axes)
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{names.count(twice)} axes are called {twice}; give each axis a name of its own.")
    return names


def numbers_of(values: Any, what: str = "A signal") -> NDArray[Any]:
    """A host array of whole or floating point numbers; those that are masked or missing are NaN.

    Raises:
        InputError: something else, such as text, dates or complex numbers, or rows of different lengths; the message
            says of ``what``.

    Example:
        >>> numbers_of(np.ma.masked_equal([1, 9], 9)).tolist()
        [1.0, nan]
    """
    if np.ma.isMaskedArray(values):
        return np.where(np.ma.getmaskarray(values), np.nan, numbers_of(values.data, what))
    try:
        array = _frame_values(values) if is_frame(values) else np.asarray(values)
    except InputError:
        raise
    except ValueError:
        raise InputError(f"{what} has rows of different lengths; expected as many numbers in each.") from None
    except TypeError:  # as of what is no array: a data set of xarray, keys of JAX
        raise InputError(f"{what} is {type(values).__name__}; expected an array of numbers.") from None
    if array.dtype == object and array.size and all(isinstance(value, Real) for value in array.flat):
        array = array.astype(np.float64)
    if array.dtype.kind in "fiub":
        return array
    if array.dtype == object and not array.ndim:  # as of a dictionary, a generator, a data set
        raise InputError(f"{what} is {type(values).__name__}; expected an array of numbers.")
    if not np.can_cast(array.dtype, np.float32):  # as bfloat16 and its like can be
        raise InputError(f"{what} of shape {array.shape} is {array.dtype}; expected numbers.")
    return array.astype(np.float32)


def in_precision(values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """Numbers in another precision; those beyond it become infinite, which encoders refuse."""
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype)


def warn_if_turned(recordings: Any, samples: int, axes: int, names: tuple[str, ...] | None = None) -> None:
    """Warn of many axes with fewer samples, where no names say which is which: recordings may be ``[axis, time]``.

    >>> warn_if_turned(np.zeros((600, 6)), 600, 6)
    """
    one = recordings[0] if isinstance(recordings, list | tuple) else recordings
    known = is_xarray(one) and ("axis" in one.dims or bool(_times(one.dims)))
    if not (names or known) and 0 < samples < axes and axes > MANY:
        given = f"There are {axes} axes and only {samples} samples"
        warnings.warn(f"{given}; recordings are [time, axis], so turn those that are [axis, time].", stacklevel=3)


def whole_series(series: NDArray[np.float64], least: int = 1) -> NDArray[np.float64]:
    """A recording ``[time, axis]`` as it is.

    Raises:
        InputError: another shape, fewer than ``least`` samples, or values that are not finite.

    Example:
        >>> whole_series(np.zeros((2, 1))).shape
        (2, 1)
    """
    if series.ndim != 2 or series.shape[1] < 1 or len(series) < least:
        raise InputError(f"A recording has the shape {series.shape}; expected [time, axis] with samples.")
    if not usable(series):  # squares of much larger numbers are infinite: all would be as usual
        raise InputError("A recording holds values that are not finite numbers, or huge; remove or interpolate them.")
    return series


def block_means(series: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Means ``[block, axis]`` of successive ``step`` samples; an incomplete last block counts only if it is alone.

    >>> block_means(np.arange(5.0)[:, None], 2)[:, 0].tolist()
    [0.5, 2.5]
    """
    if 0 < len(series) < step:
        return series.mean(0, keepdims=True)
    return series[: len(series) // step * step].reshape(-1, step, series.shape[1]).mean(1)


def moving_mean(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Mean of the last ``count`` values, zeros before the first; summed in the same order wherever a value is.

    >>> moving_mean(np.array([2.0, 4.0, 6.0]), 2).tolist()
    [1.0, 3.0, 5.0]
    """
    padded = np.concatenate([np.zeros(count - 1), values])
    total = np.zeros(len(values))
    for shift in range(count):
        total += padded[shift : shift + len(values)]
    return total / count


def read_chunk(samples: Any, dt: float, axes: Sequence[str] = ()) -> Any:
    """Samples of a stream of these axes, () = of any: values where they are a frame or an xarray, else as they are.

    Raises:
        InputError: other axes or another order, or as :func:`read_signal`.

    Example:
        >>> read_chunk([[1.0]], 0.005, ["Fz"])
        [[1.0]]
    """
    if not (is_frame(samples) or is_xarray(samples)):
        return samples
    values, names = read_signal(samples, dt)
    if names and axes and names != tuple(axes):
        raise InputError(f"The samples have the axes {', '.join(names)}; the stream has {', '.join(axes)}.")
    return values


def check_learned(names: Sequence[str] | None, estimator: Any, what: str) -> None:
    """Raise an error for a signal whose axes have other names, or another order, than those that were learned.

    Six axes that were learned without names are Fx to Mz: the same names in another order contradict them.

    Args:
        names: of the signal; None = it has none.
        estimator: with ``feature_names_in_`` where it learned names.
        what: beginning of the error.
    """
    unnamed = AXES if set(names or ()) == set(AXES) else names or ()
    known = tuple(getattr(estimator, "feature_names_in_", unnamed))
    if names and tuple(names) != known:
        raise InputError(f"{what} have the axes {', '.join(names)}; fit had {', '.join(known)}, in this order.")


def check_axes(
    axes: Sequence[str], units: Sequence[str], learned: Sequence[str], learned_units: Sequence[str], where: str
) -> None:
    """Raise an error if a signal's axes or units are not those of a model; ``where`` names it, "" = unit not stated."""
    if tuple(axes) != tuple(learned):
        raise InputError(f"{where} has the axes {', '.join(axes)}; the model learned {', '.join(learned)}.")
    for axis, unit, known in zip(axes, units, learned_units, strict=False):  # old files of monitors have no units
        if unit and known and unit != known:
            raise InputError(f"{where} has {axis} in {unit}; the model learned it in {known}.")


def _plain_names(names: Iterable[Any]) -> tuple[str, ...]:
    """Names of axes as texts, all different; of several levels, no rule can choose the one that names the quantity."""
    given = tuple(names)
    if levels := next((name for name in given if isinstance(name, tuple)), None):
        text = ".".join(map(str, levels))
        raise InputError(f"An axis has a name of several levels, {levels}; give each axis one text, such as {text!r}.")
    return distinct(str(decoded(name)) for name in given)


def _times(names: Iterable[Any]) -> dict[str, float]:
    """Those of the names that are of a time, and seconds per unit."""
    return {name: unit for name in names if isinstance(name, str) and (unit := unit_of_time(name))}


def _check_rows(index: Any, dt: float) -> None:
    """Raise an error for rows of a frame by a time of another rate, or with a gap: an index, or a level of one."""
    for level in range(getattr(index, "nlevels", 0)):
        values = index.get_level_values(level)
        grows = values.dtype.kind in "fiu" and bool((np.diff(values.to_numpy(np.float64)) > 0).all())
        unit = unit_of_time(values.name, grows) if isinstance(values.name, str) else 0.0
        if unit or values.dtype.kind in "mM":
            _check_time(values, dt, unit or 1.0)


def _frame_values(frame: Any) -> NDArray[Any]:
    """Values ``[time, axis]``; numbers that may be missing, as pandas' own types have them, are NaN where they are."""
    values = frame.to_numpy()
    if values.dtype == object and hasattr(frame, "iloc"):
        kinds = [getattr(dtype, "kind", "O") for dtype in frame.dtypes]
        if all(kind in "fiub" for kind in kinds):
            return np.asarray(frame.to_numpy(np.float64, na_value=np.nan))
        others = [str(name) for name, kind in zip(frame.columns, kinds, strict=True) if kind not in "fiub"]
        if len(others) < len(kinds):
            raise InputError(f"The columns {', '.join(others)} hold no numbers; drop them, or give the axes alone.")
    return np.asarray(values)


def is_frame(wrench: Any) -> bool:
    """A data frame, as of pandas."""
    return hasattr(wrench, "columns") and hasattr(wrench, "to_numpy")


def is_xarray(wrench: Any) -> bool:
    """An array or a data set of xarray."""
    return hasattr(wrench, "dims") and hasattr(wrench, "coords")


def ordered(wrench: Any, axis_first: bool = False) -> Any:
    """An xarray with time and axis last: the dimensions of these names, or else the last ones; "t" is a time, too."""
    dims = list(wrench.dims)
    if len(dims) < 2:
        return wrench
    named = ["time"] if "time" in dims else list(_times(dims))[:1]
    others = [dim for dim in dims if dim not in (*named, "axis")]
    axis = "axis" if "axis" in dims else others.pop(-2 if axis_first and not named else -1)
    time = named[0] if named else others.pop()
    return wrench.transpose(*others, time, axis)


def _coordinate_names(wrench: Any) -> tuple[str, ...] | None:
    """Names of the axes, the last dimension; numbers are no names."""
    axis = wrench.dims[-1] if wrench.dims else ""
    if axis not in wrench.coords or wrench.coords[axis].dtype.kind in "fiub":
        return None
    return _plain_names(wrench.coords[axis].to_numpy())


def _check_time(time: Any, dt: float, unit: float = 1.0) -> None:
    """Raise an error for a time ``[..., sample]`` of another rate, or with a gap; numbers are so many seconds each."""
    seconds = _seconds(time, unit)
    steps = np.diff(seconds)
    if not steps.size:
        return
    if np.isnan(steps).any():
        raise InputError("The time of some samples is missing; fill it in, or leave these samples out.")
    step = float(np.median(steps))
    if step <= 0:
        raise InputError("The time does not grow from sample to sample; sort them, and give each a time of its own.")
    if not abs(step - dt) <= RATE_TOLERANCE * dt:
        raise InputError(
            f"The rate is {1 / dt:g}, but the time has {1 / step:g} samples per second; give the rate of the time."
        )
    wrong = np.argwhere((steps > LONGEST_STEP * dt) | (steps < 0))
    if len(wrong):
        place = tuple(wrong[0])
        raise InputError(
            f"The time jumps by {steps[place]:g} s after {seconds[place] - seconds[..., 0].min():g} s, at a rate of "
            f'{1 / dt:g} samples per second; fill the gap, or import the recording with "rcbht import".'
        )


def _seconds(time: Any, unit: float) -> NDArray[np.float64]:
    """Numbers count units; dates and durations are counted from the first."""
    time = time if hasattr(time.dtype, "kind") else time.to_numpy()  # polars has types of its own
    kind = time.dtype.kind
    if kind in "fiu":
        return np.asarray(time, np.float64) * unit
    if kind not in "mM":
        raise InputError(f"The time is {time.dtype}; expected seconds or dates, as pandas.to_datetime makes of text.")
    stamps = np.asarray(time, f"{'timedelta' if kind == 'm' else 'datetime'}64[ns]")
    return np.asarray((stamps - stamps[..., :1]) / np.timedelta64(1, "s"), np.float64)
