"""Pictures of recordings unlike a wrench of six axes: nothing overlaps, and nothing is too short to be seen."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

import rcbht_jax as rj
from rcbht_jax.errors import InputError
from rcbht_jax.labels import COLORS, LAYER_SIZES, LAYERS, LLB
from rcbht_jax.plots import label_map, trial_figure
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

SAMPLES = 200_000  # of a long recording: 1000 s


def words(axes: int, spans: list[tuple[int, int, int]]) -> LabelTracks:
    """Labels (code, t0, t1), the same on every layer and axis of one recording."""
    code, t0, t1 = (np.tile(np.array(column, np.int32), (1, axes, 1)) for column in zip(*spans, strict=True))
    zero = np.zeros(code.shape)
    track = LabelTrack(code.astype(np.int8), t0, t1, t1, zero, zero, zero, zero)
    return LabelTracks(track, track, track)


def test_labels_of_another_rate_are_refused() -> None:
    """Their slopes would be lines beside the signal."""
    recordings = Recordings.from_arrays(np.zeros((2, 400, 1)), rate=100.0)
    tracks = rj.encode(recordings.wrench, rate=200.0)
    for draw in (lambda: trial_figure(recordings, tracks, 0), lambda: label_map(recordings, tracks, "llb")):
        with pytest.raises(
            InputError, match="labels are of 200 Hz, the recordings are of 100 Hz; encode with rate=100"
        ):
            draw()


def overlapping(figure: Figure, texts: list[Text]) -> list[tuple[str, str]]:
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text() and text.get_visible()]
    return [(a, b) for n, (a, one) in enumerate(boxes) for b, other in boxes[n + 1 :] if one.overlaps(other)]


@pytest.mark.parametrize("gap", [slice(30, 40), slice(None)])
def test_a_gap_is_left_out(gap: slice) -> None:
    wrench = np.linspace(0, 5, 100)[None, :, None].repeat(2, 2)
    wrench[0, gap, 1] = np.nan
    figure = trial_figure(Recordings.from_arrays(wrench, 100.0, axes=["grip", "twist"]), None, 0)
    low, high = figure.axes[1].get_ylim()
    assert np.isfinite([low, high]).all()
    assert (low < 0 < 5 < high) == (gap.stop is not None)


@pytest.mark.parametrize("axes", [1, 12])
def test_any_number_of_axes_gets_the_same_room(axes: int) -> None:
    names = [f"M{number}_right" for number in range(axes)]
    recordings = Recordings.from_arrays(np.zeros((1, 400, axes)), 200.0, axes=names, units=["Nm"] * axes)
    figure = trial_figure(recordings, words(axes, [(1, 0, 400)]), 0)
    heights = [ax.get_position().height * figure.get_figheight() for ax in figure.axes]
    assert heights == pytest.approx([1.79, 0.72] * axes, abs=0.01)  # inches
    bands = [text for ax in figure.axes[1::2] for text in ax.get_yticklabels()]
    assert not overlapping(figure, [*bands, *(ax.yaxis.label for ax in figure.axes[::2])])


def test_a_signal_in_large_units_fills_its_panel() -> None:
    """In MN: limits of the picture go by the signal alone, and a flat one has some, too."""
    force = np.zeros((1, 400, 2))
    force[0, 200:, 0] = 1e-5
    recordings = Recordings.from_arrays(force, 200.0, axes=["Fx", "Fz"], units=["MN", "MN"])
    figure = trial_figure(recordings, words(2, [(1, 0, 400)]), 0)
    assert figure.axes[0].get_ylim() == pytest.approx((-0.08e-5, 1.08e-5))
    assert figure.axes[2].get_ylim() == pytest.approx((-1e-3, 1e-3))


def test_names_of_many_states_do_not_cover_each_other_nor_the_title() -> None:
    marks = [(0, "step", f"a long name of step {number}", number * 0.4, number * 0.4 + 0.4) for number in range(25)]
    recordings = Recordings.from_arrays(np.zeros((1, 2000, 1)), 200.0, axes=["grip"], units=["N"], annotations=marks)
    tracks = words(1, [(1, 0, 2000)])
    figure = trial_figure(recordings, tracks, 0)
    names = list(figure.axes[0].texts)
    title = [text for text in figure.findobj(Text) if text.get_text() == figure.get_suptitle()]
    key = figure.legends[-1].get_texts()
    assert len(names) == 25
    assert not overlapping(figure, [*names, *title, *key])
    figure = label_map(recordings, tracks, "llb", by="state")
    named = figure.axes[0].get_xticklabels()
    legend = [figure.legends[-1].get_title(), *figure.legends[-1].get_texts()]
    assert len(named) == 25
    assert not overlapping(figure, [*named, *legend])


def test_a_map_by_state_says_that_it_has_the_first_interval_of_each() -> None:
    """A state that comes several times seemed to be shown whole."""
    marks = [(0, "step", ("screw", "wait")[number % 2], number * 2.0, number * 2.0 + 2.0) for number in range(5)]
    recordings = Recordings.from_arrays(np.zeros((1, 2000, 1)), 200.0, axes=["grip"], units=["N"], annotations=marks)
    figure = label_map(recordings, words(1, [(1, 0, 400), (2, 400, 2000)]), "llb", by="state")
    assert "normalised time in each state's first interval" in figure.get_suptitle()
    assert {int(code) for code in np.unique(figure.axes[0].images[0].get_array())} == {1, 2}
    [title] = [text for text in figure.findobj(Text) if text.get_text() == figure.get_suptitle()]
    assert title.get_window_extent().x1 <= figure.bbox.x1


def test_a_contact_is_seen_in_a_long_recording() -> None:
    recordings = Recordings.from_arrays(np.zeros((1, SAMPLES, 1)), 200.0, axes=["grip"], units=["N"])
    middle = SAMPLES // 2
    tracks = words(1, [(LLB.FX, 0, middle), (LLB.CT, middle, middle + 10), (LLB.FX, middle + 10, SAMPLES)])
    figure = trial_figure(recordings, tracks, 0)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3] / 255  # type: ignore[attr-defined]
    band = figure.axes[1]
    x, y = band.transData.transform((middle / 200, 2.2))
    near = pixels[round(pixels.shape[0] - y), round(x) - 2 : round(x) + 3]
    fixed, contact = (np.array(to_rgb(COLORS["llb"][code - 1])) for code in (LLB.FX, LLB.CT))
    assert np.abs(near - contact).sum(-1).min() < 0.6 * np.abs(fixed - contact).sum()


def test_long_names_and_texts_stay_in_their_places() -> None:
    names = [f"joint_{number}_torque_estimate_of_the_left_arm_in_its_own_frame" for number in range(3)]
    told = "a very long comment about what the operator saw during the trial, and why it was repeated " * 3
    recordings = Recordings.from_arrays(
        np.zeros((1, 400, 3)), 200.0, axes=names, units=["Nm"] * 3, trial=["long " * 50], comment=[told], note=[told]
    )
    for tracks in (None, words(3, [(1, 0, 400)])):
        figure = trial_figure(recordings, tracks, 0)
        labels = [ax.yaxis.label for ax in figure.axes if ax.get_ylabel()]
        title = [text for text in figure.findobj(Text) if text.get_text() == figure.get_suptitle()]
        assert len(labels) == 3
        assert not overlapping(figure, [*labels, *title, *figure.legends[-1].get_texts()])
        boxes = [text.get_window_extent() for text in [*labels, *title]]
        assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes), boxes


def test_one_sample_and_a_constant_are_seen() -> None:
    figure = trial_figure(Recordings.from_arrays(np.full((1, 1, 1), 1e30), 200.0, axes=["Fz"], units=["N"]), None, 0)
    (ax,) = figure.axes
    assert ax.get_lines()[0].get_marker() == "o"
    assert ax.get_ylim() == pytest.approx((0.95e30, 1.05e30))


@pytest.mark.parametrize("layer", LAYERS)
def test_the_legend_of_a_map_is_inside(layer: str) -> None:
    """Of every label that there is."""
    size = LAYER_SIZES[LAYERS.index(layer)]
    tracks = words(1, [(code, 10 * code, 10 * code + 10) for code in range(1, size + 1)])
    figure = label_map(Recordings.from_arrays([np.zeros((200, 1))], 200.0, axes=["Fz"]), tracks, layer)
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.legends[0].get_texts()]
    assert len(boxes) == size
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_no_value_runs_into_the_titles_of_the_bands() -> None:
    wrench = np.full((1, 400, 2), [4.0, 0.0], np.float32)  # the margins of the constant end at round numbers
    wrench[..., 1] += np.linspace(0, 1, 400)
    recordings = Recordings.from_arrays(wrench, 200.0, axes=["dead", "grip"], units=["A", "N"])
    figure = trial_figure(recordings, words(2, [(1, 0, 400)]), 0, window=5)
    figure.canvas.draw()
    bands = [ax for ax in figure.axes if str(ax.get_gid()).startswith("labels-")]
    for signal, band in zip([ax for ax in figure.axes if ax not in bands], bands, strict=True):
        low, high = signal.get_ylim()
        shown = [
            text for text, at in zip(signal.get_yticklabels(), signal.get_yticks(), strict=True) if low <= at <= high
        ]
        lowest = min(text.get_window_extent().y0 for text in shown)
        assert lowest > band.get_yticklabels()[0].get_window_extent().y1
        assert len(shown) > 2
