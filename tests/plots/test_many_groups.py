"""Label maps of many sessions, and of long names: names are whole and apart, and lines hide no row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from matplotlib.figure import Figure

from rcbht_jax.plots import label_map
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings


def map_of(sessions: list[str], words: int = 4, states: Sequence[str] = ()) -> Figure:
    """Of one recording with one axis for each session, drawn."""
    code = np.ones((len(sessions), 1, words), np.int32)
    t0 = np.broadcast_to(np.arange(words, dtype=np.int32) * 10, code.shape)
    zero = np.zeros(code.shape)
    track = LabelTrack(code.astype(np.int8), t0, t0 + 10, t0 + 10, zero, zero, zero, zero)
    marks = [(0, "step", state, 0.005 * number, 3.0) for number, state in enumerate(states)]
    recordings = Recordings.from_arrays(
        np.zeros((len(sessions), 100, 1)), 100.0, axes=["Fz"], session=sessions, outcome=["success"] * len(sessions),
        annotations=marks,
    )  # fmt: skip
    figure = label_map(recordings, LabelTracks(track, track, track), "llb", by="state" if states else "word")
    figure.canvas.draw()
    return figure


@pytest.mark.parametrize("count", [3, 18, 60, 200])
@pytest.mark.parametrize("name", ["", "a name of a session with sixty letters, which is quite long "])
def test_names_of_groups_are_apart_and_inside(count: int, name: str) -> None:
    figure = map_of([f"{name}{number:03d}" for number in range(count)])
    boxes = [text.get_window_extent() for text in figure.axes[0].get_yticklabels()]
    assert len(boxes) > min(count, 18) / 3
    assert name or count > 18 or len(boxes) == count
    assert not any(a.overlaps(b) for n, a in enumerate(boxes) for b in boxes[n + 1 :])
    assert all(box.x0 >= figure.bbox.x0 for box in boxes)


def test_lines_between_groups_hide_no_row() -> None:
    figure = map_of([f"{number:03d}" for number in range(60)])
    row = figure.axes[0].get_window_extent().height / 60
    (line, *_) = (line for line in figure.axes[0].lines if line.get_gid() == "session")
    rim = line.get_path_effects()[0]._gc["linewidth"]
    assert rim * figure.dpi / 72 < row / 3


@pytest.mark.parametrize("words", [1, 4])
def test_labels_are_counted_in_whole_numbers(words: int) -> None:
    panel = map_of(["a"], words).axes[0]
    shown = [tick for tick in panel.get_xticks() if 0.5 <= tick <= words + 0.5]
    assert shown == list(range(1, words + 1))


LONG = "a name of a state that is rather long"


@pytest.mark.parametrize(
    ("states", "inches"),
    [([f"step {number} {LONG} and so on" for number in range(200)], 4.0), (["near", LONG, LONG + "er", "far"], 0.5)],
)
def test_names_of_states_are_apart_and_inside_and_take_little_room(states: list[str], inches: float) -> None:
    figure = map_of(["a"], states=states)
    assert figure.get_figheight() < map_of(["a"], states=["near", "far"]).get_figheight() + inches
    boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    legend = figure.legends[0].get_window_extent()
    assert not any(a.overlaps(b) for n, a in enumerate(boxes) for b in [*boxes[n + 1 :], legend])
