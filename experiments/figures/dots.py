"""Dot plots of scores: one line per question, a dot with its 95 % interval per method."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from experiments.figures.style import DPI, plain
from rcbht_jax.plots.canvas import new_figure

COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#999999")
MARKS = "osD^vP"
Score = Mapping[str, float]  # mean, low, high


def draw(rows: Mapping[str, Mapping[str, Score]], what: str, ticks: Mapping[str, float] | None = None) -> Figure:
    """Dots per row and kind.

    Args:
        rows: name -> kind -> score.
        what: is measured, for the axis.
        ticks: name -> another score, drawn as a short grey line.
    """
    kinds = list(dict.fromkeys(kind for row in rows.values() for kind in row))
    figure = new_figure((10.0, 0.38 * len(rows) + 1.5), DPI)
    ax = figure.subplots()
    for number, (kind, color, mark) in enumerate(zip(kinds, COLORS, MARKS, strict=False)):
        place = np.arange(len(rows)) + 0.7 * ((number + 0.5) / len(kinds) - 0.5)
        for at, row in zip(place, rows.values(), strict=True):
            if kind in row:
                ax.plot([row[kind]["low"], row[kind]["high"]], [at, at], color=color, linewidth=1.1, alpha=0.6)
        known = [(row[kind]["mean"], at) for at, row in zip(place, rows.values(), strict=True) if kind in row]
        ax.plot(*np.array(known).T, mark, color=color, markersize=4.5, label=kind, linestyle="none")
    for at, name in enumerate(rows):
        if ticks and name in ticks:
            ax.plot([ticks[name]] * 2, [at - 0.4, at + 0.4], color="0.35", linewidth=1.6)
    if ticks:
        ax.plot([], [], color="0.35", linewidth=1.6, label="paper, mean")
    ax.set_yticks(range(len(rows)), list(rows))
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlabel(what, fontsize=9)
    ax.grid(axis="y", alpha=0.25)
    plain(ax)
    figure.legend(loc="lower center", ncols=len(kinds) + bool(ticks), frameon=False, fontsize=8)
    figure.tight_layout(rect=(0, 0.35 / figure.get_figheight(), 1, 1))
    return figure
