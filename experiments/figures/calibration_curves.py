"""Objective and held-out log-loss over time, for each calibration method."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rcbht_jax.plots.canvas import new_figure

WAYS = {
    "random": ("#999999", "random search, vectorised"),
    "halving": ("#0072B2", "halving, then CMA-ES"),
    "gradient": ("#D55E00", "gradient of a classifier's loss"),
    "gradient of the fit": ("#CC79A7", "gradient of the objective's smooth part"),
    "optuna": ("#009E73", "Optuna's TPE, NumPy encoder"),
}
CURVE = "curve (seconds, objective, held-out accuracy, held-out log-loss)"


def draw(rows: dict[str, Any]) -> Figure:
    """Left: the best objective so far on the training trials. Right: its log-loss on the held-out trials.

    Thin lines are seeds, the thick one is their median; every line goes on to the end of its run.
    """
    figure = new_figure((10.5, 4.2), 110)
    axes = figure.subplots(1, 2)
    for way, (color, title) in WAYS.items():
        runs = [row for name, row in rows.items() if name.startswith(f"{way} | ")]
        for ax, column in zip(axes, (1, 3), strict=True):
            _lines(ax, runs, column, color, title)
    for ax, title in zip(axes, ("best objective, training trials", "log-loss, held-out trials"), strict=True):
        ax.set_xscale("log")
        ax.set_xlabel("processor seconds, without compilation")
        ax.set_title(title, fontsize=10)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(fontsize=8, frameon=False, loc="lower right")
    figure.tight_layout()
    return figure


def _lines(ax: Any, runs: list[dict[str, Any]], column: int, color: str, title: str) -> None:
    if not runs:
        return
    lines = []
    for run in runs:
        points = np.array([p for p in run[CURVE] if p[column] is not None], float)
        at, value = np.maximum(points[:, 0], 0.05), points[:, column]
        lines.append((at, value))
        many = len(points) > 1
        style = {"drawstyle": "steps-post"} if many else {"marker": "o", "markersize": 4, "linestyle": "none"}
        ax.plot([*at, run["seconds"]] if many else at, [*value, value[-1]] if many else value,
                color=color, linewidth=0.7, alpha=0.35, **style)  # fmt: skip
    if any(len(at) < 2 for at, _ in lines):
        return
    first, last = max(at[0] for at, _ in lines), max(run["seconds"] for run in runs)
    grid = np.geomspace(first, max(last, first * 1.01), 200)
    held = [value[np.maximum(np.searchsorted(at, grid, side="right") - 1, 0)] for at, value in lines]
    ax.plot(grid, np.median(held, axis=0), color=color, linewidth=2.2, label=title)
