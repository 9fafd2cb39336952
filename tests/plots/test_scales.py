"""Values far from one: factor and offset of an axis are legible, and nothing covers them."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from rcbht_jax.plots import trial_figure
from rcbht_jax.types import Recordings

RAMP = np.linspace(0.0, 1.0, 400)


def figure_of(values: np.ndarray, axis: str = "p") -> Figure:
    """Of one axis ``[sample]`` whose first state starts at 0."""
    recordings = Recordings.from_arrays(
        values.astype(np.float32)[None, :, None], 200.0, axes=[axis], units=["Pa"],
        annotations=[(0, "phase", "approach", 0.0, 1.0)],
    )  # fmt: skip
    figure = trial_figure(recordings, None, 0)
    figure.canvas.draw()
    return figure


def inside(figure: Figure, text: Text) -> bool:
    box: Bbox = text.get_window_extent()
    return bool(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1)


@pytest.mark.parametrize(
    ("values", "written"),
    [
        (101_325 + 0.125 * RAMP, "+1.01325e5"),
        (4e-7 * RAMP, "×1e−7"),
        (-1.25e6 * RAMP, "×1e6"),
        (0.1234 + 1e-6 * RAMP, "×1e−6\n+1.234e−1"),
    ],
)
def test_factor_and_offset_stand_beside_the_names_of_states(values: np.ndarray, written: str) -> None:
    figure = figure_of(values)
    (panel,) = figure.axes
    scale, (state,) = panel.yaxis.get_offset_text(), panel.texts
    assert scale.get_text() == written
    assert not scale.get_window_extent().overlaps(state.get_window_extent())
    assert inside(figure, scale)


@pytest.mark.parametrize("size", [1.2e-4, 6e-4, 9e5])
def test_numbers_leave_room_for_the_name_of_the_axis(size: float) -> None:
    figure = figure_of(size * (2 * RAMP - 1), axis="torque")
    assert inside(figure, figure.axes[0].yaxis.label)


@pytest.mark.parametrize("value", [1e-7, -1e-7, 1e6])
def test_a_constant_is_read_at_its_value(value: float) -> None:
    low, high = figure_of(np.full(400, value)).axes[0].get_ylim()
    assert (low, high) == pytest.approx(sorted((0.95 * value, 1.05 * value)))


@pytest.mark.parametrize(
    "axis", ["Barometric_pressure_of_gripper_chamber_left_finger", "x" * 60, "pressure of the " * 4]
)
def test_the_unit_of_a_long_name_is_whole(axis: str) -> None:
    figure = figure_of(RAMP, axis=axis)
    label = figure.axes[0].yaxis.label
    assert "…" in label.get_text()
    assert label.get_text().endswith(", Pa")
    assert inside(figure, label)
    assert max(map(len, label.get_text().split("\n"))) <= 22


def test_late_moments_are_written_in_whole() -> None:
    recordings = Recordings.from_arrays(np.zeros((1, 11_000, 1)), 1.0, axes=["Fz"], units=["N"])
    figure = trial_figure(recordings, None, 0, seconds=(10_000.0, 10_001.0))
    figure.canvas.draw()
    assert figure.axes[0].xaxis.get_offset_text().get_text() == ""
    assert {"10000.0", "10001.0"} <= {text.get_text() for text in figure.axes[0].get_xticklabels()}
    assert all(inside(figure, text) for text in figure.axes[0].get_xticklabels() if text.get_text() == "10001.0")
