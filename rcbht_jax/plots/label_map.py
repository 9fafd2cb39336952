"""The colour-coded label map of a data set: one row per recording, one colour per label, a panel per axis."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator

from rcbht_jax._util.printable import plural, room
from rcbht_jax._util.selection import rows_of
from rcbht_jax.errors import InputError
from rcbht_jax.labels import COLORS, LAYERS
from rcbht_jax.plots.canvas import LAYER_TITLES, check_rows, cut, label_legend, new_figure, plain, stacked
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WIDTH, DPI = 16.0, 125  # inches, 2000 pixels
HEAD, FOOT, GAP = 1.1, 1.3, 0.4  # inches: title, legend and tick labels, between panels
POINTS_PER_STATE = 100  # columns of a state when time is normalised
_LEFT, RIGHT = 0.115, 0.985  # figure coordinates
LETTER = 0.095  # inches of one letter of a state's name, at most
LONG = 22  # letters beside a panel
LONG_STATE, LONG_LEANING = 40, 24  # letters of a state's name
LINE = 0.19  # inches of a line of names
MOST_LINES = 3  # of names of states
_CAPTIONS = {
    "word": "rows: recordings by session and outcome (number of recordings); columns: labels in order; white: after "
    "the last label",
    "state": "rows: recordings by session and outcome (their number); columns: normalised time in each state's first "
    "interval; white: state missing, or no label",
}
Rows = Int[np.ndarray, " row"]
Codes = Int8[np.ndarray, "row axis _column"]


def label_map(
    recordings: Recordings,
    tracks: LabelTracks,
    layer: str,
    *,
    select: Bool[np.ndarray, " recording"] | Int[np.ndarray, " row"] | None = None,
    by: Literal["word", "state"] = "word",
    words: int | None = None,
    title: str = "",
    track: str = "",
) -> Figure:
    """Labels of one layer of many recordings.

    Rows are sorted by session, outcome, data set, trial and arm. Columns are the labels in order (``by="word"``) or
    time, normalised within the first interval of each state of a track of annotations (``by="state"``). White: after
    the last label of a recording, a missing interval, or a time without a label.

    >>> import rcbht_jax as rj
    >>> recordings = Recordings.from_arrays(np.random.default_rng(0).normal(size=(3, 400, 6)).cumsum(1), 200.0)
    >>> figure = label_map(recordings, rj.encode(recordings.wrench), "llb")

    Args:
        recordings: data set.
        tracks: its labels ``[recording, axis, slot]``.
        layer: "primitive", "mc" or "llb".
        select: which recordings: bool ``[recording]`` or row numbers; default all.
        by: what a column is.
        words: largest number of labels to show, by word; the caption states how many rows are truncated. Default all.
        title: start of the title.
        track: track of annotations; default see :meth:`rcbht_jax.annotations.Annotations.choose`.

    Raises:
        InputError: the layer or ``by`` is unknown, no recording is selected, ``words`` is not positive or given for a
            map by state, or the tracks do not belong to the recordings.
    """
    if layer not in LAYERS or by not in ("word", "state"):
        raise InputError(
            f"A label map of {layer!r} by {by!r} does not exist; expected {', '.join(LAYERS)} by word or state."
        )
    if by == "state" and words is not None:
        raise InputError("A label map by state has no number of words; leave that out, or choose a map by word.")
    check_rows(recordings, tracks)
    rows = _sorted_rows(recordings, select)
    chosen: LabelTrack = getattr(tracks, layer)
    states, codes = ((), _by_word(chosen, rows)) if by == "word" else _by_state(chosen, rows, recordings, track)
    caption = _CAPTIONS[by]
    if words is not None:
        codes, caption = _cut(codes, words, caption)
    # Up to a thousand labels need one wide panel per axis; states are short and fit in two columns.
    columns = 1 if by == "word" or len(recordings.axes) == 1 else 2
    states, rotation, extra = _named(states, WIDTH * (RIGHT - _LEFT) / columns - GAP * (columns - 1))
    groups = _groups(recordings, rows)
    figure, panels = _panels(recordings.axes, columns, len(rows), len(groups), FOOT + extra)
    per_column = -(-len(panels) // columns)
    for axis, ax in enumerate(panels):
        _draw(ax, codes[:, axis], layer)
        ax.set_title(plain(recordings.axes[axis]), fontsize=12, loc="left", pad=4)
        _separate_sessions(ax, groups, named=axis < per_column)
        _label_columns(ax, states, axis % per_column == per_column - 1, rotation)
    facts = f"{LAYER_TITLES[layer]} of {plural(len(rows), 'recording')}"
    text = f"{title}: {facts.lower()}\n{caption}" if title else f"{facts}\n{caption}"
    height = figure.get_figheight()
    figure.suptitle(plain(text), x=_LEFT, y=1 - 0.2 / height, ha="left", va="top", fontsize=13)
    used = {int(code) for code in np.unique(codes)} - {0}
    if used:
        label_legend(figure, layer, used, (_LEFT, 0.15 / height), len(used) if len(used) <= 6 else -(-len(used) // 2))
    return figure


def _named(states: tuple[str, ...], inches: float) -> tuple[tuple[str, ...], float, float]:
    r"""Names of states below a panel of a width, in lines where they would overlap, or leaning if they need too many.

    Then their rotation in degrees, and the inches below the panel that they take beyond a line.

    >>> _named(("near", "a longer name", "far"), 2.0)
    (('near', '\na longer name', 'far'), 0.0, 0.19)
    """
    names = tuple(cut(state, LONG_STATE) for state in states)
    if not names:
        return (), 0.0, 0.0
    middles = [inches * (state + 0.5) / len(names) for state in range(len(names))]
    halves = [LETTER * (room(name) + 1) / 2 for name in names]
    ends = [(middle - half, middle + half) for middle, half in zip(middles, halves, strict=True)]
    lines = [line for line in stacked(ends, MOST_LINES) if line is not None]
    if len(lines) == len(names) and min(ends)[0] >= -GAP / 2 and max(end for _, end in ends) <= inches + GAP / 2:
        return tuple("\n" * line + name for line, name in zip(lines, names, strict=True)), 0.0, LINE * max(lines)
    names = tuple(cut(state, LONG_LEANING) for state in states)
    return names, 90.0, LETTER * max(map(room, names))


def _panels(axes: tuple[str, ...], columns: int, rows: int, groups: int, foot: float) -> tuple[Figure, list[Axes]]:
    """A panel for each of ``axes``, column by column, tall enough for rows and groups, above so many inches."""
    per_column = -(-len(axes) // columns)
    panel = min(max(0.05 * rows * columns, LINE * groups, 1.6), 3.6 * columns)  # inches
    height = HEAD + foot + per_column * panel + (per_column - 1) * GAP
    figure = new_figure((WIDTH, height), DPI)
    grid = figure.add_gridspec(
        per_column, columns, left=_LEFT, right=RIGHT, bottom=foot / height, top=1 - HEAD / height,
        wspace=0.04, hspace=GAP / panel,
    )  # fmt: skip
    return figure, [figure.add_subplot(grid[axis % per_column, axis // per_column]) for axis in range(len(axes))]


def _sorted_rows(recordings: Recordings, select: Bool[np.ndarray, " recording"] | Rows | None) -> Rows:
    rows = np.arange(len(recordings)) if select is None else rows_of(select, len(recordings))
    if len(rows) == 0:
        raise InputError("No recording is selected; a label map needs at least one.")
    keys = [getattr(recordings, key)[rows] for key in ("arm", "trial", "source", "outcome", "session")]
    return rows[np.lexsort(keys)]


def _by_word(track: LabelTrack, rows: Rows) -> Codes:
    """Codes by word, empty slots at the end."""
    codes = np.asarray(track.label)[rows]
    order = np.argsort(codes == 0, axis=-1, kind="stable")
    longest = max(1, int((codes > 0).sum(-1).max()))
    return np.take_along_axis(codes, order, -1)[..., :longest]


def _cut(codes: Codes, words: int, caption: str) -> tuple[Codes, str]:
    """The first words only, and a caption that states how many rows are truncated."""
    if words < 1:
        raise InputError(f"The number of words to show is {words}; expected at least 1.")
    longer = int((codes[..., words:] > 0).any(-1).sum())
    return codes[..., :words], f"{caption}; {longer} of {codes[..., 0].size} rows are truncated"


def _by_state(track: LabelTrack, rows: Rows, recordings: Recordings, annotated: str) -> tuple[tuple[str, ...], Codes]:
    """States, and their codes, ``POINTS_PER_STATE`` columns each: 0 where one is missing, the first of several."""
    if not (name := recordings.annotations.choose(annotated)):
        raise InputError("The data set has no annotations; a label map by state needs a track of them.")
    states, axes = recordings.annotations.labels[name], len(recordings.axes)
    codes = np.zeros((len(rows), axes, len(states), POINTS_PER_STATE), np.int8)
    fractions = (np.arange(POINTS_PER_STATE) + 0.5) / POINTS_PER_STATE
    for row, index in enumerate(rows.tolist()):
        marks = recordings.annotations.of_recording(index).of(name)
        length = float(recordings.length[index])
        for state in np.unique(marks.code).tolist():
            first = np.flatnonzero(marks.code == state)[0]
            start, end = marks.start[first] / recordings.dt, marks.end[first] / recordings.dt
            following = marks.start[marks.start > marks.start[first]] / recordings.dt
            stop = min(end if np.isfinite(end) else min(following, default=length), length)
            moments = start + fractions * max(stop - start, 0.0)
            for axis in range(axes):
                codes[row, axis, state] = _codes_at(track, index, axis, moments)
    return states, codes.reshape(len(rows), axes, -1)


def _codes_at(
    track: LabelTrack, index: int, axis: int, samples: Float[np.ndarray, " moment"]
) -> Int8[np.ndarray, " moment"]:
    """Code of the label at each moment, 0 where there is none."""
    label, t0, t1 = (np.asarray(values)[index, axis] for values in (track.label, track.t0, track.t1))
    label, t0, t1 = (values[label > 0] for values in (label, t0, t1))
    if len(label) == 0:
        return np.zeros(len(samples), np.int8)
    at = np.searchsorted(t0, samples, side="right") - 1
    inside = (at >= 0) & (samples < t1[at])
    return np.where(inside, label[at], 0).astype(np.int8)


def _draw(ax: Axes, codes: Int8[np.ndarray, "row column"], layer: str) -> None:
    colors = ["white", *COLORS[layer]]
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    # Nearest: averages of neighbours would be colours of no label.
    extent = (0.5, codes.shape[1] + 0.5, len(codes) - 0.5, -0.5)  # columns count from 1
    ax.imshow(
        codes, cmap=ListedColormap(colors), norm=norm, aspect="auto", interpolation="nearest", extent=extent
    )  # fmt: skip
    ax.tick_params(labelsize=10)


def _groups(recordings: Recordings, rows: Rows) -> list[tuple[int, int, str]]:
    """First row, row after the last, and name of each group with one session, outcome and data set."""
    keys = [(str(recordings.session[row]), str(recordings.outcome[row]), str(recordings.source[row])) for row in rows]
    starts = [row for row in range(len(rows)) if row == 0 or keys[row] != keys[row - 1]]
    groups = []
    for start, stop in zip(starts, [*starts[1:], len(rows)], strict=True):
        session, (outcome, count) = keys[start][0], (keys[start][1], f" ({stop - start})")
        names = [*filter(None, [cut(session, LONG)]), cut(outcome, LONG - len(count)) + count]
        groups.append((start, stop, (",\n" if room(", ".join(names)) > LONG + 2 else ", ").join(map(plain, names))))
    return groups


def _line_between(inches: float) -> dict[str, Any]:
    """Style of a line between groups, the smallest of so many inches, which it must not hide."""
    width = min(1.0, 6 * inches)
    rim = [Stroke(linewidth=2.2 * width, foreground="white"), Normal()]  # separates the line from dark labels
    return {"color": "black", "linewidth": 0.9 * width, "path_effects": rim}


def _separate_sessions(ax: Axes, groups: list[tuple[int, int, str]], named: bool) -> None:
    """A line between groups; names beside the left column, where there is room, at a tick if some have none."""
    inches = ax.get_window_extent().height / DPI / groups[-1][1]  # of a row
    style = _line_between(inches * min(stop - start for start, stop, _ in groups))
    for start, _, _ in groups[1:]:
        ax.axhline(start - 0.5, gid="session", **style)
    middles = [(start + stop - 1) / 2 for start, stop, _ in groups]
    halves = [LINE / 2 * (1 + text.count("\n")) / inches for *_, text in groups]
    places = stacked([(middle - half, middle + half) for middle, half in zip(middles, halves, strict=True)], 1)
    shown = [(middle, text) for middle, (*_, text), place in zip(middles, groups, places, strict=True) if place == 0]
    ax.set_yticks([middle for middle, _ in shown], [text if named else "" for _, text in shown])
    ax.tick_params(axis="y", length=0 if len(shown) == len(groups) or not named else 3)


def _label_columns(ax: Axes, states: tuple[str, ...], last: bool, rotation: float) -> None:
    ax.tick_params(labelbottom=last)
    if not states:
        if last:
            ax.set_xlabel("number of the label, from 1", fontsize=11)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        return
    inches = ax.get_window_extent().width / DPI / len(states)  # of a state
    style = _line_between(inches)
    for state in range(1, len(states)):
        ax.axvline(state * POINTS_PER_STATE + 0.5, gid="state", **style)
    apart = max(1, math.ceil(LINE / inches)) if rotation else 1  # states from one name to the next, for lack of room
    shown = range(0, len(states), apart)
    ax.set_xticks(
        [(state + 0.5) * POINTS_PER_STATE for state in shown],
        [plain(states[state]) for state in shown],
        rotation=rotation,
    )
    ax.tick_params(axis="x", length=0 if apart == 1 else 3)
