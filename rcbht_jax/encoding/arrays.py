"""Wrenches as people have them: NumPy, JAX, pandas, xarray, one recording or many, and labels of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float32, Int32
from numpy.typing import ArrayLike, NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, config_of, limits_for
from rcbht_jax.encoding.thresholds import GradientThresholds, limits_of, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks, TrackInfo, axis_names, padded

RATE_TOLERANCE = 0.01  # share by which the rate of a time coordinate may differ from the one that was given
RATE, WINDOW = 200.0, 5  # defaults of encode
LONGEST_STEP = 5  # samples; a longer one is a gap, as for an import, and would be read as a steep line


def encode(
    wrench: Any,
    rate: float = RATE,
    *,
    window: int = WINDOW,
    thresholds: AnyLimits | ArrayLike | str | None = None,
    lengths: ArrayLike | None = None,
    config: AnyConfig | None = None,
    rule: Literal["paper", "fit"] = "paper",
    tolerance: ArrayLike | Sequence[float] | None = None,
) -> LabelTracks:
    """Labels of one or many wrench signals: gradient primitives, motion compositions, low-level behaviours.

    Args:
        wrench: one recording ``[time, axis]``, several ``[recording, time, axis]``, or a list of recordings of any
            lengths; NumPy, JAX, pandas or xarray; any number of axes, N and Nm. Names of axes are taken from pandas and
            xarray; a column, index or coordinate "time" (s, or dates) must agree with the rate and have no gap. Of
            xarray, the dimension "time" may be anywhere.
        rate: samples per second.
        window: samples per straight-line fit, >= 2.
        thresholds: gradient limits: an object or array ``[axis, 4]`` (or ``[recording, axis, 4]``), or the name of a
            robot; None = the preset of HIRO, moments being axes whose names begin with M or T. By the fit rule also
            FitLimits, whose tolerance counts unless another one is given.
        lengths: samples that count of each recording, where ``[recording, time, axis]`` is padded.
        config: all choices of the encoder at once, in place of ``rate``, ``window`` and ``rule``.
        rule: "paper", or "fit": words are runs of windows that one straight line explains (docs/fit_rule.md).
        tolerance: of the fit rule, root mean square by which a line may differ from the samples, N and Nm: a number,
            or one for each axis; None = from these recordings.

    Returns:
        labels ``[axis, slot]`` for one recording, ``[recording, axis, slot]`` for several, on the host.

    Raises:
        InputError: another shape, values that are not finite, recordings of different axes, a time that disagrees with
            the rate or has a gap, thresholds that do not fit, a tolerance for the paper's rule, or a rate, window or
            rule that the config contradicts.

    Source:
        Rojas et al., "Online Robot Introspection via Wrench-based Action Grammars", section III.

    Example:
        >>> import numpy as np, rcbht_jax as rj
        >>> wrench = np.zeros((400, 6))  # Fx Fy Fz Mx My Mz at 200 Hz
        >>> wrench[:, 2] = np.clip(20 * (np.arange(400) / 200 - 1), 0, 10)  # a push along z
        >>> rj.encode(wrench, rate=200).words("Fz")
        ['FX', 'PS', 'FX']
        >>> fitted = rj.encode(wrench, rate=200, rule="fit")
        >>> fitted.words("Fz"), fitted.primitive.t1[2].tolist()[:3]
        (['FX', 'PS', 'FX'], [200, 300, 400])
    """
    if config is None:
        config = config_of(rule, window, 1 / _positive(rate))
    else:
        _check_agreement(config, rate, window, rule)
    several = isinstance(wrench, list | tuple)
    signals = [_signal(one, config.dt) for one in wrench] if several else [_signal(wrench, config.dt)]
    if not signals:
        raise InputError("There is no recording; expected at least one.")
    axes = signals[0][1]
    if any(names != axes for _, names in signals):
        raise InputError(f"The recordings have different axes: {', '.join(axes)} and others.")
    stacked, length = _padded([values for values, _ in signals], lengths)
    limits = limits_for(config, _thresholds(thresholds, axes), tolerance, stacked, length)
    tracks = encode_batch(config, limits, stacked, length)
    single = not several and signals[0][0].ndim == 2
    recordings = () if single else _names(wrench, len(length))
    info = TrackInfo(1 / config.dt, axes, recordings)
    if single:
        tracks = jax.tree.map(lambda values: values[0], tracks)
    return replace(tracks, info=info)


def _check_agreement(config: AnyConfig, rate: float, window: int, rule: str) -> None:
    """Refuse what was given beside a configuration that has another value; the defaults count as not given."""
    for what, given, default, chosen in (
        ("rate", rate, RATE, rate if np.isclose(rate * config.dt, 1) else 1 / config.dt),
        ("window", window, WINDOW, config.window),
        ("rule", rule, "paper", "fit" if isinstance(config, FitConfig) else "paper"),
    ):
        if given not in (default, chosen):
            raise InputError(f"The {what} is {given}, in the config {chosen}; give one of them.")


def _positive(rate: float) -> float:
    if not 0 < rate < float("inf"):
        raise InputError(f"The rate is {rate} samples per second; expected a positive, finite number.")
    return rate


def _signal(wrench: Any, dt: float) -> tuple[NDArray[np.floating], tuple[str, ...]]:
    """Values ``[..., time, axis]`` and names of the axes."""
    values, names = read_signal(wrench, dt)
    if values.dtype.kind not in "fiub" or values.ndim not in (2, 3) or 0 in values.shape[-1:]:
        raise InputError(
            f"The wrench has shape {values.shape} of {values.dtype}; expected numbers [time, axis] or "
            "[recording, time, axis]."
        )
    double = np.result_type(values, np.float32) == np.float64 and jax.config.read("jax_enable_x64")
    values = values.astype(np.float64 if double else np.float32)
    return values, names or axis_names(values.shape[-1])


def read_signals(
    recordings: Any, dt: float, axis_first: bool = False
) -> tuple[Float32[np.ndarray, "recording time axis"], Int32[np.ndarray, " recording"], tuple[str, ...] | None]:
    """Recordings under each other, padded with zeros at the end, their lengths in samples, and names of the axes.

    Args:
        recordings: an array ``[recording, time, axis]``, or several ``[time, axis]`` of any lengths; NumPy, JAX, pandas
            or xarray.
        dt: s per sample, with which a column, an index or a coordinate of time must agree.
        axis_first: values whose dimensions have no names are ``[..., axis, time]``.

    Returns:
        values, lengths, and the names of pandas or xarray; None = there are none.

    Raises:
        InputError: other shapes, recordings of different axes, or a time that disagrees or has a gap.
    """
    if _is_frame(recordings) or _is_xarray(recordings):
        values, names = read_signal(recordings, dt, axis_first)
        read = [(value, names) for value in values]
    else:
        read = [read_signal(recording, dt, axis_first) for recording in recordings]
    named = list({names for _, names in read if names})
    if len(named) > 1:
        raise InputError(f"The recordings have different axes: {', '.join(named[0])}, and {', '.join(named[1])}.")
    parts = [np.asarray(values, np.float32) for values, _ in read]
    shapes = [part.shape for part in parts]
    if not parts or any(len(shape) != 2 for shape in shapes):
        raise InputError(
            f"Recordings have the shapes {sorted(set(shapes))}; expected an array [n, time, axis] or a list of "
            "[time, axis]; pass a single recording as [recording]."
        )
    if len({axes for _, axes in shapes}) > 1 or min(min(shape) for shape in shapes) == 0:
        raise InputError(
            f"Recordings have the shapes {sorted(set(shapes))}; they need samples, and the same axes each."
        )
    return *padded(parts), next(iter(named), None)


def read_signal(wrench: Any, dt: float, axis_first: bool = False) -> tuple[NDArray[Any], tuple[str, ...] | None]:
    """Values ``[..., time, axis]`` of any type, and names of the axes; None = they have none.

    Args:
        wrench: NumPy, JAX, pandas or xarray.
        dt: s per sample, with which a column, an index or a coordinate of time must agree.
        axis_first: values whose dimensions have no names are ``[..., axis, time]``.

    Raises:
        InputError: a time that disagrees, has a gap or is none, or an xarray Dataset.
    """
    if _is_frame(wrench):
        index = getattr(wrench, "index", None)
        if index is not None and (index.name == "time" or index.dtype.kind in "mM"):
            _check_time(index, dt)
        if "time" in wrench.columns:
            _check_time(wrench["time"], dt)
            wrench = wrench.drop(columns="time")
        return _frame_values(wrench), tuple(map(str, wrench.columns))
    if _is_xarray(wrench):
        if hasattr(wrench, "data_vars"):
            raise InputError('An xarray Dataset holds several arrays; make one of them: dataset.to_array("axis").')
        wrench = _ordered(wrench, axis_first)
        if "time" in wrench.coords and wrench.coords["time"].dims[-1:] == wrench.dims[-2:-1] != ():
            _check_time(wrench.coords["time"], dt)
        return wrench.to_numpy(), _coordinate_names(wrench)
    values = np.ma.filled(wrench.astype(np.float64), np.nan) if np.ma.isMaskedArray(wrench) else np.asarray(wrench)
    return (np.swapaxes(values, -1, -2) if axis_first and values.ndim > 1 else values), None


def _frame_values(frame: Any) -> NDArray[Any]:
    """Values ``[time, axis]``; numbers that may be missing, as pandas' own types have them, are NaN where they are."""
    values = frame.to_numpy()
    if values.dtype == object and all(getattr(dtype, "kind", "O") in "fiub" for dtype in frame.dtypes):
        return np.asarray(frame.to_numpy(np.float64, na_value=np.nan))
    return np.asarray(values)


def _is_frame(wrench: Any) -> bool:
    """A data frame, as of pandas."""
    return hasattr(wrench, "columns") and hasattr(wrench, "to_numpy")


def _is_xarray(wrench: Any) -> bool:
    """An array or a data set of xarray."""
    return hasattr(wrench, "dims") and hasattr(wrench, "coords")


def _ordered(wrench: Any, axis_first: bool = False) -> Any:
    """An xarray with time and axis last: the dimensions of these names, or else the last ones."""
    dims = list(wrench.dims)
    if len(dims) < 2:
        return wrench
    others = [dim for dim in dims if dim not in ("time", "axis")]
    axis = "axis" if "axis" in dims else others.pop(-2 if axis_first and "time" not in dims else -1)
    time = "time" if "time" in dims else others.pop()
    return wrench.transpose(*others, time, axis)


def _coordinate_names(wrench: Any) -> tuple[str, ...] | None:
    """Names of the axes, the last dimension; numbers are no names unless the dimension is called axis."""
    axis = wrench.dims[-1] if wrench.dims else ""
    if axis not in wrench.coords or (axis != "axis" and wrench.coords[axis].dtype.kind in "fiub"):
        return None
    return tuple(map(str, wrench.coords[axis].to_numpy()))


def _check_time(time: Any, dt: float) -> None:
    """Refuse a time ``[..., sample]`` of another rate, or with a gap."""
    seconds = _seconds(time)
    steps = np.diff(seconds)
    if not steps.size:
        return
    step = float(np.median(steps))
    if not abs(step - dt) <= RATE_TOLERANCE * dt:
        raise InputError(f"The time says {1 / step if step else 0:g} samples per second, the rate {1 / dt:g}.")
    wrong = np.argwhere((steps > LONGEST_STEP * dt) | (steps < 0))
    if len(wrong):
        place = tuple(wrong[0])
        raise InputError(
            f"The time jumps by {steps[place]:g} s after {seconds[place] - seconds[..., 0].min():g} s, at a rate of "
            f'{1 / dt:g} samples per second; fill the gap, or import the recording with "rcbht import".'
        )


def _seconds(time: Any) -> NDArray[np.float64]:
    """Numbers are seconds; dates and durations are counted from the first."""
    kind = time.dtype.kind
    if kind in "fiu":
        return np.asarray(time, np.float64)
    if kind not in "mM":
        raise InputError(f"The time is {time.dtype}; expected seconds or dates.")
    stamps = np.asarray(time, f"{'timedelta' if kind == 'm' else 'datetime'}64[ns]")
    return np.asarray((stamps - stamps[..., :1]) / np.timedelta64(1, "s"), np.float64)


def _padded(
    signals: Sequence[NDArray[np.floating]], lengths: ArrayLike | None
) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Recordings ``[recording, time, axis]``, zero beyond their lengths ``[recording]``."""
    if len(signals) == 1 and signals[0].ndim == 3:
        stacked = signals[0]
        counts = np.full(len(stacked), stacked.shape[1]) if lengths is None else np.asarray(lengths)
        if counts.dtype.kind not in "iu" or (counts.size and not 0 <= counts.min() <= counts.max() <= stacked.shape[1]):
            raise InputError(f"Lengths are whole numbers of samples, from 0 to {stacked.shape[1]} here.")
        return stacked, counts.astype(np.int32)
    if lengths is not None or any(values.ndim != 2 for values in signals):
        raise InputError("Lengths belong to an array [recording, time, axis]; a list has recordings [time, axis].")
    return padded(signals)


def _thresholds(thresholds: Any, axes: tuple[str, ...]) -> AnyLimits:
    if thresholds is None or isinstance(thresholds, str):
        return preset(thresholds or "hiro", axes)
    if isinstance(thresholds, FitLimits):
        return thresholds
    return GradientThresholds(np.asarray(limits_of(thresholds), np.float64))


def _names(wrench: Any, count: int) -> tuple[str | int, ...]:
    """Names of the recordings, those of xarray's first coordinate where there is one, else numbers."""
    wrench = _ordered(wrench) if _is_xarray(wrench) else wrench
    dims: tuple[str, ...] = getattr(wrench, "dims", ())
    if len(dims) == 3 and dims[0] in getattr(wrench, "coords", {}):
        return tuple(map(str, wrench.coords[dims[0]].to_numpy()))
    return tuple(range(count))
