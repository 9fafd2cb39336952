"""The colour-coded label map of a data set: one row per recording, one colour per label, six axes."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES, COLORS, LAYERS, STATES
from rcbht_jax.plots.canvas import check_rows, label_legend, new_figure
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WIDTH, DPI = 16.0, 125  # inches, 2000 pixels
HEAD, FOOT, GAP = 1.1, 1.3, 0.4  # inches: title, legend and tick labels, between panels
POINTS_PER_STATE = 100  # columns of a state when time is normalised
_LEFT = 0.115  # figure coordinates
_CAPTIONS = {
    "word": "columns: words of the sentence; white: the sentence is over",
    "state": "columns: time normalised within each state; white: no such state in this recording, or no label",
}
# A white rim keeps lines apart from dark labels.
_RIM = [Stroke(linewidth=2.2, foreground="white"), Normal()]


def label_map(
    recordings: Recordings,
    tracks: LabelTracks,
    layer: str,
    *,
    select: NDArray[Any] | None = None,
    by: Literal["word", "state"] = "word",
    words: int | None = None,
    title: str = "",
) -> Figure:
    """Labels of one layer of many recordings.

    Rows are sorted by session, data set, trial and arm. Columns are words, that is positions in the sentence
    (``by="word"``), or time normalised within each harmonised state (``by="state"``). What a shorter sentence,
    a missing state or an unlabelled moment leaves open is white.

    Args:
        recordings: data set.
        tracks: its labels ``[recording, 6, slot]``.
        layer: "primitive", "mc" or "llb".
        select: which recordings: bool ``[recording]`` or row numbers; default all.
        by: what a column is.
        words: most words to show; the caption says how many sentences that cuts. Default all.
        title: first words of the title.

    Raises:
        InputError: unknown layer or kind of column, nothing selected, no word to show, or the tracks are not
            those of the recordings.
    """
    if layer not in LAYERS or by not in ("word", "state"):
        raise InputError(
            f"There is no label map of {layer!r} by {by!r}; expected {', '.join(LAYERS)} by word or state."
        )
    check_rows(recordings, tracks)
    rows = _sorted_rows(recordings, select)
    track: LabelTrack = getattr(tracks, layer)
    codes = _by_word(track, rows) if by == "word" else _by_state(track, rows, recordings)
    caption = _CAPTIONS[by]
    if by == "word" and words is not None:
        codes, caption = _cut(codes, words, caption)
    # Sentences have up to a thousand words, hence one wide panel per axis; states are short, hence two columns.
    columns = 1 if by == "word" else 2
    figure, panels = _panels(columns, len(rows))
    per_column = len(AXES) // columns
    for axis, ax in enumerate(panels):
        _draw(ax, codes[:, axis], layer)
        ax.set_title(AXES[axis], fontsize=12, loc="left", pad=4)
        _separate_sessions(ax, recordings, rows, named=axis < per_column)
        _label_columns(ax, by, last=axis % per_column == per_column - 1)
    facts = f"{layer if layer == 'primitive' else layer.upper()} labels of {len(rows)} recordings"
    text = f"{title}: {facts}\n{caption}" if title else f"{facts}\n{caption}"
    height = figure.get_figheight()
    figure.suptitle(text, x=_LEFT, y=1 - 0.2 / height, ha="left", va="top", fontsize=13)
    used = {int(code) for code in np.unique(codes)} - {0}
    if used:
        label_legend(figure, layer, used, (_LEFT, 0.15 / height), 5)
    return figure


def _panels(columns: int, rows: int) -> tuple[Figure, list[Axes]]:
    """Axes in the order of ``AXES``, column by column, tall enough for ``rows``."""
    per_column = len(AXES) // columns
    panel = min(max(0.05 * rows * columns, 1.6), 3.6 * columns)  # inches
    height = HEAD + FOOT + per_column * panel + (per_column - 1) * GAP
    figure = new_figure((WIDTH, height), DPI)
    grid = figure.add_gridspec(
        per_column, columns, left=_LEFT, right=0.985, bottom=FOOT / height, top=1 - HEAD / height,
        wspace=0.04, hspace=GAP / panel,
    )  # fmt: skip
    return figure, [figure.add_subplot(grid[axis % per_column, axis // per_column]) for axis in range(len(AXES))]


def _sorted_rows(recordings: Recordings, select: NDArray[Any] | None) -> NDArray[np.intp]:
    chosen = np.arange(len(recordings)) if select is None else np.asarray(select)
    rows = np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen
    if len(rows) == 0:
        raise InputError("No recording is selected; a label map needs at least one.")
    keys = [getattr(recordings, key)[rows] for key in ("arm", "trial", "source", "session")]
    return rows[np.lexsort(keys)]


def _by_word(track: LabelTrack, rows: NDArray[np.intp]) -> NDArray[np.int8]:
    """Codes ``[row, axis, word]``, empty slots at the end."""
    codes = np.asarray(track.label)[rows]
    order = np.argsort(codes == 0, axis=-1, kind="stable")
    longest = max(1, int((codes > 0).sum(-1).max()))
    return np.take_along_axis(codes, order, -1)[..., :longest]


def _cut(codes: NDArray[np.int8], words: int, caption: str) -> tuple[NDArray[np.int8], str]:
    """The first words only, and a caption that owns up to it."""
    if words < 1:
        raise InputError(f"{words} words cannot be shown; expected at least 1.")
    longer = int((codes[..., words:] > 0).any(-1).sum())
    return codes[..., :words], f"{caption}; {longer} of {codes[..., 0].size} sentences go on"


def _by_state(track: LabelTrack, rows: NDArray[np.intp], recordings: Recordings) -> NDArray[np.int8]:
    """Codes ``[row, axis, state x POINTS_PER_STATE]``, 0 where a state is missing."""
    codes = np.zeros((len(rows), len(AXES), len(STATES), POINTS_PER_STATE), np.int8)
    parts = (np.arange(POINTS_PER_STATE) + 0.5) / POINTS_PER_STATE
    for row, index in enumerate(rows.tolist()):
        edges = np.append(recordings.onset_harmonised[index] / recordings.dt, np.nan)
        for state, start in enumerate(edges[:-1]):
            if np.isnan(start):
                continue
            later = edges[state + 1 :]
            stop = min([*later[~np.isnan(later)], recordings.length[index]])
            moments = start + parts * max(stop - start, 0.0)
            for axis in range(len(AXES)):
                codes[row, axis, state] = _codes_at(track, index, axis, moments)
    return codes.reshape(len(rows), len(AXES), -1)


def _codes_at(track: LabelTrack, index: int, axis: int, moments: NDArray[np.float64]) -> NDArray[np.int8]:
    """Code of the label at each moment (samples), 0 where there is none."""
    label, t0, t1 = (np.asarray(values)[index, axis] for values in (track.label, track.t0, track.t1))
    label, t0, t1 = (values[label > 0] for values in (label, t0, t1))
    if len(label) == 0:
        return np.zeros(len(moments), np.int8)
    at = np.searchsorted(t0, moments, side="right") - 1
    inside = (at >= 0) & (moments < t1[at])
    return np.where(inside, label[at], 0).astype(np.int8)


def _draw(ax: Axes, codes: NDArray[np.int8], layer: str) -> None:
    colors = ["white", *COLORS[layer]]
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    # Nearest: averaging neighbours would show colours that stand for no label.
    extent = (0.5, codes.shape[1] + 0.5, len(codes) - 0.5, -0.5)  # columns count from 1
    ax.imshow(
        codes, cmap=ListedColormap(colors), norm=norm, aspect="auto", interpolation="nearest", extent=extent
    )  # fmt: skip
    ax.tick_params(labelsize=10)


def _separate_sessions(ax: Axes, recordings: Recordings, rows: NDArray[np.intp], named: bool) -> None:
    """A line between groups of rows; each group named once, beside the left column."""
    keys = [(str(recordings.session[row]), str(recordings.outcome[row]), str(recordings.source[row])) for row in rows]
    starts = [row for row in range(len(rows)) if row == 0 or keys[row] != keys[row - 1]]
    stops = [*starts[1:], len(rows)]
    for start in starts[1:]:
        ax.axhline(start - 0.5, color="black", linewidth=0.9, gid="session", path_effects=_RIM)
    middles = [(start + stop - 1) / 2 for start, stop in zip(starts, stops, strict=True)]
    names = [f"{keys[start][0]} {keys[start][1]}, {stop - start}" for start, stop in zip(starts, stops, strict=True)]
    ax.set_yticks(middles, names if named else [""] * len(names))
    ax.tick_params(axis="y", length=0)


def _label_columns(ax: Axes, by: str, last: bool) -> None:
    ax.tick_params(labelbottom=last)
    if by == "word":
        if last:
            ax.set_xlabel("word of the sentence", fontsize=11)
        return
    for state in range(1, len(STATES)):
        ax.axvline(state * POINTS_PER_STATE + 0.5, color="black", linewidth=0.9, gid="state", path_effects=_RIM)
    ax.set_xticks([(state + 0.5) * POINTS_PER_STATE for state in range(len(STATES))], STATES)
    ax.tick_params(axis="x", length=0)
