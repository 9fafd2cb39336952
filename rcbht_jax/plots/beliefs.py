"""Probabilities of the classes over one trial: a heat map per classifier of a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rcbht_jax._util.printable import room
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event, SubtaskStarted
from rcbht_jax.plots.canvas import cut, lay_out, new_figure, plain, stacked

LETTER = 0.062  # inches of one letter of a name of a sub-task, at most
MOST_ROWS = 3  # of names
WIDE = 110  # letters that fit into the title
ABOVE, LINE = 17.0, 9.0  # points: of the first row of names above the panel, below which its title is; of one row


def belief_map(events: Sequence[Event], title: str = "") -> Figure:
    """Probability of every class at every belief: a panel per classifier, a row per class.

    >>> belief = Belief(200, 1.0, "state", "seated", 0.9, "certain", 0.1, ("searching", "seated"), (0.1, 0.9))
    >>> figure = belief_map([SubtaskStarted(100, 0.5, 99, True), belief], "trial 1")

    Args:
        events: of one trial, from an introspector; lines with names mark the starts of sub-tasks, dashed where
            detected.
        title: of the figure.

    Raises:
        InputError: there is no belief among the events.
    """
    beliefs = [event for event in events if isinstance(event, Belief)]
    if not beliefs:
        raise InputError("There is no belief among the events: the recording is too short for the first one.")
    heads = list(dict.fromkeys(belief.head for belief in beliefs))
    rows = [len(next(b for b in beliefs if b.head == head).classes) for head in heads]
    figure = new_figure((9.0, 1.4 + 0.5 * len(heads) + 0.28 * sum(rows)), 110)
    panels = figure.subplots(len(heads), 1, sharex=True, squeeze=False, height_ratios=rows)[:, 0]
    for panel, head in zip(panels, heads, strict=True):
        of_head = [belief for belief in beliefs if belief.head == head]
        time = np.array([belief.time for belief in of_head])
        step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
        # A belief is drawn from the previous one to its own time; after a gap, over the usual period.
        edges = np.append(np.maximum(time - step, np.append(-np.inf, time[:-1])), time[-1])
        image = panel.pcolormesh(
            edges, np.arange(len(of_head[0].classes) + 1), np.array([belief.probabilities for belief in of_head]).T,
            cmap="viridis", vmin=0.0, vmax=1.0,
        )  # fmt: skip
        classes = [plain(one) for one in of_head[0].classes]
        panel.set_yticks(np.arange(len(classes)) + 0.5, classes, fontsize=8)
        panel.invert_yaxis()
        panel.set_title(plain(head), fontsize=9, loc="left")
        panel.tick_params(labelsize=8)
        bar = figure.colorbar(image, ax=panel, pad=0.015, fraction=0.04)
        bar.set_label("probability", fontsize=8)
        bar.ax.tick_params(labelsize=7)
    panels[-1].set_xlabel("time, s", fontsize=9)
    figure.suptitle(plain(cut(title, WIDE)), fontsize=10)
    figure.set_layout_engine("tight")
    lay_out(figure)  # names of classes decide how wide the panels are
    _mark_starts(figure, len(heads), events)
    return figure


def _mark_starts(figure: Figure, panels: int, events: Sequence[Event]) -> None:
    """Lines where sub-tasks start, and their names above the first panel."""
    starts = [event for event in events if isinstance(event, SubtaskStarted)]
    for panel in figure.axes[:panels]:
        for start in starts:
            panel.axvline(start.time, color="white", linewidth=1.5)
            panel.axvline(start.time, color="black", linewidth=0.8, linestyle="--" if start.detected else "-")
    low, high = figure.axes[0].get_xlim()
    letter = LETTER * (high - low) * figure.dpi / figure.axes[0].get_window_extent().width
    widths = [(room(start.label) + 1) * letter for start in starts]
    ends = [min(start.time + width, high) for start, width in zip(starts, widths, strict=True)]
    rows = stacked([(end - width, end) for end, width in zip(ends, widths, strict=True)], MOST_ROWS)
    for start, end, width, row in zip(starts, ends, widths, rows, strict=True):
        if row is not None:
            figure.axes[0].annotate(
                plain(start.label), (end - width, 1.0), (1, ABOVE + LINE * row), xycoords=("data", "axes fraction"),
                textcoords="offset points", fontsize=7,
            )  # fmt: skip
