"""Gradient thresholds of an unknown robot, from its recordings alone: slopes at rest and at the start of contacts.

No annotation is needed. Recordings are cut into blocks of about half a second; on a logarithmic scale the steepness of
blocks falls into two groups, rest and movement. The limit of a constant is what nearly all windows at rest stay below,
noise and drift included; the limit of an impulse is the steepness that contacts usually reach. Runs of the fit rule are
longer than windows, so its limits come from longer lines, which noise tilts less, and its rest is what stays close
to the mean of a block.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from rcbht_jax._util.columns import unit_factor
from rcbht_jax._util.values import check_usable, expect
from rcbht_jax.encoding.choices import check_choices
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import config_of
from rcbht_jax.encoding.thresholds import GradientThresholds, Thresholds, limits_of, preset
from rcbht_jax.errors import InputError
from rcbht_jax.labels import Primitive
from rcbht_jax.types import Array, LabelTrack, Recordings

BLOCK = 0.5  # s, over which rest and movement are separated
CALM, CONTACT = 0.1, 0.05  # s: lines of the fit rule at rest, and in a contact
QUIET = 0.99  # share of the windows at rest that shall be constant
MARGIN = 1.5  # on that: rest differs from recording to recording, and one window spoils a composition
HELD = 0.05  # share of the blocks that may be stiller than rest is
STEPS = np.array([70.0, 46.0, 23.0]) / 70.0  # impulse, big and medium limit of the authors' preset, by its impulse
LEAST = np.array([8.0, 4.0, 2.0])  # the same limits in constant limits at least

QUANTILES = 200  # of the steepness at rest, for penalties
SWING = 20.0  # range of the means of windows in units of their noise, from which a signal changes; noise has about 9
SOFTNESS = 0.25  # of the soft penalty, in the logarithm of the steepness


@dataclass(frozen=True)
class RestCalibration:
    """Thresholds and what they were made from.

    Attributes:
        thresholds: ``[axis, 4]``, in units of the axis per second.
        rest: ``[recording, window, axis]`` whether a window is at rest; False beyond a recording's end.
    """

    thresholds: GradientThresholds
    rest: Bool[np.ndarray, "recording window axis"]


def rest_thresholds(recordings: Recordings, window: int = 5, rule: str = "paper") -> RestCalibration:
    """Thresholds from the steepness of windows at rest and of contacts; HIRO's for an axis that never changes.

    Args:
        recordings: any axes and units.
        window: samples per straight-line fit, as the encoder will have it.
        rule: of the words: "paper" or "similar", which have the same windows, or "fit".

    Raises:
        InputError: no ``Recordings``, none is as long as two windows, or no encoder has such a window or rule.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> wrench = rng.normal(size=(4, 1000, 1)) * 0.01
        >>> wrench[:, 500:520] += np.linspace(0, 10, 20)[:, None]
        >>> wrench[:, 520:] += 10
        >>> found = rest_thresholds(Recordings.from_arrays(wrench, rate=100, axes=["grip"], units=["N"]))
        >>> bool(found.rest.mean() > 0.9), found.thresholds.limits.shape
        (True, (1, 4))
    """
    slope, used = window_slopes(recordings, window)
    if slope.shape[1] < 2 or not used[:, 1].any():
        raise InputError(f"No recording has two windows of {window} samples; choose a smaller window.")
    steep = np.abs(slope)
    per_block = max(1, round(BLOCK / (window * recordings.dt)))
    rule = "paper" if rule == "similar" else rule  # what windows merge to does not change them
    fit = isinstance(config_of(rule, window, recordings.dt), FitConfig)
    activity = _deviations(recordings, window, used, per_block) if fit else _block_means(steep, used, per_block)
    moving = changing(recordings) & steep[used].any(0)  # rounding is no slope
    limits, rest = np.array(_preset(recordings).limits), used[..., None] & ~moving
    for axis in np.flatnonzero(moving).tolist():
        rest[used, axis] = activity[used, axis] <= _border(activity[used, axis])
    windows = _Lines(steep, used, rest)
    calm = windows.longer(recordings, window, CALM) if fit else windows
    contact = windows.longer(recordings, window, CONTACT) if fit else windows
    for axis in np.flatnonzero(moving).tolist():
        lines = calm if calm.seen(axis) else windows
        least = 1e-3 * float(lines.steep[lines.used, axis].max())
        constant = MARGIN * max(float(np.quantile(lines.steep[lines.rest[..., axis], axis], QUIET)), least)
        impulse = _contact_steepness(contact.steep[..., axis], contact.used & ~contact.rest[..., axis])
        limits[axis] = [*np.maximum(impulse * STEPS, constant * LEAST), constant]
    return RestCalibration(GradientThresholds(limits).validate(), rest)


@dataclass(frozen=True)
class _Lines:
    """Straight lines through parts of equal length of all recordings."""

    steep: Float[np.ndarray, "recording line axis"]
    used: Bool[np.ndarray, "recording line"]  # which are complete
    rest: Bool[np.ndarray, "recording line axis"]  # which are complete and lie at rest

    def longer(self, recordings: Recordings, window: int, seconds: float) -> _Lines:
        """The lines of about that length, of whole windows; these are lines of one window."""
        windows = min(max(1, round(seconds / (window * recordings.dt))), self.rest.shape[1])
        slope, used = _slopes(recordings, windows * window)
        parts = self.rest[:, : slope.shape[1] * windows].reshape(*slope.shape[:2], windows, -1)
        return _Lines(np.abs(slope), used, np.asarray(parts.all(2)))

    def seen(self, axis: int) -> bool:
        """Whether some line is at rest, and some line has a slope."""
        return bool(self.rest[..., axis].any() and self.steep[self.used, axis].any())


def _deviations(
    recordings: Recordings, window: int, used: Bool[np.ndarray, "recording window"], length: int
) -> Float[np.ndarray, "recording window axis"]:
    """Standard deviation of the values in the block of so many windows that a window lies in."""
    rows, count = used.shape
    parts = recordings.wrench[:, : count * window].reshape(rows, count, window, -1)
    mean = parts.mean(2, dtype=np.float64)
    mean -= mean[:, :1]  # a large offset would leave nothing of the differences of squares
    square = parts.var(2, dtype=np.float64) + mean**2
    return np.sqrt(np.maximum(_block_means(square, used, length) - _block_means(mean, used, length) ** 2, 0.0))


def changing(recordings: Recordings) -> Bool[np.ndarray, " axis"]:
    """Which axes change within some recording.

    >>> changing(Recordings.from_arrays([[[1.0, 0.3], [2.0, 0.3]]], axes=["grip", "dead"])).tolist()
    [True, False]
    """
    pairs = zip(recordings.wrench, recordings.length, strict=True)
    return np.any([np.ptp(one[: max(samples, 1)], axis=0) > 0 for one, samples in pairs], axis=0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RestSlopes:
    """How steep windows at rest are, as the other methods of calibration penalise what calls them not constant.

    Attributes:
        steep: ``[axis, quantile]`` steepness of windows at rest, increasing, in units of the axis per second.
        weight: of the penalty.
    """

    steep: Float[Array, "axis quantile"]
    weight: float | Array = 1.0

    @staticmethod
    def of(recordings: Recordings, window: int = 5, weight: float = 1.0) -> RestSlopes:
        """The slopes of :func:`rest_thresholds`.

        Raises:
            InputError: as there.

        Example:
            >>> wrench = np.random.default_rng(0).normal(size=(2, 400, 1)) * 0.01
            >>> wrench[:, 200:] += np.linspace(0, 10, 200)[:, None]
            >>> slopes = RestSlopes.of(Recordings.from_arrays(wrench, rate=100, axes=["grip"], units=["N"]))
            >>> [float(slopes.penalty(np.full((1, 4), limit))) for limit in (0.0, 100.0)]
            [1.0, 0.0]
        """
        rest = rest_thresholds(recordings, window).rest
        steep = np.abs(window_slopes(recordings, window)[0])
        levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
        return RestSlopes(
            np.stack([np.quantile(steep[rest[..., axis], axis], levels) for axis in range(steep.shape[2])]), weight
        )

    def penalty(self, limits: Thresholds) -> Float[Array, "*candidate"]:
        """Weighted share of the windows at rest that are steeper than the constant limit, mean of the axes."""
        return self.weight * (self.steep > np.asarray(limits_of(limits))[..., 3, None]).mean((-1, -2))

    def soft_penalty(self, limits: Thresholds) -> Float[Array, ""]:
        """Mean logarithm by which windows at rest exceed the constant limit, with a gradient however far they do."""
        return self.weight * excess(self.steep, limits_of(limits)[..., 3, None]).mean()


def excess(steep: Array, small: Array) -> Array:
    """Logarithm by which slopes exceed the constant limit, softly 0 where they do not."""
    ratio = jnp.log(jnp.maximum(jnp.asarray(steep, small.dtype), 1e-12)) - jnp.log(small)
    return SOFTNESS * jax.nn.softplus(ratio / SOFTNESS)


def auto_thresholds(recordings: Recordings, window: int = 5, rule: str = "paper") -> GradientThresholds:
    """Thresholds for recordings of an unknown robot; HIRO's preset where they are too short to see rest.

    Args:
        recordings, window, rule: as of :func:`rest_thresholds`.

    Raises:
        InputError: no encoder has such a window or rule.
    """
    if recordings.length.max(initial=0) < 2 * window:
        return _preset(recordings)
    return rest_thresholds(recordings, window, rule).thresholds


def _preset(recordings: Recordings) -> GradientThresholds:
    """HIRO's limits in the units of the axes; for what is no force and no moment, the numbers alone."""
    units = [unit if unit_factor(unit, "N") or unit_factor(unit, "Nm") else "" for unit in recordings.units]
    return preset(axes=recordings.axes, units=units)


def window_slopes(
    recordings: Recordings, window: int
) -> tuple[Float[np.ndarray, "recording window axis"], Bool[np.ndarray, "recording window"]]:
    """Slopes of the straight-line fits of the encoder's windows, unit/s, and which windows are complete.

    Raises:
        InputError: no recordings, a window that no encoder can have, or values that are not finite.
    """
    expect("The data set", recordings, Recordings)
    expect("The window", window, int, np.integer)
    check_choices(window, recordings.dt)
    check_usable(recordings.wrench, recordings.length)
    return _slopes(recordings, window)


def _slopes(
    recordings: Recordings, window: int
) -> tuple[Float[np.ndarray, "recording window axis"], Bool[np.ndarray, "recording window"]]:
    rows, samples, axes = recordings.wrench.shape
    count = samples // window
    cut = recordings.wrench[:, : count * window].reshape(rows, count, window, axes)
    time = (np.arange(window) - (window - 1) / 2) * recordings.dt
    slope = np.einsum("rnwa,w->rna", cut, time / (time**2).sum(), dtype=np.float64)
    return slope, np.arange(count) < (recordings.length // window)[:, None]


def rest_not_constant(
    primitive: LabelTrack, rest: Bool[np.ndarray, "recording window axis"], window: int, constant: int
) -> Float[np.ndarray, " axis"]:
    """Share of the time at rest ``[axis]`` whose published labels are not constant; 0 where there is no rest.

    Args:
        primitive: labels ``[recording, axis, slot]``.
        rest: of :func:`rest_thresholds`.
        window: samples per window.
        constant: code of the constant label.
    """
    label, t0, t1 = (np.asarray(values) for values in (primitive.label, primitive.t0, primitive.t1))
    recordings, axes, _ = label.shape
    moving = np.zeros((recordings, axes, rest.shape[1] + 1), np.int32)
    row, axis, slot = np.nonzero((label > 0) & (label != constant))
    edges = np.minimum(np.stack([t0[row, axis, slot], t1[row, axis, slot]]) // window, rest.shape[1])
    np.add.at(moving, (row, axis, edges[0]), 1)
    np.add.at(moving, (row, axis, edges[1]), -1)
    other = (moving.cumsum(-1)[..., :-1] > 0).swapaxes(1, 2) & rest
    return other.sum((0, 1)) / np.maximum(rest.sum((0, 1)), 1)


def hidden_changes(recordings: Recordings, primitive: LabelTrack, window: int) -> Bool[np.ndarray, " axis"]:
    """Which axes change far more than their noise, although all their labels are constant in most such recordings.

    Args:
        recordings: what was labelled.
        primitive: labels ``[recording, axis, slot]``.
        window: samples per window.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> ramp = np.linspace(0, [9.0, 0.0], 400) + 0.1 * rng.normal(size=(400, 2))
        >>> code = np.full((1, 2, 1), 7)
        >>> labels = LabelTrack(code, code * 0, code * 0 + 400, code * 0, *[code * 0.0] * 4)
        >>> hidden_changes(Recordings.from_arrays([ramp], 100, axes=("Fz", "Fx")), labels, 5).tolist()
        [True, False]
    """
    label = np.asarray(primitive.label)
    still = ((label == 0) | (label == Primitive.CONS)).all(2)
    changes = np.zeros((len(recordings), len(recordings.axes)), bool)
    for row, (wrench, samples) in enumerate(zip(recordings.wrench, recordings.length.tolist(), strict=True)):
        if (count := samples // window) > 1:
            means = wrench[: count * window].reshape(count, window, -1).mean(1, dtype=np.float64)
            noise = np.median(np.abs(np.diff(means, axis=0)), axis=0)  # of a normal one, 0.95 standard deviations
            changes[row] = (noise > 0) & (np.ptp(means, axis=0) > SWING * noise)
    return changes.any(0) & ((changes & still).sum(0) > (changes & ~still).sum(0))


def _block_means(
    steep: Float[np.ndarray, "recording window axis"], used: Bool[np.ndarray, "recording window"], length: int
) -> Float[np.ndarray, "recording window axis"]:
    """Mean steepness of the block that a window lies in."""
    block = np.arange(steep.shape[1]) // length
    first = np.flatnonzero(np.diff(block, prepend=-1))
    total = np.add.reduceat(steep * used[..., None], first, axis=1)
    count = np.add.reduceat(used.astype(np.int64), first, axis=1)
    return (total / np.maximum(count, 1)[..., None])[:, block]


def _border(activity: Float[np.ndarray, " block"]) -> float:
    """Steepness up to which blocks are at rest: the variance of the logarithm within the groups is least (Otsu).

    Blocks in which a sensor held its value count like the stillest others: they are not a group by themselves.
    """
    stillest = max(np.quantile(activity, HELD), activity[activity > 0].min(), 1e-6 * activity.max())
    order = np.sort(np.maximum(activity, stillest))
    level = np.log(order)
    count = np.arange(1, len(level))
    total = level.cumsum()
    left, right = total[:-1] / count, (total[-1] - total[:-1]) / (len(level) - count)
    between = count * (len(level) - count) * (left - right) ** 2
    return float(order[between.argmax()]) if len(between) and between.max() > 0 else float(order[-1])


def _contact_steepness(
    steep: Float[np.ndarray, "recording window"], moving: Bool[np.ndarray, "recording window"]
) -> float:
    """Median over the spells of movement of their steepest window."""
    padded = np.pad(moving, ((0, 0), (1, 1)))
    starts = np.flatnonzero((padded[:, 1:] & ~padded[:, :-1])[:, :-1])
    if not len(starts):
        return 0.0
    flat = np.where(moving, steep, 0.0).ravel()
    return float(np.median(np.maximum.reduceat(flat, starts)))
