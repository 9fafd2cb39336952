"""Figure of early classification: accuracy after the first samples, and where rules stop."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.figures.style import DPI, OURS, plain
from rcbht_jax.plots.canvas import new_figure

SETS = {"lp1": "LP1", "lp2": "LP2", "lp4": "LP4"}
COLORS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")  # apart from the line
MARKS = "o^sD"


def draw(result: dict[str, Any]) -> Figure:
    """A panel per set: the line and band are the method on the first samples, the marks are rules at their mean."""
    figure = new_figure((10.5, 3.9), DPI)
    for number, (of, title) in enumerate(SETS.items()):
        ax = figure.add_subplot(1, len(SETS), number + 1)
        rows = {name.split(" | ")[1]: row for name, row in result["rows"].items() if name.startswith(f"{of} | ")}
        prefixes(ax, {samples: rows[f"first {samples} samples"]["accuracy"] for samples in result["prefixes"]})
        rules = {name: row for name, row in rows.items() if "samples" not in name}
        for (name, row), color, mark in zip(rules.items(), COLORS, MARKS, strict=False):
            at, score = row["earliness"]["mean"] * result["prefixes"][-1], row["accuracy"]
            ax.plot([at, at], [score["low"], score["high"]], color=color, linewidth=1.1, alpha=0.7)
            ax.plot(
                at, score["mean"], mark, color=color, markersize=7, label=name, fillstyle="none", markeredgewidth=1.8
            )
        ax.set_title(title, fontsize=10)
        ax.set_ylim(0.5, 1.02)
        ax.set_xticks(result["prefixes"])
        ax.grid(axis="y", alpha=0.25)
        plain(ax)
    figure.axes[0].set_ylabel("accuracy, 95 % interval", fontsize=9)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False, fontsize=8)
    figure.supxlabel("samples until the decision (21 ms each); rules at their mean", fontsize=9, y=0.085)
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    return figure


def prefixes(ax: Axes, scores: dict[int, dict[str, float]]) -> None:
    mean, low, high = (np.array([score[key] for score in scores.values()]) for key in ("mean", "low", "high"))
    ax.fill_between(list(scores), low, high, color=OURS, alpha=0.15, linewidth=0)
    ax.plot(list(scores), mean, "-", color=OURS, linewidth=1.6, marker=".", label="words + wrench")
