"""Labels of wrenches in common forms: NumPy, JAX, pandas or xarray, one recording or many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float32, Int32
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.signals import (
    in_precision,
    is_xarray,
    numbers_of,
    ordered,
    period,
    read_parts,
    read_signal,
    warn_if_turned,
)
from rcbht_jax._util.values import expect
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, config_of, limits_for
from rcbht_jax.encoding.thresholds import GradientThresholds, host_limits, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks, TrackInfo, axis_names, padded

RATE, WINDOW = 200.0, 5  # defaults of encode


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
            lengths; NumPy, JAX, pandas, polars or xarray; any number of axes, N and Nm. Names of axes are taken from
            frames and xarray, but numbers are no names. A column, index or coordinate "time" (s, or dates) is no axis;
            it must agree with the rate and have no gap. So must what is named like one: "t", "timestamp", "t_ms". In
            xarray, the time may be any of the dimensions.
        rate: samples per second.
        window: samples per straight-line fit, >= 2.
        thresholds: gradient limits: an object or array ``[axis, 4]`` (or ``[recording, axis, 4]``), or the name of a
            robot, whose limits are in N/s and Nm/s whatever unit a name or an attribute states; None = the preset of
            HIRO, where axes such as Mx, Tx or mx are moments. For the fit rule also FitLimits, whose tolerance is used
            unless ``tolerance`` is given.
        lengths: number of valid samples of each recording, if ``[recording, time, axis]`` is padded.
        config: all options of the encoder at once, instead of ``rate``, ``window`` and ``rule``, whose defaults count
            as not given: with a config of 100 Hz, a rate of 200 is ignored.
        rule: "paper"; or "fit", where a word is a run of windows that one straight line explains (docs/fit_rule.md).
        tolerance: for the fit rule, the largest root-mean-square difference of line and samples, N and Nm: a number,
            or one for each axis; None = found from these recordings.

    Returns:
        labels ``[axis, slot]`` for one recording, ``[recording, axis, slot]`` for several, on the host.

    Raises:
        InputError: wrong shape or type, values that are not finite, recordings with different axes, a time that
            disagrees with the rate or has a gap, thresholds that do not fit, a tolerance for the paper's rule, or a
            rate, window or rule, other than the default, that contradicts the config.

    Warns:
        UserWarning: many axes, fewer samples, and no names that say which is which: ``[axis, time]`` must be turned.

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
    plain = config_of(rule, window, period(rate))
    if config is None:
        config = plain
    else:
        _check_agreement(config, rate, window, rule)
    several = isinstance(wrench, list | tuple)
    signals = [_signal(one, config.dt) for one in wrench] if several else [_signal(wrench, config.dt)]
    if not signals:
        raise InputError("There is no recording; expected at least one.")
    axes = _axes(signals[0])
    if other := next((one for one in map(_axes, signals) if one != axes), None):
        raise InputError(f"The recordings have different axes: {', '.join(axes)}, and {', '.join(other)}.")
    stacked, length = _padded([values for values, _ in signals], lengths)
    warn_if_turned(wrench, stacked.shape[1], stacked.shape[2], signals[0][1])
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
    expect("The config", config, EncoderConfig, FitConfig)
    for what, given, default, chosen in (
        ("rate", rate, RATE, rate if np.isclose(rate * config.dt, 1) else 1 / config.dt),
        ("window", window, WINDOW, config.window),
        ("rule", rule, "paper", "fit" if isinstance(config, FitConfig) else "paper"),
    ):
        if given not in (default, chosen):
            raise InputError(f"The {what} is {given}, in the config {chosen}; give one of them.")


def _axes(signal: tuple[NDArray[np.floating], tuple[str, ...] | None]) -> tuple[str, ...]:
    return signal[1] or axis_names(signal[0].shape[-1])


def _signal(wrench: Any, dt: float) -> tuple[NDArray[np.floating], tuple[str, ...] | None]:
    """Values ``[..., time, axis]`` and names of the axes, where they have some."""
    if isinstance(wrench, jax.core.Tracer):
        raise InputError("encode reads host arrays; inside jit, vmap or grad use rcbht_jax.encoding.encoder.encode.")
    values, names = read_signal(wrench, dt)
    if values.ndim not in (2, 3) or 0 in values.shape[-1:]:
        raise InputError(
            f"The wrench has shape {values.shape}; expected numbers [time, axis] or [recording, time, axis]."
        )
    double = np.result_type(values, np.float32) == np.float64 and jax.config.read("jax_enable_x64")
    return in_precision(values, np.float64 if double else np.float32), names


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
    parts, names = read_parts(recordings, dt, axis_first)
    shapes = [part.shape for part in parts]
    if not parts:
        raise InputError("There is no recording; expected at least one.")
    if any(len(shape) != 2 for shape in shapes):
        raise InputError(
            f"Recordings have the shapes {sorted(set(shapes))}; expected an array [n, time, axis] or a list of "
            "[time, axis]; pass a single recording as [recording]."
        )
    if len({axes for _, axes in shapes}) > 1 or min(min(shape) for shape in shapes) == 0:
        raise InputError(
            f"Recordings have the shapes {sorted(set(shapes))}; they need samples, and the same axes each."
        )
    wrench, length = padded(parts)
    warn_if_turned(recordings, wrench.shape[1], wrench.shape[2], names)
    return wrench, length, names


def _padded(
    signals: Sequence[NDArray[np.floating]], lengths: ArrayLike | None
) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Recordings ``[recording, time, axis]``, zero beyond their lengths ``[recording]``."""
    if len(signals) == 1 and signals[0].ndim == 3:
        stacked = signals[0]
        if not len(stacked):
            raise InputError("There is no recording; expected at least one.")
        whole = np.full(len(stacked), stacked.shape[1])
        counts = whole if lengths is None else numbers_of(lengths, "A list of lengths")
        if counts.shape != stacked.shape[:1]:
            raise InputError(f"Lengths have shape {counts.shape}; expected one for each of {len(stacked)} recordings.")
        if counts.dtype.kind not in "iu" or not 0 <= counts.min() <= counts.max() <= stacked.shape[1]:
            raise InputError(f"Lengths are whole numbers of samples, from 0 to {stacked.shape[1]} here.")
        return stacked, counts.astype(np.int32)
    if any(values.ndim != 2 for values in signals):
        shapes = sorted({values.shape for values in signals})
        raise InputError(f"The recordings of a list have the shapes {shapes}; expected [time, axis] of each.")
    if lengths is not None:
        raise InputError("Lengths belong to an array [recording, time, axis]; a list has recordings [time, axis].")
    return padded(signals)


def _thresholds(thresholds: Any, axes: tuple[str, ...]) -> AnyLimits:
    if thresholds is None or isinstance(thresholds, str):
        return preset(thresholds or "hiro", axes)
    if isinstance(thresholds, FitLimits):
        return thresholds
    return GradientThresholds(host_limits(thresholds).astype(np.float64))


def _names(wrench: Any, count: int) -> tuple[str | int, ...]:
    """Names of the recordings, those of xarray's first coordinate where there is one, else numbers."""
    wrench = ordered(wrench) if is_xarray(wrench) else wrench
    dims: tuple[str, ...] = getattr(wrench, "dims", ())
    if len(dims) == 3 and dims[0] in getattr(wrench, "coords", {}):
        return tuple(map(str, wrench.coords[dims[0]].to_numpy()))
    return tuple(range(count))
