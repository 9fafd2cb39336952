"""Thresholds over histograms of the gradients that they separate: a panel per axis and class."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.encoding.thresholds import LIMITS, GradientThresholds
from rcbht_jax.labels import AXES, UNITS
from rcbht_jax.plots.canvas import new_figure, plain

_COLORS = ("#67000d", "#d94801", "#fdae6b", "#08519c")


def threshold_figure(
    data: CalibrationData,
    window: int,
    thresholds: GradientThresholds,
    base: GradientThresholds | None = None,
    axes: Sequence[str] = AXES,
    units: Sequence[str] = UNITS,
) -> Figure:
    """Histograms of the windows' absolute slopes on a logarithmic scale, with the limits as lines.

    Args:
        data: trials with their windows.
        window: samples of a window.
        thresholds: limits ``[axis, 4]`` per second, solid lines.
        base: limits to compare with, dotted lines.
        axes: names. units: of the axes.

    Returns:
        a figure with a row per axis and a column per class; each panel states the share of windows that the limits
        make constant, small, medium, big and impulse.
    """
    figure = new_figure((3.2 * len(data.classes), 0.5 + 1.5 * len(axes)), 110)
    panels = figure.subplots(len(axes), len(data.classes), squeeze=False, sharex="row")
    for row, (axis, unit) in enumerate(zip(axes, units, strict=True)):
        limits = np.asarray(thresholds.limits)[row]
        slopes = np.abs(data.windows.slope[..., row])
        positive = slopes[slopes > 0]
        # A thousandth of the small limit and everything below share the first bin.
        low, high = limits[3] * 1e-3, max(positive.max(initial=0.0), limits[0]) * 1.5
        bins = np.geomspace(low, high, 50)
        for column, name in enumerate(data.classes):
            panel = panels[row, column]
            inside = _inside(data, window, column, slopes)
            panel.hist(np.maximum(inside, low), bins=bins, color="0.8")
            panel.text(
                0.02, 0.96, _zones(inside, limits), transform=panel.transAxes, fontsize=6, va="top", color="0.25"
            )
            for k, limit in enumerate(limits):
                label = LIMITS[k] if (row, column) == (0, 0) else None
                panel.axvline(limit, color=_COLORS[k], linewidth=1.6, label=label)
                if base is not None:
                    panel.axvline(np.asarray(base.limits)[row, k], color=_COLORS[k], linewidth=1.0, linestyle=":")
            panel.set_xscale("log")
            panel.set_yscale("symlog", linthresh=10)
            panel.tick_params(labelsize=7)
            if row == 0:
                panel.set_title(plain(name), fontsize=10)
            if column == 0:
                panel.set_ylabel(f"{plain(axis)}\nwindows", fontsize=9)
        panels[row, -1].annotate(f"{plain(unit or '1')}/s", (1.01, 0), xycoords="axes fraction", fontsize=8)
    figure.legend(loc="upper left", ncols=4, fontsize=8, frameon=False)
    figure.supxlabel(
        "absolute slope of a window (solid lines: thresholds, dotted lines: thresholds to compare with)", fontsize=9
    )
    figure.set_layout_engine("tight", rect=(0, 0, 1, 0.97))
    return figure


def _inside(
    data: CalibrationData, window: int, label: int, slopes: Float[np.ndarray, "recording window"]
) -> Float[np.ndarray, " slope"]:
    """Slopes of all windows that start in an interval of the class."""
    parts = []
    for recording, y in enumerate(data.y):
        for interval in np.flatnonzero(y == label):
            first, last = data.edges[recording, interval : interval + 2]
            parts.append(slopes[recording, -(-first // window) : -(-last // window)])
    return np.concatenate(parts) if parts else np.zeros(0)


def _zones(slopes: Float[np.ndarray, " slope"], limits: Float[np.ndarray, 4]) -> str:
    """Percentage of the windows between the limits, one line per zone, smallest slopes first."""
    zone = (slopes[:, None] >= limits[::-1]).sum(1)
    share = 100 * np.bincount(zone, minlength=5) / max(len(zone), 1)
    return "\n".join(f"{value:.0f} % {name}" for value, name in zip(share, ("constant", *LIMITS[::-1]), strict=True))
