"""Wrenches as people have them: NumPy, JAX, pandas, xarray, one recording or many, and labels of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, config_of, limits_for
from rcbht_jax.encoding.thresholds import GradientThresholds, limits_of, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks, TrackInfo, axis_names, padded

RATE_TOLERANCE = 0.01  # share by which the rate of a time coordinate may differ from the one that was given


def encode(
    wrench: Any,
    rate: float = 200.0,
    *,
    window: int = 5,
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
            xarray; a column or coordinate "time" (s) must agree with the rate.
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
        InputError: another shape, values that are not finite, recordings of different axes, thresholds that do not
            fit, or a tolerance for the paper's rule.

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
    config = config or config_of(rule, window, 1 / _positive(rate))
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


def _positive(rate: float) -> float:
    if not 0 < rate < float("inf"):
        raise InputError(f"The rate is {rate} samples per second; expected a positive, finite number.")
    return rate


def _signal(wrench: Any, dt: float) -> tuple[NDArray[np.floating], tuple[str, ...]]:
    """Values ``[..., time, axis]`` and names of the axes."""
    names: tuple[str, ...] | None = None
    if hasattr(wrench, "columns") and hasattr(wrench, "to_numpy"):  # pandas
        if "time" in wrench.columns:
            _check_time(wrench["time"].to_numpy(), dt)
            wrench = wrench.drop(columns="time")
        names, values = tuple(map(str, wrench.columns)), wrench.to_numpy()
    elif hasattr(wrench, "dims") and hasattr(wrench, "coords"):  # xarray
        order = [dim for dim in wrench.dims if dim not in ("time", "axis")]
        known = [dim for dim in ("time", "axis") if dim in wrench.dims]
        if len(known) == 2:
            wrench = wrench.transpose(*order, *known)
        if "time" in wrench.coords and wrench.coords["time"].dtype.kind in "fiu":
            _check_time(wrench.coords["time"].to_numpy(), dt)
        names = tuple(map(str, wrench.coords["axis"].to_numpy())) if "axis" in wrench.coords else None
        values = wrench.to_numpy()
    else:
        values = np.asarray(wrench)
    if values.dtype.kind not in "fiub" or values.ndim not in (2, 3) or 0 in values.shape[-1:]:
        raise InputError(
            f"The wrench has shape {values.shape} of {values.dtype}; expected numbers [time, axis] or "
            "[recording, time, axis]."
        )
    values = values.astype(
        np.float64 if values.dtype == np.float64 and jax.config.read("jax_enable_x64") else np.float32
    )
    return values, names or axis_names(values.shape[-1])


def _check_time(time: NDArray[Any], dt: float) -> None:
    if len(time) > 1:
        step = float(np.median(np.diff(time)))
        if not abs(step - dt) <= RATE_TOLERANCE * dt:
            raise InputError(f"The time says {1 / step if step else 0:g} samples per second, the rate {1 / dt:g}.")


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
    dims: tuple[str, ...] = getattr(wrench, "dims", ())
    if len(dims) == 3 and dims[0] in getattr(wrench, "coords", {}):
        return tuple(map(str, wrench.coords[dims[0]].to_numpy()))
    return tuple(range(count))
