"""Picture of the wrench along a recorded path: recorded, and of parts before and after the fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.figures.style import DPI, OURS, PEER, plain
from rcbht_jax.plots.canvas import new_figure

PERIOD = 0.1  # s, of a point


def draw(result: dict[str, Any]) -> Figure:
    """A column for each trial, a row for each axis; s on the abscissa."""
    trials = result["traces"]
    axes = list(next(iter(trials.values()))["recorded"])
    figure = new_figure((10.0, 6.0), DPI)
    grid = figure.subplots(len(axes), len(trials), sharex="col")
    for column, (title, curves) in enumerate(trials.items()):
        for row, axis in enumerate(axes):
            ax = grid[row][column]
            time = np.arange(len(curves["recorded"][axis])) * PERIOD
            ax.plot(time, curves["recorded"][axis], color="black", linewidth=1.6, label="recorded")
            ax.plot(time, curves["presets"][axis], color=PEER, linewidth=1.1, label="simulated, presets")
            ax.plot(time, curves["fitted"][axis], color=OURS, linewidth=1.1, label="simulated, fitted to motion")
            ax.set_ylabel(f"{axis}, {'N' if axis.startswith('F') else 'Nm'}")
            plain(ax)
        grid[0][column].set_title(f"{title}: {curves['trial'][-2:]}", fontsize=10)
        grid[-1][column].set_xlabel("time, s; touch at 0.6 s")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.95))
    return figure
