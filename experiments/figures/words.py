"""Rate and distortion of words, their stability, and the snaps that are seen on them."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.figures.style import DPI, OURS, PEER, plain
from rcbht_jax.plots.canvas import new_figure

BLUE, RED, GREEN, ORANGE, PINK, SKY, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#999999"
)  # fmt: skip
# Colour, line style, width, marker; in the order of the legend.
LINES: dict[str, tuple[str, str, float, str]] = {
    "published rules": (RED, "-", 2.0, "s"),
    "fit": (BLUE, "-", 2.4, "o"),
    "fit, small window": (BLUE, "--", 2.0, "o"),
    "optimum": ("black", ":", 1.6, ""),
    "sliding window": (GREEN, "-", 1.2, "^"),
    "slide filter": (ORANGE, "-", 1.2, "v"),
    "swing filter": (PINK, "-", 1.2, "v"),
    "ABBA chain": (SKY, "-", 1.2, "D"),
    "fABBA symbols": (SKY, ":", 1.2, "D"),
    "1d-SAX": (GREY, "-", 1.2, "P"),
    "SAX": (GREY, ":", 1.2, "P"),
    "equal windows": ("0.35", "-.", 1.2, "x"),
}
RULES = {
    "published rules": (RED, "-", "s"),
    "fit": (BLUE, "-", "o"),
    "fit, tolerance of each copy": (SKY, "--", "D"),
    "bottom-up, as many as fit": ("black", ":", "x"),
}
ASKED = 0.9
TICKS = (0.05, 0.2, 0.5, 1, 2, 5, 10, 20, 50)  # words per second


def rate_distortion(result: dict[str, Any]) -> Figure:
    """A panel for each set: the residual of every method over its words per second."""
    figure = new_figure((12.0, 7.6), DPI)
    for number, name in enumerate(result["sets"]):
        ax = figure.add_subplot(2, -(-len(result["sets"]) // 2), number + 1)
        for method, (color, style, width, marker) in LINES.items():
            if row := result["rows"].get(f"rate | {name} | {method}"):
                points = sorted((at["words per second"], max(at["residual"], 1e-6)) for at in row["points"])
                ax.plot(*zip(*points, strict=True), color=color, linestyle=style, linewidth=width, marker=marker,
                        markersize=3.5, label=method)  # fmt: skip
        ax.set_xscale("log")
        ax.set_yscale("log")
        low, high = ax.get_xlim()
        ticks = [tick for tick in TICKS if low <= tick <= high]
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        ax.set_title(f"{name}, {result['sets'][name]['rate']:.0f} Hz", fontsize=10)
        ax.grid(alpha=0.3)
        plain(ax)
    figure.supxlabel("words per second and axis", fontsize=9, y=0.1)
    figure.supylabel("residual, 1 - R² (mean over axes)", fontsize=9)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncols=4, frameon=False, fontsize=8)
    figure.tight_layout(rect=(0.01, 0.06, 1, 1))
    return figure


def stability(result: dict[str, Any]) -> Figure:
    """Share of long primitives that stay: over noise, above; over the rate of the copy, below."""
    rows = result["rows"]
    names = list(dict.fromkeys(row.split(" | ")[1] for row in rows if row.startswith("noise")))
    figure = new_figure((11.0, 6.2), DPI)
    kinds = {
        "noise": "deviation of the noise, in tolerances",
        "resampled": "rate of the copy, Hz (the recording: 200)",
    }
    for number, (kind, what) in enumerate(kinds.items()):
        for place, name in enumerate(names):
            ax = figure.add_subplot(2, len(names), number * len(names) + place + 1)
            for rule, look in RULES.items():
                if row := rows.get(f"{kind} | {name} | {rule}"):
                    _kept(ax, row, rule, *look)
            ax.set_xscale("log")
            levels = next(list(rows[row]) for row in rows if row.startswith(f"{kind} | {name}"))
            ax.set_xticks([float(level) for level in levels], levels)
            ax.minorticks_off()
            ax.axhline(ASKED, color="0.4", linestyle=":", linewidth=1)
            ax.set_ylim(0, 1.02)
            ax.set_xlabel(what, fontsize=8)
            ax.set_title(name, fontsize=10)
            ax.grid(alpha=0.3)
            plain(ax)
    figure.supylabel("share of primitives over 0.1 s that stay (dotted: asked)", fontsize=9)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(RULES), frameon=False, fontsize=8)
    figure.tight_layout(rect=(0, 0.04, 1, 1))
    return figure


def _kept(ax: Axes, row: dict[str, Any], rule: str, color: str, style: str, marker: str) -> None:
    """One rule, with the interval of each share as a band; levels without any long word are left out."""
    known = [(float(level), one) for level, found in row.items() if (one := found["primitive"])["kept"] is not None]
    if known:
        levels, shares = [level for level, _ in known], [one["kept"] for _, one in known]
        ends = [one.get("kept interval", [one["kept"]] * 2) for _, one in known]
        ax.fill_between(levels, *zip(*ends, strict=True), color=color, alpha=0.15, linewidth=0)
        ax.plot(levels, shares, color=color, linestyle=style, marker=marker, markersize=4, label=rule)


def snaps(result: dict[str, Any]) -> Figure:
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
