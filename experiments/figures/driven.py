"""Pictures of the wrench along a recorded path: recorded, and of parts before and after a fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.figure import Figure

from experiments.figures.style import DPI, OURS, PEER, plain
from rcbht_jax.plots.canvas import new_figure

PERIOD = 0.1  # s, of a point
LABELS = {"load": "load, mm forward"}  # of quantities other than axes


def draw(result: dict[str, Any]) -> Figure:
    """Figure of the fit to a part of mating."""
    curves = {"presets": "presets", "fitted": "fitted to motion"}
    return _columns(result["traces"], curves, (10.0, 6.0))


def loads(result: dict[str, Any]) -> Figure:
    """Figure of the fit to all of mating, with the place of the hand's load."""
    names = {"at once": "the load moves at mating", "later": "the load moves later"}
    trials = {names[title]: curves for title, curves in result["traces"].items()}
    return _columns(trials, {"presets": "presets", "from many starts": "best of many starts"}, (10.0, 8.0))


def _columns(trials: dict[str, Any], simulated: dict[str, str], size: tuple[float, float]) -> Figure:
    """A column for each trial, a row for each axis; s on the abscissa."""
    axes = list(next(iter(trials.values()))["recorded"])
    figure = new_figure(size, DPI)
    grid = figure.subplots(len(axes), len(trials), sharex="col")
    for column, (title, curves) in enumerate(trials.items()):
        for row, axis in enumerate(axes):
            ax = grid[row][column]
            time = np.arange(len(curves["recorded"][axis])) * PERIOD
            ax.plot(time, _values(curves["recorded"][axis]), color="black", linewidth=1.6, label="recorded")
            for (name, label), colour in zip(simulated.items(), (PEER, OURS), strict=True):
                values = _values(curves[name][axis])
                ax.plot(time, values, color=colour, linewidth=1.1, label=f"simulated, {label}")
            ax.set_ylabel(LABELS.get(axis, f"{axis}, {'N' if axis.startswith('F') else 'Nm'}"))
            if axis == "load":
                ax.set_ylim(-45.0, 45.0)  # a load outside the part is due to several forces
            plain(ax)
        grid[0][column].set_title(f"{title}: {curves['trial'][-2:]}", fontsize=10)
        grid[-1][column].set_xlabel("time, s; touch at 0.6 s")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.95))
    return figure


def _values(column: list[float | None]) -> Float64[np.ndarray, " point"]:
    return np.array(column, np.float64)  # None, before touch, is NaN
