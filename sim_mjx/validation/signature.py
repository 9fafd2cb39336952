"""The signature metric: similarity of the wrenches of a set of trials to those of a reference session.

Each trial is cut into four states (approach, rotation up to the harmonised boundary, insertion, the first
second of mating), each resampled to 100 points. Axes are Fx Fy Fz Mx My Mz, N and Nm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings

STATES = ("approach", "rotation", "insertion", "mating, first 1 s")
POINTS = 100  # samples of a resampled state
MATING = 1.0  # s of the mating state that count
PERCENTILES = (5.0, 95.0)  # of the reference band
MARGIN = 0.1  # of the larger of band width and sd: widens the band on both sides
WARP = 15  # points by which time warping may shift

Floats = NDArray[np.float64]
Profiles = Float64[np.ndarray, "_trial 4 100 6"]  # state, point, axis; N and Nm
Given = Float64[np.ndarray, "_trial _state _point _axis"]  # what should be profiles
Table = Float64[np.ndarray, "4 6"]  # state, axis
Rows = Sequence[int] | Int[np.ndarray, " _row"] | None  # which trials, in this order; None = all


@dataclass(frozen=True)
class Similarity:
    """Similarity of a test set to a reference; the sd is the reference's, over trials and points."""

    coverage: float  # share of the test's points inside the reference's widened band; 1 = all, mean of its table
    w1_over_sd: float  # Wasserstein-1 distance of the pooled values in sd; 0 = equal, median of its table
    dtw_over_sd: float  # time-warping distance of the median profiles in sd; 0 = equal, median of its table
    coverage_table: Table
    w1_table: Table
    dtw_table: Table


def profiles(recordings: Recordings, rows: Rows = None) -> Profiles:
    """Wrench profiles of recordings.

    Args:
        recordings: trials with the track ``states-harmonised``.
        rows: which recordings, in this order; all if None.

    Returns:
        the states [0, S1], [S1, S2'], [S2', S3], [S3, S3 + 1 s], interpolated linearly, ends included. The last state
        of a record that ends within a second of S3 ends with the record.

    Raises:
        InputError: no recordings, or one of them lacks a state.
    """
    chosen = np.arange(len(recordings)) if rows is None else np.asarray(rows, int)
    if chosen.size == 0:
        raise InputError("rows is empty, or there are no recordings; expected at least one.")
    edges = _edges(recordings, chosen)
    share = np.linspace(0.0, 1.0, POINTS)
    start, stop = edges[:, :-1, None], edges[:, 1:, None]
    position = ((start + (stop - start) * share) / recordings.dt).reshape(len(chosen), -1)
    before = np.clip(position.astype(int), 0, recordings.length[chosen, None] - 2)
    weight = (position - before)[..., None]
    wrench = recordings.wrench[chosen]
    low, high = (np.take_along_axis(wrench, index[..., None], axis=1) for index in (before, before + 1))
    values = low * (1.0 - weight) + high * weight
    return values.reshape(len(chosen), len(STATES), POINTS, len(AXES))


def _edges(recordings: Recordings, rows: NDArray[np.integer]) -> Floats:
    """The five edges [n, 5] of the four states, s."""
    onset = recordings.starts(HARMONISED)[rows]
    end = (recordings.length[rows] - 1) * recordings.dt
    edges = np.column_stack([np.zeros(len(rows)), onset[:, 1:], np.minimum(onset[:, 3] + MATING, end)])
    for row, length, steps in zip(rows, end, np.diff(edges, axis=1), strict=True):
        if not (steps > 0).all():
            state = STATES[int(np.argmin(steps > 0))].split(",")[0]
            onsets = np.round(recordings.starts(HARMONISED)[row], 3).tolist()
            raise InputError(
                f"The {state} state of recording {row} ({recordings.trial[row]}) is empty or has no end (onsets "
                f"{onsets} s, record {length:.3f} s); choose recordings that reach mating."
            )
    return edges


def compare(reference: Given, test: Given) -> Similarity:
    """Compare two sets of wrench profiles, [n, 4, 100, 6] and [m, 4, 100, 6]; not symmetric.

    Coverage is the share of the test's points inside the reference's 5-95 % band (over trials, point by point),
    widened on both sides by 0.1 max(band width, sd); Wasserstein-1 compares the values pooled over trials and
    points; dynamic time warping compares the median profiles (absolute difference, at most 15 points off the
    diagonal, path sum divided by 100).

    Raises:
        InputError: a wrong shape, a value that is not finite, or a reference without spread.
    """
    _check("reference", reference)
    _check("test", test)
    sd = reference.std(axis=(0, 2))
    if not (sd > 0).all():
        state, axis = np.argwhere(sd <= 0)[0]
        raise InputError(f"The reference's {AXES[axis]} is constant in state {STATES[state]}; no sd to compare with.")
    low, high = np.percentile(reference, PERCENTILES, axis=0)
    margin = MARGIN * np.maximum(high - low, sd[:, None, :])
    coverage = ((test >= low - margin) & (test <= high + margin)).mean(axis=(0, 2))
    w1 = _wasserstein(_pooled(reference), _pooled(test)) / sd
    medians = (np.moveaxis(np.median(x, axis=0), 1, 2) for x in (reference, test))
    dtw = _warping(*medians) / sd
    return Similarity(
        coverage=float(coverage.mean()),
        w1_over_sd=float(np.median(w1)),
        dtw_over_sd=float(np.median(dtw)),
        coverage_table=coverage,
        w1_table=w1,
        dtw_table=dtw,
    )


def _check(name: str, values: Given) -> None:
    if values.ndim != 4 or values.shape[1:] != (len(STATES), POINTS, len(AXES)) or len(values) == 0:
        raise InputError(f"The {name} profiles have shape {values.shape}; expected [trials, 4, {POINTS}, 6].")
    if not np.isfinite(values).all():
        raise InputError(f"The {name} profiles are not finite everywhere; leave out diverged trials.")


def _pooled(values: Floats) -> Floats:
    """Values over trials and points: [n, 4, 100, 6] -> [n * 100, 4, 6]."""
    return np.moveaxis(values, 1, 2).reshape(-1, len(STATES), len(AXES))


def _wasserstein(a: Floats, b: Floats) -> Floats:
    """Area between the two empirical distribution functions along the first axis: [k, ...], [l, ...] -> [...]."""
    values = np.concatenate([a, b])
    order = np.argsort(values, axis=0)
    gap = np.cumsum(np.where(order < len(a), 1 / len(a), -1 / len(b)), axis=0)
    return np.sum(np.abs(gap[:-1]) * np.diff(np.take_along_axis(values, order, axis=0), axis=0), axis=0)


def _warping(a: Floats, b: Floats) -> Floats:
    """Time-warping distance of profiles [..., k] within the band, divided by k: [...]; all profiles at once."""
    size = a.shape[-1]
    cost = np.abs(a[..., :, None] - b[..., None, :])
    total = np.full((*cost.shape[:-2], size + 1, size + 1), np.inf)
    total[..., 0, 0] = 0.0
    for diagonal in range(2 * size - 1):
        i = np.arange(max(0, diagonal - size + 1), min(diagonal, size - 1) + 1)
        i = i[np.abs(2 * i - diagonal) <= WARP]
        j = diagonal - i
        before = np.minimum(total[..., i, j], np.minimum(total[..., i, j + 1], total[..., i + 1, j]))
        total[..., i + 1, j + 1] = cost[..., i, j] + before
    return total[..., -1, -1] / size


def signature_figure(
    reference: Given, test: Given, title: str, names: tuple[str, str] = ("reference", "test")
) -> Figure:
    """Median profiles and 5-95 % bands of two sets of profiles, a panel per axis and state.

    Args:
        reference: profiles [n, 4, 100, 6], N and Nm. test: likewise.
        title: heading; the three figures of :func:`compare` follow it.
        names: of the two sets, for the legend.

    Raises:
        InputError: as :func:`compare`.
    """
    score = compare(reference, test)
    figure = Figure(figsize=(13, 12), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    percent = np.linspace(0, 100, POINTS)
    panels = figure.subplots(len(AXES), len(STATES), sharex=True, sharey="row")
    for (axis, state), panel in np.ndenumerate(panels):
        for values, color, name in zip((reference, test), ("tab:blue", "tab:red"), names, strict=True):
            low, median, high = np.percentile(values[:, state, :, axis], (5, 50, 95), axis=0)
            panel.fill_between(percent, low, high, color=color, alpha=0.25, linewidth=0)
            panel.plot(percent, median, color=color, linewidth=1.3, label=f"{name} (n = {len(values)})")
        numbers = (table[state, axis] for table in (score.coverage_table, score.w1_table, score.dtw_table))
        panel.set_title("in band {:.0%}   W1 {:.2f}   DTW {:.2f}".format(*numbers), fontsize=8, color="0.35")
        panel.grid(alpha=0.3)
        panel.margins(x=0)
    for panel, name in zip(panels[:, 0], AXES, strict=True):
        panel.set_ylabel(f"{name} ({'N' if name[0] == 'F' else 'Nm'})")
    for panel, name in zip(panels[-1], STATES, strict=True):
        panel.set_xlabel(f"{name}  (% of the state)")
    text = f"coverage {score.coverage:.2f}, W1/sd {score.w1_over_sd:.2f}, DTW/sd {score.dtw_over_sd:.2f}"
    figure.suptitle(f"{title}\n{text}; median and 5-95 % band", fontsize=13)
    figure.align_ylabels(panels)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure
