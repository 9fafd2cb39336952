"""One trial at a glance: the arm and the parts at the moments that matter, tabs, wrench and labels beneath."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from rcbht_jax.labels import AXES, COLORS
from rcbht_jax.plots.canvas import label_legend, new_figure, plain, scale_in_margin
from rcbht_jax.plots.trial import outcome_of
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx.plots.projection import ABOVE, SEATED, SIDE, Drawing
from sim_mjx.validation.replay import PASSES, Replay

INCHES, DPI = (16.0, 14.5), 100
FRAMES = 7  # moments shown, at most
CLOSE = 0.35  # s, moments within it share a frame
SEEN = 0.05  # s, from which on moments of one frame state their own times
ALONE = "before touch", "end"  # moments with frames of their own
WIDE = 23  # letters beside a frame's edges
SHADES = ("#f7f7f7", "#e8eef7", "#d9e6d8", "#fbeed5", "#efe3f0")  # background of the states, in turn
XYZ = ("#1b6ca8", "#5aa469", "#d1495b")  # colours of the axes
TAB_COLORS = ("#1b6ca8", "#6baed6", "#b2182b", "#f4a582")
TAB_STYLES: tuple[Any, ...] = ("solid", (0, (4, 3)), "solid", (0, (4, 3)))  # right and left tabs often coincide
LETTERS = "abcdefg"
LETTER = 8.0  # pixels of one letter of a state's name
PLATE = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1.0}  # behind a name that a line may cross


def trial_overview(
    replay: Replay,
    recordings: Recordings,
    tracks: LabelTracks,
    row: int,
    moments: Mapping[str, float],
    words: str = "",
) -> Figure:
    """The figure of one trial.

    Args:
        replay: the motion. recordings: the trial's data set. tracks: its labels. row: of the trial in both.
        moments: to show, name -> s, in order.
        words: description of the labels, for the title.
    """
    figure = new_figure(INCHES, DPI)
    frames = choose(moments)
    grid = figure.add_gridspec(
        5, 1, left=0.06, right=0.985, top=0.9, bottom=0.078, height_ratios=(3.2, 1.0, 1.5, 1.2, 1.3), hspace=0.1
    )
    strip = grid[0].subgridspec(2, len(frames), hspace=0.04, wspace=0.06)
    for column, (name, seconds) in enumerate(frames.items()):
        pair = (figure.add_subplot(strip[0, column]), figure.add_subplot(strip[1, column]))
        still(pair, replay, seconds)
        heading = f"{LETTERS[column]}   {seconds:.2f} s\n{plain(fill(name, WIDE, break_long_words=False))}"
        pair[0].set_title(heading, fontsize=11, loc="left", pad=4)
    panels = [figure.add_subplot(grid[1])]
    panels += [figure.add_subplot(grid[i], sharex=panels[0]) for i in (2, 3, 4)]
    trial_tabs(panels[0], replay)
    _wrench(panels[1], recordings, row, range(3), "force, N")
    _wrench(panels[2], recordings, row, range(3, 6), "moment, Nm")
    used = _labels(panels[3], tracks, row, recordings.dt)
    for panel in panels:
        shade_states(panel, recordings, row, names=panel is panels[0])
        panel.set_xlim(0, len(replay.qpos) * replay.dt)
        for letter, seconds in zip(LETTERS, frames.values(), strict=False):
            panel.axvline(seconds, color="0.25", linewidth=0.8, linestyle=(0, (2, 2)))
            if panel is panels[0]:
                _letter(panel, letter, seconds)
        panel.tick_params(labelbottom=panel is panels[-1])
    panels[-1].set_xlabel("time, s", fontsize=11)
    label_legend(figure, "llb", used, (0.06, 0.002), 7)
    title = ", ".join(filter(None, (f"{headline(replay, recordings, row)}\n{replay.how}", words)))
    figure.suptitle(plain(title), x=0.06, y=0.988, ha="left", va="top", fontsize=14)
    return figure


def _letter(ax: Axes, letter: str, seconds: float) -> None:
    """Name of a frame beside its line; at the beginning on the right, where no scale is."""
    side = -1 if seconds > 0.02 * ax.get_xlim()[1] else 1
    ax.annotate(letter, (seconds, 0.0), (3 * side, 4), xycoords=ax.get_xaxis_transform(), textcoords="offset points",
                ha="right" if side < 0 else "left", fontsize=11, weight="bold")  # fmt: skip


def choose(moments: Mapping[str, float]) -> dict[str, float]:
    """At most ``FRAMES`` moments: what happens at nearly the same time shares a frame, shown at its last moment.

    Names of earlier moments of a frame carry their own times.
    """
    groups = [[moment] for moment in moments.items()]
    while (first := _closest(groups, CLOSE if len(groups) <= FRAMES else np.inf)) is not None:
        groups[first : first + 2] = [groups[first] + groups[first + 1]]
    return {_joined(group): group[-1][1] for group in groups}


def _closest(groups: list[list[tuple[str, float]]], limit: float) -> int | None:
    """First of the two neighbours that would span least in one frame, if less than ``limit``; none needs its own."""
    spans = {
        pair[1][-1][1] - pair[0][0][1]: first
        for first, pair in reversed(list(enumerate(pairwise(groups))))
        if not any(name in ALONE for group in pair for name, _ in group)
    }
    return spans[min(spans)] if spans and min(spans) < limit else None


def _joined(group: list[tuple[str, float]]) -> str:
    """Several tabs that pass their lips are named together."""
    shown = group[-1][1]
    own = {name: f" ({seconds:.2f} s)" if shown - seconds > SEEN else "" for name, seconds in group}
    tabs = [f"{name.removesuffix(PASSES)}{time}" for name, time in own.items() if name.endswith(PASSES)]
    rest = [f"{name}{time}" for name, time in own.items() if not name.endswith(PASSES)]
    return ", ".join([*rest, f"{' '.join(tabs)}{PASSES}"] if tabs else rest)


def still(pair: tuple[Axes, Axes], replay: Replay, seconds: float) -> tuple[Drawing, Drawing]:
    """Draw arms and parts at one moment: one arm from the robot's right, two from above.

    Of an assembly other than the camera's, the whole arm, and the parts cut open, both from the side.
    """
    index = min(round(seconds / replay.dt), len(replay.qpos) - 1)
    one = replay.of_parts or all(not replay.model.body(i).name.startswith("LARM") for i in range(replay.model.nbody))
    if replay.of_parts:
        options: list[dict[str, Any]] = [{"marks": replay.marks}, {"marks": replay.marks, "cut_at": "MOUNT"}]
    else:
        options = [{"missing": replay.missing}] * 2
    view = SIDE if one else ABOVE
    drawings = [Drawing(ax, replay.model, view, **each) for ax, each in zip(pair, options, strict=True)]
    for ax, drawing in zip(pair, drawings, strict=True):
        drawing.show(replay.qpos[index], replay.past[index])
        ax.set(xticks=[], yticks=[])
    far, close = drawings
    x, y = far.place("MOUNT")
    if replay.of_parts:
        _look_for(pair[0], far.arm(), x / 2, y + 0.25, 0.42)
        _look_for(pair[1], close.tips(), x, y + 0.021, 0.042)
    else:
        for ax in pair:
            ax.spines[:].set_color("0.75")
        _look_at(pair[0], *((0.16, y + 0.22, 0.27) if one else (0.2, 0.0, 0.33)))
        _look_for(pair[1], close.tips(), *((x - 0.02, y + 0.018, 0.034) if one else (x - 0.02, y - 0.015, 0.035)))
    return far, close


def _look_for(ax: Axes, places: Float64[np.ndarray, "place 2"], x: float, y: float, half: float) -> None:
    """As :func:`_look_at`, from farther away where one of the places would be outside."""
    away = np.abs(places - (x, y)).max(initial=0.0)
    _look_at(ax, x, y, half if away < half else away + half / 2)


def _look_at(ax: Axes, x: float, y: float, half: float) -> None:
    """Show a window of at least ``half`` metres to every side of a point."""
    box = ax.get_window_extent()
    wide = box.width / box.height
    ax.set(xlim=(x - half * max(wide, 1.0), x + half * max(wide, 1.0)))
    ax.set(ylim=(y - half * max(1.0 / wide, 1.0), y + half * max(1.0 / wide, 1.0)))


def trial_tabs(ax: Axes, replay: Replay) -> None:
    """Height of each tab, or of each mark, over time, in one axes."""
    times = np.arange(len(replay.height)) * replay.dt
    for tab, mark in enumerate(replay.marks):
        name = mark.removeprefix("TIP_").lower() if replay.of_parts else mark
        gone = name in replay.missing
        height = np.full(len(times), np.nan) if gone else replay.height[:, tab] * 1e3
        color = TAB_COLORS[tab % len(TAB_COLORS)]
        style = TAB_STYLES[tab] if tab < len(TAB_STYLES) else "dotted"
        label = f"{name} (missing)" if gone else name
        ax.plot(times, height, color=color, linestyle=style, linewidth=1.8, label=label)
    _legend(ax, 4, 0.7)
    ax.set_ylabel("part above\nits socket, mm" if replay.of_parts else "tips above\ntheir lips, mm", fontsize=11)
    if not replay.of_parts:
        ax.axhline(0, color=SEATED, linewidth=1.2)
        ax.annotate("below the lip\n(past: sprung back)", (0.005, 0), (0, -4), xycoords=ax.get_yaxis_transform(),
                    textcoords="offset points", va="top", color=SEATED, fontsize=9)  # fmt: skip
        ax.set(ylim=(-5, 12))


def _legend(ax: Axes, columns: int, top: float) -> None:
    ax.legend(loc="upper right", ncols=columns, fontsize=9, frameon=False, borderaxespad=0.2, bbox_to_anchor=(1.0, top))


def _wrench(ax: Axes, recordings: Recordings, row: int, axes: range, title: str) -> None:
    values = recordings.wrench[row, : recordings.length[row]]
    times = np.arange(len(values)) * recordings.dt
    for axis, color in zip(axes, XYZ, strict=True):
        ax.plot(times, values[:, axis], color=color, linewidth=1.2, label=AXES[axis])
    ax.set_ylabel(title, fontsize=11)
    scale_in_margin(ax)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.2 * (high - low))  # the legend must not cover a force that lasts
    _legend(ax, 3, 1.0)
    ax.grid(axis="y", color="0.85", linewidth=0.6)


def _labels(ax: Axes, tracks: LabelTracks, row: int, dt: float) -> set[int]:
    """One band of low-level behaviours per axis; returns the labels that occur."""
    used: set[int] = set()
    for axis in range(6):
        label, t0, t1 = (np.asarray(getattr(tracks.llb, name))[row, axis] for name in ("label", "t0", "t1"))
        kept = label > 0
        spans = [
            [(a, axis + 0.06), (a, axis + 0.94), (b, axis + 0.94), (b, axis + 0.06)]
            for a, b in zip(t0[kept] * dt, t1[kept] * dt, strict=True)
        ]
        ax.add_collection(PolyCollection(spans, facecolors=[COLORS["llb"][code - 1] for code in label[kept]]))
        used |= {int(code) for code in label[kept]}
    ax.set(ylim=(6, 0))
    ax.set_yticks(np.arange(6) + 0.5, AXES)
    ax.tick_params(axis="y", length=0)
    return used


def shade_states(ax: Axes, recordings: Recordings, row: int, names: bool) -> None:
    """Background and, if wanted, names of the states."""
    marks = recordings.annotations
    track = HARMONISED if HARMONISED in marks.labels else marks.choose()
    onset = recordings.starts(track)[row]
    known = np.flatnonzero(np.isfinite(onset))
    ends = [*onset[known][1:], recordings.length[row] * recordings.dt]
    pixels = ax.get_window_extent().width / (recordings.length[row] * recordings.dt)
    rows: list[float] = []  # s, where the last name of each row ends
    for state, end in zip(known, ends, strict=True):
        ax.axvspan(onset[state], end, color=SHADES[state % len(SHADES)], zorder=-1)
        if names:
            where: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "textcoords": "offset points"}
            name, middle = marks.labels[track][state], (onset[state] + end) / 2
            half = (LETTER * len(name) + 8) / 2 / pixels
            middle = max(min(middle, recordings.length[row] * recordings.dt - half), half)  # whole, within the panel
            line = next((line for line, last in enumerate(rows) if last <= middle - half), len(rows))
            rows[line : line + 1] = [middle + half]
            ax.annotate(
                plain(name), (middle, 1.0), (0, -11 - 12 * line), ha="center", fontsize=10, color="0.3", bbox=PLATE,
                **where,
            )  # fmt: skip


def headline(replay: Replay, recordings: Recordings, row: int) -> str:
    """Name and outcome of a replayed trial, with its fault or its passed tabs, on one line."""
    facts = f"{recordings.trial[row]}   ·   {recordings.source[row]}, {outcome_of(recordings, row)}"
    if replay.of_parts:
        return facts
    past = [replay.marks[tab % 4] for tab in np.flatnonzero(replay.past[-1])]
    return f"{facts}; tabs past their lips: {' '.join(past) or 'none'}"
