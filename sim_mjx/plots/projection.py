"""A MuJoCo scene as flat outlines: works without any graphics library, and stays sharp at any size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float64
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Floats = NDArray[np.float64]
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
ROUND = np.linspace(0.0, 2.0 * np.pi, 33)
SEATED, FREE, LIP, SEAT = "#1a9850", "#f28e2b", "#444444", "#d0d0d0"
HIDDEN = ("BLOCK",)  # they would hide the tips from the side


@dataclass(frozen=True)
class View:
    """An orthographic view along one axis of the world."""

    right: int  # world axis to the right of the picture
    up: int
    away: float  # +1 when larger coordinates along the third axis are farther away

    @property
    def depth(self) -> int:
        """The third axis."""
        return 3 - self.right - self.up


SIDE = View(0, 2, 1.0)  # from the robot's right: x to the right, z up
ABOVE = View(0, 1, -1.0)  # from above: x to the right, y up


def outline(model: mujoco.MjModel, data: mujoco.MjData, geom: int, view: View) -> Float64[np.ndarray, "corner 2"]:
    """The silhouette of one geom, m: sphere, capsule, cylinder or box; of a mesh or any other shape its bounding box.

    What has no end, a plane, and height fields have none.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    center, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    plane = [view.right, view.up]
    circle = size[0] * np.stack([np.cos(ROUND), np.sin(ROUND)], -1)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return center[plane] + circle
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half = turn[:, 2] * size[1]
        return _hull(np.concatenate([(center + half)[plane] + circle, (center - half)[plane] + circle]))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        rim = size[0] * np.stack([np.cos(ROUND), np.sin(ROUND), 0 * ROUND], -1)
        half = np.array([[0.0, 0.0, size[1]]])
        ends = np.concatenate([rim + half, rim - half])
        return _hull((center + ends @ turn.T)[:, plane])
    if kind == mujoco.mjtGeom.mjGEOM_PLANE or kind == mujoco.mjtGeom.mjGEOM_HFIELD:  # "in" would not find NumPy's int
        return np.zeros((0, 2))
    middle, half = np.split(model.geom_aabb[geom], 2)
    return _hull((center + (middle + CORNERS * half) @ turn.T)[:, plane])


def _hull(points: Floats) -> Floats:
    """Corners of the convex hull of points [n, 2]."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all on one line: something flat, seen from its edge
        return points


class Drawing:
    """A scene in one axes; ``show`` moves it to other positions.

    Args:
        ax: in which it is drawn.
        model: of the scene. view: from where.
        cut_at: body in front of whose middle nothing of it is drawn.
        missing: tabs that have broken off.
        marks: geoms that decide success, of an assembly other than the camera's, whose names mean nothing here.
    """

    def __init__(
        self,
        ax: Axes,
        model: mujoco.MjModel,
        view: View,
        cut_at: str = "",
        missing: tuple[str, ...] = (),
        marks: tuple[str, ...] = (),
    ) -> None:
        self._model, self._data, self._view, self._camera = model, mujoco.MjData(model), view, not marks
        names = [model.geom(i).name for i in range(model.ngeom)]
        hidden = _in_front(model, view, cut_at) if cut_at else [self._is(i, *HIDDEN) for i in range(model.ngeom)]
        gone = [name.endswith(missing) and _out_of_reach(model, i) for i, name in enumerate(names)]
        self._geoms = [i for i, name in enumerate(names) if not (hidden[i] or gone[i])]
        self._tabs = [model.geom(name).id for name in marks] or _tabs(model)
        self._tips = [next((t for t, tab in enumerate(self._tabs) if tab == i), None) for i in self._geoms]
        self._collection = PolyCollection([], linewidths=0.6)
        ax.add_collection(self._collection, autolim=False)
        ax.set_aspect("equal")

    def show(self, qpos: Float64[np.ndarray, " nq"], past: Bool[np.ndarray, " tab"]) -> None:
        """Draw the scene at positions; tips of tabs that are past their lips turn green."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        depth = self._data.geom_xpos[self._geoms, self._view.depth] * self._view.away
        # tips and lips on top: they show the assembly
        pairs = zip(self._geoms, self._tips, strict=True)
        top = np.array([tip is not None or self._is(geom, "LIP") for geom, tip in pairs])
        order = np.lexsort((-depth, top))
        shapes = [outline(self._model, self._data, self._geoms[i], self._view) for i in order]
        colors = [self._color(self._geoms[i], self._tips[i], past) for i in order]
        self._collection.set_verts(shapes)
        self._collection.set_facecolor(colors)
        self._collection.set_edgecolor("0.25")

    def place(self, body: str) -> Float64[np.ndarray, " 2"]:
        """Where a body is in the picture, m, as last shown."""
        return self._data.body(body).xpos[[self._view.right, self._view.up]]

    def arm(self) -> Float64[np.ndarray, "body 2"]:
        """Where the bodies from the hand to the robot's base are in the picture, m, as last shown."""
        bodies = [self._model.body("HAND").id]
        while parent := int(self._model.body_parentid[bodies[-1]]):
            bodies.append(parent)
        return self._data.xpos[bodies][:, [self._view.right, self._view.up]]

    def tips(self) -> Float64[np.ndarray, "tab 2"]:
        """Where the tips of the tabs, or the marks, are in the picture, m, as last shown."""
        return self._data.geom_xpos[self._tabs][:, [self._view.right, self._view.up]]

    def _is(self, geom: int, *kinds: str) -> bool:
        """Whether a geom is one of the camera's parts of some kinds, by which its name begins."""
        return self._camera and str(self._model.geom(geom).name).startswith(kinds)

    def _color(self, geom: int, tip: int | None, past: NDArray[np.bool_]) -> Any:
        rgba = tuple(float(c) for c in self._model.geom_rgba[geom])
        if tip is not None and rgba[3] > 0:  # a mark may be invisible
            return SEATED if past[tip] else FREE
        if self._is(geom, "LIP"):
            return LIP
        if self._is(geom, "SEAT"):
            return SEAT
        return rgba


def _out_of_reach(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom of a missing tab is not there: its tip and stop, and blocks that are lowered to meet nothing."""
    name = model.geom(geom).name
    return "TIP_" in name or "STOP_" in name or float(model.geom_pos[geom, 2]) < -0.03


def _in_front(model: mujoco.MjModel, view: View, body: str) -> list[bool]:
    """Which geoms of a body are between its middle and the viewer, or are marks, which are never drawn."""
    of_body = model.geom_bodyid == model.body(body).id
    nearer = model.geom_pos[:, view.depth] * view.away < -1e-3
    hidden: list[bool] = ((of_body & nearer) | (model.geom_rgba[:, 3] == 0)).tolist()
    return hidden


def _tabs(model: mujoco.MjModel) -> list[int]:
    """Geoms of the tips, in the model's order, which is that of ``parts.TABS``."""
    return [i for i in range(model.ngeom) if "TIP_" in model.geom(i).name]
