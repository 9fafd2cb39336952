"""One trial: its wrench, or other signals, axis by axis, each above its three layers of labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rcbht_jax._util.arms import title_among
from rcbht_jax._util.columns import measured
from rcbht_jax._util.printable import printable, room
from rcbht_jax.errors import InputError
from rcbht_jax.labels import COLORS, LAYERS, name
from rcbht_jax.plots.canvas import (
    check_rows,
    cut,
    label_legend,
    new_figure,
    plain,
    scale_in_margin,
    stacked,
    text_color,
)
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WIDTH, DPI = 16.0, 100  # inches, 1600 pixels; six axes are 2000 pixels high
LEFT, RIGHT = 0.062, 0.98  # figure coordinates
HEAD, FOOT, PANEL, GAP = 1.24, 2.1, 2.505, 0.326  # inches: title and two rows of names, legends, an axis, between two
SIGNAL, BARE_FOOT = 2.5, 0.7  # height of a signal in heights of its bands; foot in inches where there are no labels
CLEAR = 0.05  # of the height of a signal, without a value above the bands
MARGIN = 0.24  # inches above the title
LINE, ROOM, MOST_ROWS = 16, 2, 14  # of names of states: points of a row, rows that fit into the head, most rows
LONG = 17, 22  # letters that fit beside a panel in the usual size, and in the small one
WIDE = 80, 125  # letters that fit into the two lines of the title, the first one beside the key
_BAND_TITLES = ("primitive", "MC", "LLB")
_RED = "#b2182b"  # of the state boundaries
_STYLE: dict[bool, Any] = {False: "solid", True: (0, (4, 3))}  # by Mark.dashed
_LETTER = 8.0  # pixels of one letter of a label's name, at most


@dataclass(frozen=True)
class Mark:
    """The start of an annotated interval."""

    seconds: float
    text: str
    dashed: bool  # of a track that corrects the first one, where the two differ


@dataclass(frozen=True)
class _View:
    """The part of a trial to show, in seconds."""

    start: float
    stop: float
    dt: float

    @property
    def pixels(self) -> float:
        """Pixels per second."""
        return WIDTH * DPI * (RIGHT - LEFT) / (self.stop - self.start)


def trial_figure(
    recordings: Recordings,
    tracks: LabelTracks | None,
    index: int,
    *,
    window: int | None = None,
    rule: str = "paper",
    seconds: tuple[float, float] | None = None,
) -> Figure:
    """Signals and state boundaries of one recording, and its fitted lines and labels if it has some.

    >>> import rcbht_jax as rj
    >>> recordings = Recordings.from_arrays(np.random.default_rng(0).normal(size=(3, 400, 6)).cumsum(1), 200.0)
    >>> figure = trial_figure(recordings, rj.encode(recordings.wrench, window=5), 0, window=5)

    Args:
        recordings: data set.
        tracks: its labels ``[recording, axis, slot]``; None = none, so that there are no lines and no bands.
        index: row of the recording.
        window: samples per straight-line fit, for the title.
        rule: of the words, for the title, which names any but the paper's.
        seconds: start and end of the part to show; default the whole recording.

    Raises:
        InputError: the row does not exist, the tracks do not belong to the recordings, or ``seconds`` selects nothing.
    """
    if tracks is not None:
        check_rows(recordings, tracks)
    if not 0 <= index < len(recordings):
        raise InputError(f"Recording {index} does not exist; the data set has {len(recordings)}, counted from 0.")
    view = _view(recordings, index, seconds)
    marks = [mark for mark in state_marks(recordings, index) if view.start <= mark.seconds < view.stop]
    names = _name_rows(marks, view)
    head = HEAD + LINE / 72 * max(0, len({row for *_, row in names}) - ROOM)
    figure, panels = _canvas(recordings.axes, head, tracks is not None)
    used: dict[str, set[int]] = {layer: set() for layer in LAYERS}
    for axis, panel in enumerate(panels):
        _draw_signal(panel[0], recordings, index, axis, view)
        _draw_marks(panel, marks)
        if tracks is None:
            continue
        lanes = [_lane(getattr(tracks, layer), index, axis, view) for layer in LAYERS]
        _draw_fits(panel[0], lanes[0], recordings.dt)
        _draw_bands(panel[1], lanes, view)
        _clear_lowest(panel[0])
        for layer, lane in zip(LAYERS, lanes, strict=True):
            used[layer].update(int(code) for code in lane.label)
    _name_marks(panels[0][0], names)
    panels[-1][-1].set_xlabel("time, s", fontsize=11)
    panels[-1][-1].ticklabel_format(axis="x", useOffset=False)  # there is room for whole numbers
    top, title = 1 - MARGIN / figure.get_figheight(), plain(_title(recordings, index, window, rule))
    figure.suptitle(title, x=LEFT, y=top, ha="left", va="top", fontsize=14)
    _legends(figure, used)
    _key(figure, panels[0][0], marks, measured(recordings.axes, recordings.units))
    return figure


def outcome_of(recordings: Recordings, index: int) -> str:
    """Outcome of one recording, and its columns of text: such as "failure (fault: jamming)" or "outcome unknown"."""
    texts = {name: str(values[index]) for name, values in recordings.columns.items() if values.dtype.kind == "U"}
    facts = ", ".join(f"{name.replace('_', ' ')}: {cut(text, 40)}" for name, text in texts.items() if text)
    outcome = str(recordings.outcome[index]).replace("unknown", "outcome unknown")
    return f"{outcome} ({facts})" if facts else outcome


def state_marks(recordings: Recordings, index: int) -> list[Mark]:
    """Starts of the intervals of the first track of one recording, and of those that its harmonised variant moves."""
    first = next(iter(recordings.annotations.labels), "")
    corrected = recordings.annotations.choose()
    if not first:
        return []
    logged = _starts(recordings, first, index)
    marks = [Mark(seconds, label, False) for label, seconds in logged]
    for label, seconds in _starts(recordings, corrected, index) if corrected != first else ():
        if not any(name == label and abs(seconds - start) < recordings.dt / 2 for name, start in logged):
            marks.append(Mark(seconds, f"{label}, harmonised", True))
    return sorted(marks, key=lambda mark: mark.seconds)


def _starts(recordings: Recordings, track: str, index: int) -> list[tuple[str, float]]:
    marks = recordings.annotations.of_recording(index).of(track)
    return list(zip(marks.names().tolist(), marks.start.tolist(), strict=True))


def fitted_lines(lane: LabelTrack, dt: float) -> Float[np.ndarray, "slot 2 2"]:
    """Both end points (s, unit of the axis) of the line of every primitive of one axis ``[slot]``.

    A line runs from the first to the last sample of its span and passes through the mean at its middle.
    """
    first, last = lane.t0 * dt, (lane.t1 - 1) * dt
    half = np.asarray(lane.grad, np.float64) * (last - first) / 2
    begin, end = np.stack([first, lane.avg - half], -1), np.stack([last, lane.avg + half], -1)
    return np.stack([begin, end], 1)


def _view(recordings: Recordings, index: int, seconds: tuple[float, float] | None) -> _View:
    duration = float(recordings.length[index] * recordings.dt)
    start, stop = (0.0, duration) if seconds is None else seconds
    times = np.arange(recordings.length[index]) * recordings.dt
    start = max(start, 0.0)
    if not (start < min(stop, duration) and ((times >= start) & (times <= stop)).any()):
        raise InputError(f"No sample lies between {start:g} s and {stop:g} s; the recording lasts {duration:g} s.")
    return _View(start, min(stop, duration), recordings.dt)


def _lane(track: LabelTrack, index: int, axis: int, view: _View) -> LabelTrack:
    """The labels of one axis that are in view, without empty slots."""
    lane = LabelTrack(**{field: np.asarray(values)[index, axis] for field, values in vars(track).items()})
    visible = (lane.label > 0) & (lane.t1 * view.dt > view.start) & (lane.t0 * view.dt < view.stop)
    return LabelTrack(**{field: values[visible] for field, values in vars(lane).items()})


def _canvas(axes: tuple[str, ...], head: float, bands: bool) -> tuple[Figure, list[tuple[Axes, ...]]]:
    """A figure, ``head`` inches below its top the signal of each axis, above its bands if there are some."""
    foot, panel = (FOOT, PANEL) if bands else (BARE_FOOT, PANEL * SIGNAL / (SIGNAL + 1))
    height = round(head + foot + len(axes) * panel + (len(axes) - 1) * GAP, 2)
    figure = new_figure((WIDTH, height), DPI)
    grid = figure.add_gridspec(
        len(axes), 1, left=LEFT, right=RIGHT, bottom=foot / height, top=1 - head / height, hspace=GAP / panel
    )
    panels: list[tuple[Axes, ...]] = []
    for axis, title in enumerate(axes):
        rows = grid[axis].subgridspec(2, 1, height_ratios=(SIGNAL, 1.0), hspace=0) if bands else [grid[axis]]
        signal = figure.add_subplot(rows[0], sharex=panels[0][0] if panels else None)
        signal.set_gid(f"signal-{printable(title)}")
        signal.tick_params(labelsize=10)
        scale_in_margin(signal)
        panels.append((signal,))
        if bands:
            band = figure.add_subplot(rows[1], sharex=signal)
            band.set_gid(f"labels-{printable(title)}")
            band.tick_params(labelsize=10)
            signal.tick_params(bottom=False, labelbottom=False)
            panels[-1] = signal, band
        panels[-1][-1].tick_params(labelbottom=axis == len(axes) - 1)
    return figure, panels


def _draw_signal(ax: Axes, recordings: Recordings, index: int, axis: int, view: _View) -> None:
    values = recordings.wrench[index, : recordings.length[index], axis]
    times = np.arange(len(values)) * recordings.dt
    dot = "o" if len(values) == 1 else ""  # of which there would be no line
    ax.plot(times, values, color="0.72", linewidth=2.6, gid="wrench", solid_joinstyle="round", marker=dot)
    visible = values[(times >= view.start) & (times <= view.stop)]
    visible = visible[np.isfinite(visible)]  # of a gap there is nothing to see
    low, high = (float(visible.min()), float(visible.max())) if len(visible) else (0.0, 0.0)
    margin = 0.08 * (high - low) or 0.05 * abs(high) or 1e-3  # of a constant
    ax.set(xlim=(view.start, view.stop), ylim=(low - margin, high + margin))
    _name_axis(ax, recordings.axes[axis], recordings.units[axis])
    ax.grid(axis="y", color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)


def _name_axis(ax: Axes, name: str, unit: str) -> None:
    """Name and unit beside a panel; long ones in two lines, not beyond the panel's height, the unit whole."""
    end = f", {cut(unit, LONG[1] - 4)}" if unit else ""
    text = name + end
    short, most = room(text) <= LONG[0], LONG[1] * len(text) // max(1, room(text))
    lines = [text] if short else [line.replace("_ ", "_") for line in wrap(text.replace("_", "_ "), most)]
    if len(lines) > 2:
        lines = [lines[0], cut(name[len(lines[0]) :].lstrip(), LONG[1] - len(end)) + end]
    small: dict[str, Any] = {} if short else {"labelpad": 1.0, "linespacing": 1.0}
    ax.set_ylabel(plain("\n".join(lines)), fontsize=12 if short else 8, **small)


def _clear_lowest(ax: Axes) -> None:
    """Leave out values so near to the lower edge of a panel that they run into the titles of its bands."""
    low, high = ax.get_ylim()
    ax.set_yticks([tick for tick in ax.get_yticks().tolist() if low + CLEAR * (high - low) <= tick <= high])


def _draw_fits(ax: Axes, primitives: LabelTrack, dt: float) -> None:
    # Primitives of one window do not touch each other: with round caps they look like one line.
    lines = LineCollection(list(fitted_lines(primitives, dt)), colors="black", linewidths=1.0, capstyle="round")
    lines.set_gid("fits")
    ax.add_collection(lines, autolim=False)


def _draw_bands(ax: Axes, lanes: list[LabelTrack], view: _View) -> None:
    for row, (layer, lane) in enumerate(zip(LAYERS, lanes, strict=True)):
        order = np.argsort(lane.t0 - lane.t1, kind="stable")  # short ones last, on top of the rims of long ones
        start, stop = lane.t0[order] * view.dt, lane.t1[order] * view.dt
        low, high = np.full(len(start), row + 0.06), np.full(len(start), row + 0.94)
        corners = [(start, low), (start, high), (stop, high), (stop, low)]
        # White rims separate equal neighbours, but would hide spans of a few pixels; those below one would not be seen.
        pixels, colors = (stop - start) * view.pixels, [COLORS[layer][code - 1] for code in lane.label[order]]
        band = PolyCollection(
            list(np.stack([np.stack(corner, -1) for corner in corners], 1)),
            facecolors=colors,
            edgecolors=["white" if wide else color for wide, color in zip(pixels > 6, colors, strict=True)],
            linewidths=np.select([pixels > 6, pixels < 1], [0.8, 72 / DPI], 0.0),
        )
        band.set_gid(layer)
        ax.add_collection(band, autolim=False)
        for text, middle, color in _names(layer, lane, view):
            ax.text(middle, row + 0.52, text, color=color, fontsize=9, ha="center", va="center", clip_on=True)
    ax.set(ylim=(3, 0))
    ax.set_yticks([0.5, 1.5, 2.5], _BAND_TITLES)
    ax.tick_params(axis="y", length=0, labelsize=9)


def _names(layer: str, lane: LabelTrack, view: _View) -> Iterator[tuple[str, float, str]]:
    """Names of the labels whose visible span is wide enough: text, middle in seconds, colour."""
    for code, t0, t1 in zip(lane.label, lane.t0, lane.t1, strict=True):
        start, stop = max(t0 * view.dt, view.start), min(t1 * view.dt, view.stop)
        text = name(layer, int(code))
        if (stop - start) * view.pixels > _LETTER * len(text) + 5:
            yield text, (start + stop) / 2, text_color(COLORS[layer][code - 1])


def _draw_marks(axes: tuple[Axes, ...], marks: list[Mark]) -> None:
    for ax in axes:
        for mark in marks:
            ax.axvline(mark.seconds, color=_RED, linewidth=1.3, linestyle=_STYLE[mark.dashed], gid="state")


def _name_rows(marks: list[Mark], view: _View) -> list[tuple[Mark, bool, int]]:
    """Names of the states: whether they stand right of their line, and the row, one up where they would overlap."""
    widths = [(room(mark.text) * 7.6 + 10) / view.pixels for mark in marks]
    fits = [mark.seconds + width < view.stop for mark, width in zip(marks, widths, strict=True)]
    lefts = [mark.seconds - width * (not fit) for mark, width, fit in zip(marks, widths, fits, strict=True)]
    rows = stacked([(left, left + width) for left, width in zip(lefts, widths, strict=True)], MOST_ROWS)
    return [(mark, fit, row) for mark, fit, row in zip(marks, fits, rows, strict=True) if row is not None]


def _name_marks(ax: Axes, names: list[tuple[Mark, bool, int]]) -> None:
    """Names of the states above the topmost axes."""
    for mark, fits, row in names:
        ax.annotate(
            plain(mark.text),
            (mark.seconds, 1.0),
            (3 if fits else -3, 5 + LINE * row),
            xycoords=ax.get_xaxis_transform(),
            textcoords="offset points",
            ha="left" if fits else "right",
            color=_RED,
            fontsize=11,
            fontstyle="italic" if mark.dashed else "normal",
        )


def _title(recordings: Recordings, index: int, window: int | None, rule: str) -> str:
    arm = title_among(str(recordings.arm[index]), recordings.arm)
    session = str(recordings.session[index])
    facts = [session and f"session {session}", outcome_of(recordings, index), arm]
    if window is not None:
        facts.append(f"window {window} samples ({window * recordings.dt * 1000:g} ms)")
    if rule != "paper":
        facts.append(f"rule {rule}")
    names = f"{recordings.trial[index]}   ·   {recordings.source[index]}"
    return f"{cut(names, WIDE[0])}\n{cut(', '.join(filter(None, facts)), WIDE[1])}"


def _legends(figure: Figure, used: dict[str, set[int]]) -> None:
    for layer, left in zip(LAYERS, (LEFT, 0.37, 0.64), strict=True):
        if used[layer]:
            label_legend(figure, layer, used[layer], (left, 0.16 / figure.get_figheight()), 2)


def _key(figure: Figure, ax: Axes, marks: list[Mark], what: str) -> None:
    """Legend of the lines, in the upper right corner."""
    handles: list[Artist] = [ax.lines[0], *ax.collections]
    texts = [what, "fitted lines"][: len(handles)]
    for dashed, text in ((False, "start of a state"), (True, "start of a state, harmonised")):
        if any(mark.dashed == dashed for mark in marks):
            handles.append(Line2D([], [], color=_RED, linewidth=1.3, linestyle=_STYLE[dashed]))
            texts.append(text)
    corner = RIGHT, 1 - MARGIN / figure.get_figheight()
    figure.legend(
        handles, texts, loc="upper right", bbox_to_anchor=corner, ncols=len(texts),
        fontsize=11, frameon=False, borderpad=0, borderaxespad=0,
    )  # fmt: skip
