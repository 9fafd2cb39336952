"""Figures of the online results: reliability of beliefs, and time to confidence."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.figures.style import DPI, LINES, plain
from rcbht_jax.plots.canvas import new_figure


def panels(rows: dict[str, Any]) -> tuple[Figure, list[tuple[Axes, str, dict[str, Any]]]]:
    """A figure, and a panel for each set at 10 Hz with its name and row."""
    sets = {key.split(" at ")[0]: row for key, row in rows.items() if key.endswith(" at 10 Hz")}
    figure = new_figure((3.4 * len(sets), 3.6), DPI)
    each = enumerate(sets.items(), 1)
    return figure, [(figure.add_subplot(1, len(sets), place), name, row) for place, (name, row) in each]


def reliability(rows: dict[str, Any]) -> Figure:
    """Accuracy and share of beliefs over their probability, one panel per set."""
    figure, each = panels(rows)
    for ax, name, row in each:
        share, confidence, right = np.array(row["all"]["reliability"], float).T
        ax.plot([0, 1], [0, 1], color="0.7", linestyle=":", linewidth=1)
        ax.bar((np.arange(len(share)) + 0.5) / len(share), share, 0.95 / len(share), color="0.88")
        ax.plot(confidence, right, "o-", color=LINES[1], markersize=4)
        ax.set_title(f"{name}: error {row['all']['ECE steps']['mean']:.3f}", fontsize=9)
        ax.set_xlim(0, 1)
        ax.set_ylim(0, 1.02)
        plain(ax)
    figure.axes[0].set_ylabel("accuracy (line), share of beliefs (bars)", fontsize=8)
    figure.supxlabel("probability of the likeliest state, streamed every tenth of a second", fontsize=9)
    figure.tight_layout()
    return figure


def early(rows: dict[str, Any]) -> Figure:
    """Accuracy over the elapsed part of a sub-task, one panel per set; parts without a snapshot are bridged."""
    figure, each = panels(rows)
    for ax, name, row in each:
        accuracy = np.array(row["all"]["accuracy by tenth of the sub-task"], float)
        part = (np.arange(accuracy.shape[1]) + 1) / accuracy.shape[1]
        for color, state, line in zip(LINES, row["classes"], accuracy, strict=False):
            there = np.isfinite(line)
            ax.plot(part[there], line[there], color=color, label=state, linewidth=1.5)
        ax.set_title(name, fontsize=9)
        ax.set_ylim(0, 1.02)
        ax.set_xlim(0, 1)
        plain(ax)
    figure.axes[0].set_ylabel("accuracy", fontsize=8)
    figure.axes[0].legend(frameon=False, fontsize=8, loc="lower right")
    figure.supxlabel("elapsed fraction of the sub-task", fontsize=9)
    figure.tight_layout()
    return figure
