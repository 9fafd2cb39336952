"""Pictures of any assembly: what its geoms are called and how many marks it has is its own business."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from PIL import Image, ImageSequence

from rcbht_jax.plots.canvas import new_figure
from rcbht_jax.types import Recordings
from sim_mjx.plots import animation
from sim_mjx.plots.projection import FREE, SEATED, SIDE, outline
from sim_mjx.plots.trial_overview import still, trial_tabs
from sim_mjx.validation.replay import Replay, events

# contact spheres and walls whose names begin as those of the camera's parts do, and a mark that decides success
PARTS = """<mujoco><worldbody><body name="MOUNT">
<geom name="TIP_0" size=".001" rgba="0 0 1 1"/><geom name="TIP_1" size=".001" pos="0 0 .01" rgba="0 0 1 1"/>
<geom name="BLOCK_0" type="box" size=".01 .01 .01" rgba="0 1 1 1"/><geom name="LIP_0" size=".002" rgba="1 0 1 1"/>
<geom name="SEAT_0" size=".002" rgba="1 1 0 1"/><geom name="HOOK" size=".003" pos="0 0 .03"/>
</body><body pos="0 0 2"><body name="HAND" pos="1 0 -1"/></body></worldbody></mujoco>"""


def replayed(*marks: str, samples: int = 5) -> Replay:
    model = mujoco.MjModel.from_xml_string(PARTS)
    past = np.zeros((samples, len(marks)), bool)
    past[-1] = True
    height = np.zeros(past.shape) + np.arange(len(marks))
    return Replay(model, np.zeros((samples, model.nq)), 0.005, past, height, "made up", marks)


@pytest.mark.parametrize(("seconds", "color"), [(0.0, FREE), (0.02, SEATED)])
def test_names_of_geoms_mean_nothing_but_those_of_the_marks(seconds: float, color: str) -> None:
    axes = new_figure((8.0, 4.0), 50).subplots(1, 2)
    for drawing in still(tuple(axes), replayed("HOOK"), seconds):
        assert len(drawing.tips()) == 1
    for ax in axes:  # the blue spheres, the block, the lip and the seat in their own colours, and the mark in its state
        (drawn,) = ax.collections
        own = [(0, 0, 1, 1), (0, 0, 1, 1), (0, 1, 1, 1), (1, 0, 1, 1), (1, 1, 0, 1)]
        assert sorted(map(tuple, drawn.get_facecolor().tolist())) == sorted([*map(to_rgba, own), to_rgba(color)])


def test_a_large_arm_is_whole() -> None:
    axes = new_figure((8.0, 4.0), 50).subplots(1, 2)
    still(tuple(axes), replayed("HOOK"), 0.0)
    far, close = axes
    for x, z in ((0.0, 2.0), (1.0, 1.0), (0.0, 0.0)):  # base, hand and mount
        assert far.get_xlim()[0] < x < far.get_xlim()[1]
        assert far.get_ylim()[0] < z < far.get_ylim()[1]
    assert np.ptp(close.get_ylim()) < 0.2  # m; the parts alone


def test_every_mark_has_a_line() -> None:
    ax = new_figure((8.0, 4.0), 50).add_subplot()
    marks = [f"HOOK_{number}" for number in range(6)]
    trial_tabs(ax, replayed(*marks))
    assert [float(line.get_ydata()[0]) for line in ax.lines] == [1e3 * number for number in range(6)]
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.lines}) == 6
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [mark.lower() for mark in marks]


def test_a_phase_may_have_the_name_of_the_end() -> None:
    replay = replayed("HOOK", samples=41)
    marks = [(0, "phase", "begin", 0.0, 0.1), (0, "phase", "end", 0.1, 0.205)]
    recordings = Recordings.from_arrays(np.zeros((1, 41, 6)), 200.0, annotations=marks)
    assert events(replay, recordings, 0) == {"begin": 0.0, "end": 0.1, "end of the trial": 0.2}


def test_a_shape_of_another_kind_is_its_bounding_box() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 2"/>'
        '<mesh name="flat" inertia="shell" vertex="0 0 0  1 0 0  1 1 0  0 1 0" face="0 1 2  0 2 3"/></asset><worldbody>'
        '<geom type="mesh" mesh="m" pos="3 0 0"/><geom type="ellipsoid" size="1 2 3"/><geom type="plane" size="1 1 1"/>'
        '<geom type="mesh" mesh="flat" contype="0" conaffinity="0"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mesh, ellipsoid, plane, flat = (outline(model, data, geom, SIDE) for geom in range(4))
    assert len(plane) == 0
    np.testing.assert_allclose([flat.min(0), flat.max(0)], [[0, 0], [1, 0]], atol=1e-2)  # seen from its edge
    np.testing.assert_allclose([ellipsoid.min(0), ellipsoid.max(0)], [[-1, -3], [1, 3]])
    corners = np.array([[3.0, 0.0], [4.0, 0.0], [3.0, 2.0]])  # of the mesh, from the side
    assert (mesh.min(0) <= corners.min(0) + 1e-9).all()
    assert (mesh.max(0) >= corners.max(0) - 1e-9).all()


@pytest.mark.parametrize("speed", [0.01, 0.05, 0.5])
def test_a_slow_film_lasts_as_long_as_its_speed_says(speed: float, tmp_path: Path) -> None:
    replay = replayed("HOOK", samples=11)
    wrench = np.random.default_rng(0).normal(size=(1, 11, 6))
    recordings = Recordings.from_arrays(wrench, 200.0, annotations=[(0, "phase", "all", 0.0, 0.055)])
    count = animation.film(tmp_path / "a.gif", replay, recordings, 0, speed=speed)
    with Image.open(tmp_path / "a.gif") as film:
        shown = sum(picture.info["duration"] for picture in ImageSequence.Iterator(film)) / 1e3
    assert shown == pytest.approx(0.05 / speed + 0.1)  # s, and the last picture
    assert count == round(0.05 / speed * 10) + 1
