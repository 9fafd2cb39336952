"""The camera's parts with hooks that catch: undercut lips of their real shape in place of blocks that rub.

The scene is that of :mod:`sim_mjx.assembly.parts`; what differs are the tips, the lips and what stops the hand. A tab
is a cantilever whose rounded tip is deflected by the lead-in of its lip, springs back beneath the edge and is held
there by the retention face (:mod:`sim_mjx.assembly.hook`). A stop near the tab's root meets the edge of the lip, so
that a hand that is pushed forward does not carry its rear hooks past theirs. It is upright where it stops: an inclined
one would press the hand down, and the rear hooks past their lips before the hand does. It needs at least four physics
steps per control period; the scene has eight (docs/snap_fit.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float64
from numpy.typing import NDArray

from rcbht_jax.types import Array
from sim_mjx.assembly import parts
from sim_mjx.assembly.hook import SOLIMP, SOLREF, Hook, facing, first_touch, lip_boxes
from sim_mjx.assembly.parts import BLOCK, TAB_SPACING, TABS, TIP_HEIGHT, Fields, PartParams, placed, tab_place

# The camera's tab from its drawing: a cantilever of ABS; both faces of a lip belong to one wedge of a right angle.
HOOK = Hook(8540.0, 0.79e-3, np.radians(40.0), np.radians(50.0), friction=0.3)
ROOT = 0.005  # m, from the body of a tab down to its tip
STOP_RADIUS, STOP_HEIGHT = 0.005, 0.0022  # m, so large that its face is upright at any depth of the seat; above the tip
LIP_WIDTH = 0.0045  # m, half the width of a slot, in which a tip is beneath its lip
DEEPEST = 0.012  # m beneath its lip's edge, where the floor of a slot is
BROKEN_OFF = 0.02  # m, cut off a tab: the rest of it reaches no lip
# of the nominal hook: kind -> place from the lower end of the lip's edge, turn, half sizes
_LIP_BOXES = {{"LEAD": "LIP", "BACK": "BACK"}[kind]: box for kind, box in lip_boxes(HOOK).items()}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HookedParams(PartParams):
    """Parameters of parts with hooks, which may differ per trial; leaves of a batch have a leading trial axis."""

    hook_wear: Float[Array, "*batch 4"]  # m, rubbed off each hook's head, which then reaches less far
    tab_cut: Float[Array, "*batch 4"]  # m, broken off each tab's end; more than the depth of the seat = no hook is left
    stop_play: Float[Array, "*batch"]  # m, between the stop of a whole hook and the edge of its lip
    foot_reach: Float[Array, "*batch"]  # m, of the rim that meets the seat, beyond the tips: a tilted hand stands on it
    lip_impedance: Float[Array, "*batch 4"]  # least impedance of a tip on its lip; the nearer to 1, the less it creeps
    tilt: Float[Array, "*batch 2"]  # rad, of the female part about its own x and y axes, as a rotation vector

    widest: ClassVar[float] = 2.8e-3  # m, width of a lip's lead-in
    positive: ClassVar[tuple[str, ...]] = (*PartParams.positive, "hook_overlap", "stop_play", "lip_impedance")

    def with_overlap(self, overlap: Float64[np.ndarray, "*batch 4"]) -> HookedParams:
        """As :meth:`PartParams.with_overlap`; a missing tab is broken off at its root."""
        gone = np.asarray(overlap) < 0
        return replace(self, hook_overlap=np.abs(overlap), tab_cut=np.where(gone, BROKEN_OFF, self.tab_cut))

    @property
    def missing(self) -> Bool[np.ndarray, "*batch 4"]:
        """As of any parts."""
        return np.asarray(self.tab_cut) >= BROKEN_OFF


def add_male(spec: mujoco.MjSpec, arm: str) -> None:
    """Hang the male part on the tool, as :func:`sim_mjx.assembly.parts.add_male` does, with the tips of its hooks."""
    parts.add_male(spec, arm)
    tool = spec.body(f"{arm}ARM_TOOL")
    for name in TABS:
        tab, tip = spec.body(f"{arm}TAB_{name}"), spec.geom(f"{arm}TIP_{name}")
        tip.size[0] = HOOK.tip_radius
        # a tip at the origin of its body could not be moved by a trial
        tab.pos, tip.pos = tab.pos + np.array([ROOT, 0.0, 0.0]), (-ROOT, 0.0, 0.0)
        tool.add_geom(
            name=f"{arm}STOP_{name}", size=(STOP_RADIUS, 0.0, 0.0), pos=tab.pos, mass=0.0, contype=0, conaffinity=0,
            rgba=(0.25, 0.45, 0.75, 1.0),
        )  # fmt: skip


def add_female(spec: mujoco.MjSpec, arm: str) -> None:
    """Put the female part on its mount, as :func:`sim_mjx.assembly.parts.add_female` does, with undercut lips.

    Tab by tab, ``LIP`` is the lead-in and ``BACK`` the retention face; ``EDGE`` marks the lower end of the lip's edge,
    its x axis pointing into the lip and z against the insertion.
    """
    parts.add_female(spec, arm)
    mount = spec.body("MOUNT")
    for index, name in enumerate(TABS):
        place, outward = (*tab_place(index), -DEEPEST), parts.outward_of(index)
        parts.add_box(mount, f"BACK_{name}", (1e-3, 1e-3, 1e-3), place)
        parts.add_box(mount, f"EDGE_{name}", (1e-4, 1e-4, 1e-4), place)
        spec.geom(f"EDGE_{name}").quat = facing(outward)
        parts.add_pair(spec, f"{arm}TIP_{name}", f"BACK_{name}")
        parts.add_pair(spec, f"{arm}STOP_{name}", f"LIP_{name}")
        for kind, (_, turn, size) in _LIP_BOXES.items():
            geom = spec.geom(f"{kind}_{name}")
            geom.size, geom.quat = size, facing(outward, turn)
        for pair in (f"{arm}TIP_{name}:LIP_{name}", f"{arm}TIP_{name}:BACK_{name}", f"{arm}STOP_{name}:LIP_{name}"):
            spec.pair(pair).solref, spec.pair(pair).solimp = SOLREF, SOLIMP


def model_fields(model: mujoco.MjModel, params: HookedParams, arm: str = "R") -> Fields:
    """Fields of the compiled model that hold these parameters; see :func:`sim_mjx.assembly.parts.model_fields`."""
    out = parts.model_fields(model, params, arm)
    for index, name in enumerate(TABS):
        places = _boxes(index, params)
        geoms = {f"{kind}_{name}": place for kind, place in places.items()}
        geoms |= {f"{arm}TIP_{name}": _tip(index, params), f"{arm}STOP_{name}": _stop(index, params)}
        for geom, place in geoms.items():
            out["geom_pos"][..., model.geom(geom).id, :] = place
        out["geom_pos"][..., model.geom(f"{arm}FOOT_{name}").id, 2] -= parts.outward_of(index) * params.foot_reach
        least, lip = params.lip_impedance[..., index], model.pair(f"{arm}TIP_{name}:LIP_{name}").id
        # under load a third of the compliance is left, as in the nominal hook
        out["pair_solimp"][..., lip, :2] = placed(least, 1 - (1 - least) / 3)
    out["body_quat"][..., model.body("MOUNT").id, :] = _turned(params)
    return out


def caught(local: Float[Array, "*tabs 3"]) -> Bool[Array, "*tabs"]:
    """Which tabs are caught: their tips have sprung back beneath the lips and are above the slots' floors.

    Args:
        local: centres of the tips from the lower ends of the lips' edges, m: x into the lip, z against the insertion.
    """
    below = (local[..., 2] < 0.0) & (local[..., 2] > -DEEPEST)
    beneath = (local[..., 0] > -HOOK.tip_radius) & (local[..., 0] < DEEPEST)
    return below & beneath & (abs(local[..., 1]) < LIP_WIDTH)


def _turned(params: HookedParams) -> NDArray[np.float64]:
    """Quaternion [..., 4] of the female part: turned about the vertical, then tilted."""
    half = np.asarray(params.tilt) / 2
    angle = np.linalg.norm(half, axis=-1)
    level, lean = np.cos(angle), half * np.sinc(angle / np.pi)[..., None]
    cos, sin = np.cos(np.asarray(params.roll) / 2), np.sin(np.asarray(params.roll) / 2)
    x, y = lean[..., 0], lean[..., 1]
    return placed(cos * level, cos * x - sin * y, cos * y + sin * x, sin * level)


def _tip(index: int, params: HookedParams) -> NDArray[np.float64]:
    """Place of a tip [..., 3] in its tab's frame, x up the hand and z backwards."""
    return placed(params.tab_cut[..., index] - ROOT, 0.0, parts.outward_of(index) * params.hook_wear[..., index])


def _stop(index: int, params: HookedParams) -> NDArray[np.float64]:
    """Place [..., 3] in the wrist's frame of the stop that holds the hand once a hook is beneath its lip."""
    aft, left = tab_place(index)
    behind = params.hook_overlap[..., index] + params.stop_play + STOP_RADIUS - HOOK.tip_radius
    back = -TAB_SPACING[0] / 2 - aft + parts.outward_of(index) * behind
    return placed(TIP_HEIGHT + STOP_HEIGHT + params.tab_cut[..., index], left, back)


def _boxes(index: int, params: HookedParams) -> dict[str, NDArray[np.float64]]:
    """Places [..., 3] of a slot's boxes in the mount's frame, whose origin is the front tips' first touch."""
    (aft, aside), outward = tab_place(index), parts.outward_of(index)
    overlap = params.hook_overlap[..., index]
    edge = aft + outward * (HOOK.tip_radius - overlap)
    # the centre of a whole tip is at the mount's origin height when it meets the lead-in
    low = (params.rear_rise[..., 0] if index >= 2 else 0.0) - first_touch(HOOK, overlap)
    out = {kind: placed(edge + outward * off[0], aside, low + off[2]) for kind, (off, _, _) in _LIP_BOXES.items()}
    reach, top = HOOK.tip_radius + params.slot_play + BLOCK[1], low + HOOK.edge
    return out | {
        "EDGE": placed(edge, aside, low),
        "BLOCK1": placed(aft, aside - reach, top - BLOCK[2]),
        "BLOCK2": placed(aft, aside + reach, top - BLOCK[2]),
    }
