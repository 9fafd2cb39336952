"""Picture of the snaps in the recorded session B: found afterwards in the whole trial, and detected in the stream."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from experiments.figures.style import DPI, OURS, PEER, plain
from rcbht_jax.plots.canvas import new_figure


def draw(result: dict[str, Any]) -> Figure:
    """A row for each trial of session B, seated ones above; s on the abscissa."""
    trials = sorted(result["recorded"]["B"]["trials"].items(), key=lambda item: item[1]["seated"])
    figure = new_figure((10.0, 5.0), DPI)
    ax = figure.add_subplot()
    for row, (_, facts) in enumerate(trials):
        read, seen = facts["read, s"], facts["seen, s"]
        ax.plot(read, [row] * len(read), "o", color=PEER, markersize=10, fillstyle="none", markeredgewidth=1.6)
        ax.plot(seen, [row] * len(seen), "|", color=OURS, markersize=13, markeredgewidth=2.2)
    ax.plot([], [], "o", color=PEER, fillstyle="none", markeredgewidth=1.6, label="read afterwards, filter inverted")
    ax.plot([], [], "|", color=OURS, markersize=13, markeredgewidth=2.2, label="seen on words, as it was streamed")
    off = sum(not facts["seated"] for _, facts in trials)
    ax.axhline(off - 0.5, color="0.6", linewidth=0.8)
    ax.set_yticks(
        range(len(trials)), [f"{name[-2:]}{'' if facts['seated'] else ', off seat'}" for name, facts in trials]
    )
    ax.set(xlim=(4, 30), ylim=(-0.7, len(trials) - 0.3), xlabel="time, s; snaps after 30 s are not shown")
    ax.set_ylabel("trial of session B")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 1.1), ncols=2, frameon=False)
    plain(ax)
    figure.tight_layout()
    return figure
