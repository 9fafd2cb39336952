"""Beliefs about one trial over time: a heat map per head (the paper's figure of online results, right column)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event, SubtaskStarted
from rcbht_jax.plots.canvas import new_figure


def belief_map(events: Sequence[Event], title: str = "", truth: Sequence[str] = ()) -> Figure:
    """Probability of every class at every belief, a row per class and a panel per head.

    Args:
        events: of one trial, as an introspector gives them; lines mark the beginnings of sub-tasks.
        title: above all.
        truth: classes of the sub-tasks in their order, named where they begin.

    Returns:
        a figure with one panel per head.

    Raises:
        InputError: there is no belief among the events.
    """
    beliefs = [event for event in events if isinstance(event, Belief)]
    if not beliefs:
        raise InputError("No belief was formed: the recording is shorter than one look.")
    heads = list(dict.fromkeys(belief.head for belief in beliefs))
    rows = [len(next(b for b in beliefs if b.head == head).classes) for head in heads]
    figure = new_figure((9.0, 1.1 + 0.5 * len(heads) + 0.28 * sum(rows)), 110)
    panels = figure.subplots(len(heads), 1, sharex=True, squeeze=False, height_ratios=rows)[:, 0]
    for panel, head in zip(panels, heads, strict=True):
        mine = [belief for belief in beliefs if belief.head == head]
        time = np.array([belief.time for belief in mine])
        step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
        # A belief holds from the one before to its own moment; after a gap no longer than usual.
        edges = np.append(np.maximum(time - step, np.append(-np.inf, time[:-1])), time[-1])
        shown = panel.pcolormesh(
            edges, np.arange(len(mine[0].classes) + 1), np.array([belief.probabilities for belief in mine]).T,
            cmap="viridis", vmin=0.0, vmax=1.0,
        )  # fmt: skip
        panel.set_yticks(np.arange(len(mine[0].classes)) + 0.5, mine[0].classes, fontsize=8)
        panel.invert_yaxis()
        panel.set_title(head, fontsize=9, loc="left")
        panel.tick_params(labelsize=8)
        figure.colorbar(shown, ax=panel, pad=0.015, fraction=0.04).ax.tick_params(labelsize=7)
    _beginnings(figure, len(heads), events, truth)
    panels[-1].set_xlabel("time, s", fontsize=9)
    figure.suptitle(title, fontsize=10)
    figure.tight_layout()
    return figure


def _beginnings(figure: Figure, panels: int, events: Sequence[Event], truth: Sequence[str]) -> None:
    """Lines where sub-tasks begin, and their names above the first panel."""
    starts = [event for event in events if isinstance(event, SubtaskStarted)]
    for panel in figure.axes[:panels]:
        for start in starts:
            panel.axvline(start.time, color="white", linewidth=1.5)
            panel.axvline(start.time, color="black", linewidth=0.8, linestyle="--" if start.detected else "-")
    for start, name in zip(starts, truth, strict=False):
        figure.axes[0].annotate(
            name, (start.time, 1.0), xycoords=("data", "axes fraction"), xytext=(1, 2), textcoords="offset points",
            fontsize=7, rotation=20,
        )  # fmt: skip
