"""Figures of fault detection: simulated faults by severity, and the types of the authors' failures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.figures.style import DPI, plain
from rcbht_jax.plots.canvas import new_figure

# Colours that are distinct for any colour vision; errors have warm ones.
PARTS = {
    "seats, no alarm": "#cfd8dc",
    "seats, alarm": "#E69F00",
    "fails, detected in time": "#0072B2",
    "fails, missed": "#000000",
}


def faults(presets: dict[str, Any]) -> Figure:
    """Bars of streamed trials by kind and severity: a row of panels per session, a column per kind."""
    kinds = list(next(iter(presets.values()))["kinds"])
    figure = new_figure((11.5, 2.1 * len(presets) + 0.9), DPI)
    panels = figure.subplots(len(presets), 1 + len(kinds), sharey=True, squeeze=False)
    for row, (session, preset) in zip(panels, presets.items(), strict=True):
        bars(row[0], ["all"], [nominal(preset)])
        for ax, kind in zip(row[1:], kinds, strict=True):
            grades, causes = (preset["kinds"][kind][name] for name in ("by grade", "by cause"))
            cells = list((grades or causes).values())
            cells = cells[::-1] if kind == "early-stop" else cells  # the later it stops, the less is missing
            names = [str(k + 1) for k in range(len(cells))] if grades else [name.split()[-1] for name in causes]
            bars(ax, names, map(of_cell, cells))
        row[0].set_ylabel(f"session {session}\nshare of streamed trials", fontsize=8)
    for ax, kind in zip(panels[0], ["no fault", *kinds], strict=True):
        ax.set_title(kind.replace("-", " "), fontsize=9)
    handles = [panels[0, 0].bar(np.nan, 0, color=color, label=name) for name, color in PARTS.items()]
    figure.legend(handles=handles, loc="lower center", ncols=len(PARTS), frameon=False, fontsize=8)
    figure.supxlabel("severity of the fault, from the mildest grade to the worst", fontsize=9, y=0.055)
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    return figure


def nominal(preset: dict[str, Any]) -> tuple[int, int, int, int]:
    """Counts of trials without a fault."""
    streamed = sum(preset["nominal trials streamed in each repeat"])
    false = sum(preset["false alarms in each repeat"])
    return streamed - false, false, 0, 0


def of_cell(cell: dict[str, Any]) -> tuple[int, int, int, int]:
    """Counts of trials with a fault, in the order of ``PARTS``."""
    alarmed, seated = cell["of them alarmed"], cell["seated all the same"]
    return seated - alarmed, alarmed, cell["detected"], cell["failures streamed"] - cell["detected"]


def bars(ax: Axes, names: list[str], counts: Any) -> None:
    """A stacked bar per grade."""
    table = np.array(list(counts), float).reshape(len(names), len(PARTS))
    shares = table / table.sum(1, keepdims=True)
    below = np.zeros(len(names))
    for share, color in zip(shares.T, PARTS.values(), strict=True):
        ax.bar(names, share, bottom=below, color=color, width=0.8)
        below = below + share
    ax.set_ylim(0, 1)
    plain(ax)


def failure_types(classes: list[str], counts: list[list[int]], title: str) -> Figure:
    """Confusion of failure types, as shares of the true type."""
    table = np.array(counts, float)
    shares = table / table.sum(1, keepdims=True)
    figure = new_figure((6.6, 6.0), DPI)
    ax = figure.subplots()
    ax.imshow(shares, vmin=0, vmax=1, cmap="Blues")
    for (y, x), share in np.ndenumerate(shares):
        if share:
            color = "white" if share > 0.5 else "black"
            ax.text(x, y, f"{share:.0%}", ha="center", va="center", fontsize=7, color=color)
    ax.set_xticks(range(len(classes)), classes, rotation=90, fontsize=8)
    ax.set_yticks(
        range(len(classes)), [f"{c} ({n:.0f})" for c, n in zip(classes, table.sum(1), strict=True)], fontsize=8
    )
    ax.set_xlabel("predicted at the end of the record", fontsize=9)
    ax.set_ylabel("true failure type (trials)", fontsize=9)
    figure.suptitle(title, fontsize=9)
    figure.tight_layout()
    return figure
