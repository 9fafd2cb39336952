"""A snap hook on the bench: its geometry, its curves, and measured against computed forces."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from experiments.figures.style import DPI, plain
from rcbht_jax.plots.canvas import new_figure
from sim_mjx.assembly.hook import Hook, first_touch, lip_boxes

BLUE, RED, ORANGE, GREY = "#0072B2", "#D55E00", "#E69F00", "0.45"
MM = 1e3


def bench(result: dict[str, Any]) -> Figure:
    """Geometry, one tab, a part of four, and every combination of the grid."""
    names = Hook.__dataclass_fields__
    hook = Hook(**{name: value for name, value in result["tab"].items() if name in names})
    figure = new_figure((12.0, 6.6), DPI)
    axes = figure.subplots(2, 2, gridspec_kw={"width_ratios": (1, 1.35)})
    geometry(axes[0, 0], hook)
    one_tab(axes[0, 1], result)
    agreement(axes[1, 0], result["grid"]["1.25 ms"])
    whole_part(axes[1, 1], result)
    for ax in axes.flat:
        plain(ax)
    figure.tight_layout()
    return figure


def geometry(ax: Axes, hook: Hook) -> None:
    """The lip, and the tip as it touches, as it passes and as it is held."""
    for place, turn, size in lip_boxes(hook).values():
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, turn)
        along, _, normal = matrix.reshape(3, 3).T[:, [0, 2]]
        corners = [
            place[[0, 2]] + a * size[0] * along + b * size[2] * normal for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))
        ]
        ax.add_patch(Polygon(np.array(corners) * MM, color="0.8", zorder=0))
    free = hook.overlap - hook.tip_radius
    held = -first_touch(hook) - hook.tip_radius
    for x, z, what, look in (
        (free, first_touch(hook), "first touch", {"facecolor": "none", "edgecolor": ORANGE}),
        (-hook.tip_radius, hook.edge / 2, "passing, bent by the overlap", {"facecolor": ORANGE, "alpha": 0.5}),
        (free, held, "sprung back, held", {"facecolor": ORANGE}),
    ):
        ax.add_patch(Circle((x * MM, z * MM), hook.tip_radius * MM, linewidth=1.4, **look))
        ax.annotate(
            what, (x * MM - hook.tip_radius * MM, z * MM), (-1.0, z * MM), ha="right", va="center", fontsize=8.5
        )
    ax.annotate("lead-in", (0.75, 0.55), ha="left", fontsize=8.5, color=BLUE)
    ax.annotate("retention face", (0.7, -1.0), ha="left", fontsize=8.5, color=RED)
    ax.annotate("", (-3.9, -1.2), (-3.9, 1.4), arrowprops={"arrowstyle": "->", "color": GREY})
    ax.text(-3.8, -1.1, "insertion", fontsize=8.5, color=GREY, va="center")
    ax.set_aspect("equal")
    ax.set_xlim(-4.2, 2.4)
    ax.set_ylim(-2.0, 2.1)
    ax.set_xlabel("mm", fontsize=9)
    ax.set_ylabel("mm", fontsize=9)
    ax.set_title("A tip, its lip, and three places on the way", fontsize=10)


def one_tab(ax: Axes, result: dict[str, Any]) -> None:
    """Press and pull of the camera's tab, new and worn, and the computed peaks."""
    for name, style in (("one tab", "-"), ("one tab, worn", "--")):
        curves, row = result["curves"][name], result["parts"][name]
        for kind, color, theory in (
            ("press", BLUE, "mating force of a tab"),
            ("pull", RED, "separation force of a tab"),
        ):
            curve = curves[kind]
            ax.plot(curve["travel"], curve["force"], color=color, linestyle=style, linewidth=1.6,
                    label=f"{kind}{name.removeprefix('one tab')}")  # fmt: skip
            peak = row[theory] * (1 if kind == "press" else -1)
            ax.axhline(peak, color=color, linestyle=":", linewidth=1)
            ax.text(2.92, peak, f"theory {abs(peak):.1f} N", color=color, fontsize=8, va="bottom", ha="right")
    ax.axhline(0, color="0.7", linewidth=0.8)
    ax.set_xlim(-0.3, 2.95)
    ax.set_xlabel("travel of the hand, mm", fontsize=9)
    ax.set_ylabel("force on the hand, N", fontsize=9)
    ax.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 0.06))
    ax.set_title("One tab of the camera: rises, gives way, pulls itself in, and holds", fontsize=10)


def agreement(ax: Axes, rows: list[dict[str, float]]) -> None:
    """Measured against computed force, one dot a hook."""
    for kind, theory, color in (("press", "mating force", BLUE), ("pull", "separation force", RED)):
        ax.plot([row[theory] for row in rows], [row[kind] for row in rows], "o", color=color, markersize=4, label=kind)
    span = np.array([0.0, 1.05 * max(row["separation force"] for row in rows)])
    ax.plot(span, span, color="black", linewidth=0.8)
    ax.fill_between(span, 0.9 * span, 1.1 * span, color="0.9", linewidth=0, label="within 10 %")
    ax.set_xlabel("formula, N", fontsize=9)
    ax.set_ylabel("bench, N", fontsize=9)
    ax.legend(fontsize=8, frameon=False)
    ax.set_title(f"{len(rows)} hooks: angle x friction x overlap", fontsize=10)


def whole_part(ax: Axes, result: dict[str, Any]) -> None:
    """A part with four tabs, pressed straight and two after two."""
    for name, color in (("four tabs, straight", GREY), ("four tabs, two after two", BLUE)):
        curve = result["curves"][name]["press"]
        ax.plot(
            curve["travel"], curve["force"], color=color, linewidth=1.6, label=f"{name.removeprefix('four tabs, ')}"
        )
    ax.axhline(0, color="0.7", linewidth=0.8)
    ax.axhspan(16, 18, color=ORANGE, alpha=0.3, linewidth=0, label="recorded when tabs give way")
    ax.set_xlabel("travel of the hand, mm", fontsize=9)
    ax.set_ylabel("force on the hand, N", fontsize=9)
    ax.legend(fontsize=8, frameon=False)
    ax.set_title("A part of four tabs", fontsize=10)
