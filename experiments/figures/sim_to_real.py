"""The figure of ``experiments.classification.sim_to_real``: accuracy on recorded trials by choice."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rcbht_jax.plots.canvas import new_figure

TITLES = {"merged": "three states (rotation and insertion merged)", "harmonised": "four states"}
GOALS = {"merged": 0.92, "harmonised": 0.80}
SESSIONS = {"A": ("o", "#1f77b4"), "B": ("s", "#d95f02")}
POOLED = "A+B"
# Titles of rows whose names in the result are not printed as they are.
TITLES_OF_ROWS = {
    "sensor | all presets wear a robot's": "sensor: a robot's in all presets",
    "sensor | the OpenHRP preset's is free of noise": "sensor: noise-free in the OpenHRP preset",
    "mating | each preset's own time": "mating: nominal duration of each preset",
    "mating | own time, without A and B": "mating: nominal duration, without A and B",
}
# Effects on the score: the main rows, the baselines, and each choice where no preset was fitted to A or B.
FAR = "without A and B"
STORY = ("main |", "baseline |", f"randomisation | none, {FAR}", f"randomisation | mild, {FAR}",
         f"randomisation | wide, {FAR}", f"mating | own time, {FAR}", f"mating | 1 to 20 s, {FAR}", "amount |",
         f"features, {FAR} |")  # fmt: skip


def lines(rows: dict[str, Any], begins: tuple[str, ...] = ("",)) -> dict[str, list[dict[str, Any]]]:
    """Name as shown -> its rows, several where several sets of trials were drawn.

    Only rows whose name begins with one of ``begins``.
    """
    shown: dict[str, list[dict[str, Any]]] = {}
    for name, row in rows.items():
        if POOLED in row["merged"] and name.startswith(begins):
            shown.setdefault(name.split(", draw")[0], []).append(row)
    return shown


def draw(rows: dict[str, Any], begins: tuple[str, ...] = ("",)) -> Figure:
    """Dots per session and the 95 % interval of both together, one line per row that begins so."""
    shown = lines(rows, begins)
    figure = new_figure((12.0, 0.21 * len(shown) + 1.6), 110)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (boundaries, title) in zip(panels, TITLES.items(), strict=True):
        for height, group in enumerate(shown.values()):
            scores = [row[boundaries] for row in group]
            low, high = np.mean([one[POOLED]["interval"] for one in scores], axis=0)
            panel.plot([low, high], [height, height], color="0.6", linewidth=3, solid_capstyle="butt", zorder=1)
            for session, (marker, color) in SESSIONS.items():
                at = np.mean([one[session]["accuracy"] for one in scores])
                panel.plot(at, height, marker, color=color, markersize=5, zorder=2, alpha=0.85)
        panel.axvline(GOALS[boundaries], color="0.3", linestyle=":", linewidth=1)
        panel.set_title(title, fontsize=10)
        panel.set_xlim(0, 1.02)
        panel.set_xlabel("accuracy on recorded trials")
        panel.grid(axis="x", color="0.9")
    names = list(shown)
    for height in range(1, len(names)):
        if names[height].split(" | ")[0] != names[height - 1].split(" | ")[0]:
            for panel in panels:
                panel.axhline(height - 0.5, color="0.8", linewidth=0.8)
    panels[0].set_yticks(
        range(len(names)), [TITLES_OF_ROWS.get(name, name.replace(" | ", ": ")) for name in names], fontsize=8
    )
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    handles = [
        panels[0].plot([], [], marker, color=color, label=f"session {session}")[0]
        for session, (marker, color) in SESSIONS.items()
    ]
    handles.append(panels[0].plot([], [], color="0.6", linewidth=3, label="both, 95 % interval")[0])
    handles.append(panels[0].plot([], [], ":", color="0.3", label="target")[0])
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=9)
    figure.tight_layout(rect=(0, 0.5 / figure.get_figheight(), 1, 1))
    return figure
