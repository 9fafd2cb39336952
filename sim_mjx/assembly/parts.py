"""Male and female camera parts: four snap tabs, the lips they must pass, the blocks beside the slots, the seat.

The male part hangs in the hand, its tabs at the corners of a rectangle around the wrist's axis, 117 mm below the
wrist; the female part stands on a compliant mount.
A tab is a spring-loaded sphere that slides along the hand's fore-aft direction; a lip is a box whose edge it must
pass: force rises with the tab's deflection, drops when the tip is past the edge, rises again at the seat.
Only spheres against boxes touch, through explicit pairs, because every engine agrees on those.
Sources: the CAD model, and the recordings: the point of the hand that stays still while session A rotates, and the
centre of pressure, which visits the four corners.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float64
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.hook import UNTURNED

Vector = tuple[float, float, float]
Fields = dict[str, Float64[np.ndarray, "..."]]  # of a compiled model, by MjModel attribute name
TABS = ("FR", "FL", "RR", "RL")  # front/rear, right/left
TAB_SPACING = (0.0397, 0.0321)  # m, front to rear and right to left
TIP_HEIGHT = -0.117  # m, tips below the wrist along the hand; identified from the pivot, to 0.3 mm
FIRST_TOUCH = np.array([0.3091, -0.1727, 0.4247])  # m, world, midway between the front tips as they meet the lips
TAB_ARMATURE = 0.1  # kg, makes the tab slow enough for a 2.5 ms step; its settling stays below 10 ms
TIP_RADIUS = 0.002  # m, of tips and feet
FOOT_HEIGHT = 0.004  # m, centres of the feet above the tips
LIP = (0.004, 0.0045, 0.003)  # m, half sizes of a lip
PAST = LIP[2] - TIP_RADIUS * 0.2  # m, above the middle of a lip, beneath which a tip is past it
BLOCK = (0.006, 0.006, 0.003)  # m, half sizes of a block beside a slot
MOUNT, MOUNT_MASS = "MOUNT", 0.3  # body, kg
BOX = (0.3, 0.3, 0.3, 1.0)  # colour


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PartParams:
    """Parameters of the parts, which may differ per trial; leaves of a batch have a leading trial axis."""

    tab_stiffness: Float[Array, "*batch 4"]  # N/m, order of TABS
    tab_damping: Float[Array, "*batch 4"]  # Ns/m
    hook_overlap: Float[Array, "*batch 4"]  # m, how far a lip reaches over its tab; negative = the tab is missing
    slot_play: Float[Array, "*batch"]  # m, between a tip and the blocks on each side
    seat_depth: Float[Array, "*batch"]  # m, below first touch, where the part sits on the seat
    foot_spread: Float[Array, "*batch"]  # m, from the middle of the male part to its feet on the right and on the left
    foot_offset: Float[Array, "*batch 2"]  # m, of the front and the rear feet's middle to the left
    rear_rise: Float[Array, "*batch 2"]  # m, rear lips above the front ones and rear feet above the front ones
    foot_contact: Float[Array, "*batch 4"]  # time constant, s, least and most impedance, depth between them, m
    friction: Float[Array, "*batch"]  # sliding friction of all contacts
    mount_stiffness: Float[Array, "*batch 3"]  # N/m, x y z of the female part's mount
    mount_damping: Float[Array, "*batch 3"]  # Ns/m
    position: Float[Array, "*batch 3"]  # m, shift of the female part from its nominal place, world
    roll: Float[Array, "*batch"]  # rad, turn of the female part about the vertical

    widest: ClassVar[float] = TIP_RADIUS  # m, overlap that no tab passes
    positive: ClassVar[tuple[str, ...]] = ("tab_stiffness", "mount_stiffness", "friction", "slot_play", "seat_depth")

    def with_overlap(self, overlap: Float64[np.ndarray, "*batch 4"]) -> PartParams:
        """The parts with other overlaps, m; a negative one = the tab is missing."""
        return replace(self, hook_overlap=overlap)

    @property
    def missing(self) -> Bool[np.ndarray, "*batch 4"]:
        """Which tabs have broken off."""
        return np.asarray(self.hook_overlap) < 0


def check(params: PartParams) -> None:
    """Check the parameters of parts.

    Raises:
        InputError: a value is not finite or out of its range.
    """
    values = {field.name: np.asarray(getattr(params, field.name)) for field in fields(params)}
    for name, one in values.items():
        if not np.isfinite(one).all():
            raise InputError(f"The part's {name} holds a value that is not a finite number.")
    for name in params.positive:
        if not (values[name] > 0).all():
            raise InputError(f"The part's {name} must be positive.")
    if (values["hook_overlap"] >= params.widest).any():
        largest = 1e3 * float(np.max(params.hook_overlap))
        raise InputError(
            f"The part's hook_overlap is {largest:g} mm; its tab passes a lip of less than {params.widest * 1e3:g} mm."
        )


def tab_place(index: int) -> tuple[float, float]:
    """Fore-aft and left offset of a tab's tip from the middle of the front tips, m."""
    aft = -TAB_SPACING[0] if index >= 2 else 0.0
    left = TAB_SPACING[1] / 2 * (1 if index % 2 else -1)
    return aft, left


def outward_of(index: int) -> float:
    """1 where a hook points forward, as the front ones do, -1 where backward."""
    return 1.0 if index < 2 else -1.0


def add_male(spec: mujoco.MjSpec, arm: str, grip: Vector = (0.0, 0.0, 0.0)) -> None:
    """Hang the male part on the tool: four sliding tabs and four feet that meet the seat.

    Places, springs and contacts of the compiled parts are provisional: :func:`model_fields` gives a trial's.

    Args:
        spec: of the scene. arm: that holds the part.
        grip: m, wrist frame, where the hand holds it, from the recorded place of the one-arm sessions.
    """
    tool = spec.body(f"{arm}ARM_TOOL")
    half = TAB_SPACING[0] / 2
    up, left, back = TIP_HEIGHT + grip[0], grip[1], grip[2] - half  # wrist frame: x up the hand, z backwards
    tool.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=(up + 0.012, left, back + half), size=(0.007, 0.037, 0.0225),
        contype=0, conaffinity=0, mass=0.0, group=2, rgba=(0.25, 0.45, 0.75, 1.0),
    )  # fmt: skip
    for index, name in enumerate(TABS):
        aft, aside = tab_place(index)
        tab = tool.add_body(name=f"{arm}TAB_{name}", pos=(up, left + aside, back - aft))
        tab.add_joint(
            name=f"{arm}TAB_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0.0, 0.0, 1.0), armature=TAB_ARMATURE,
            stiffness=[1e4, 0.0, 0.0], damping=[80.0, 0.0, 0.0], range=(-0.003, 0.003),
        )  # fmt: skip
        tab.add_geom(
            name=f"{arm}TIP_{name}", size=(TIP_RADIUS, 0.0, 0.0), mass=0.002, contype=0, conaffinity=0,
            rgba=(0.9, 0.5, 0.1, 1.0),
        )  # fmt: skip
        tool.add_geom(
            name=f"{arm}FOOT_{name}", size=(TIP_RADIUS, 0.0, 0.0), mass=0.0, contype=0, conaffinity=0,
            pos=(up + FOOT_HEIGHT, left + aside, back - aft), rgba=(0.25, 0.45, 0.75, 1.0),
        )  # fmt: skip


def add_female(
    spec: mujoco.MjSpec,
    arm: str,
    holder: mujoco.MjsBody | None = None,
    place: Float64[np.ndarray, " 3"] = FIRST_TOUCH,
    turn: Float64[np.ndarray, " 4"] = UNTURNED,
) -> None:
    """Put the female part on its mount: per tab a lip and two blocks, and one seat for all feet.

    Args:
        spec: of the scene. arm: that holds the male part.
        holder: body that carries the mount; None = the world.
        place: m, of the front tips' first touch in the holder's frame.
        turn: quaternion of the mount in that frame; its z axis points from the female part to the male one.
    """
    mount = add_mount(holder or spec.worldbody, place, turn, stiffness=1e4, damping=60.0)
    for index, name in enumerate(TABS):
        aft, aside = tab_place(index)
        for kind, size in (("LIP", LIP), ("BLOCK1", BLOCK), ("BLOCK2", BLOCK)):
            add_box(mount, f"{kind}_{name}", size, (aft, aside, -size[2]))
            add_pair(spec, f"{arm}TIP_{name}", f"{kind}_{name}")
        add_pair(spec, f"{arm}FOOT_{name}", "SEAT")
    add_box(mount, "SEAT", (0.035, 0.045, 0.004), (-TAB_SPACING[0] / 2, 0.0, -0.005))


def add_mount(
    holder: mujoco.MjsBody, place: Any, turn: Any = UNTURNED, stiffness: float = 0.0, damping: float = 0.0
) -> mujoco.MjsBody:
    """Add the female part's mount, which slides on three springs, N/m and Ns/m; a trial sets these."""
    mount = holder.add_body(name=MOUNT, pos=place, quat=turn, gravcomp=1.0)
    mount.mass, mount.inertia, mount.explicitinertial = MOUNT_MASS, (2e-4, 2e-4, 2e-4), True
    for axis, name in enumerate("XYZ"):
        mount.add_joint(
            name=f"{MOUNT}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)[axis],
            stiffness=[stiffness, 0.0, 0.0], damping=[damping, 0.0, 0.0],
        )  # fmt: skip
    return mount


def add_box(
    body: mujoco.MjsBody, name: str, size: Vector, place: Vector, turn: Any = UNTURNED, rgba: Any = BOX
) -> None:
    """Add a box without mass that touches only the geoms it is paired with, m; a trial sets its place."""
    # never at the body's origin: MuJoCo would then ignore the position that a trial sets
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=place, quat=turn, mass=0.0, contype=0, conaffinity=0,
        rgba=rgba,
    )  # fmt: skip


def add_pair(spec: mujoco.MjSpec, first: str, second: str) -> None:
    """Let two geoms touch: stiff enough for 0.05 mm at 20 N, soft enough for the physics' step."""
    pair = spec.add_pair(name=f"{first}:{second}", geomname1=first, geomname2=second, condim=3)
    pair.solref, pair.solimp = (0.005, 1.0), (0.95, 0.99, 0.0005, 0.5, 2.0)


def model_fields(model: mujoco.MjModel, params: PartParams, arm: str = "R") -> Fields:
    """Fields of the compiled model that hold these parameters.

    Args:
        model: of a scene with both parts.
        params: of one trial, or of a batch; the leaves and fields of a batch have a leading trial axis.
        arm: that holds the male part.
    """
    lead = np.shape(params.roll)
    out = {name: np.broadcast_to(getattr(model, name), lead + getattr(model, name).shape).copy() for name in (
        "jnt_stiffness", "dof_damping", "geom_pos", "pair_friction", "pair_solref", "pair_solimp", "body_pos",
        "body_quat",
    )}  # fmt: skip
    for index, name in enumerate(TABS):
        joint = model.joint(f"{arm}TAB_{name}")
        out["jnt_stiffness"][..., joint.id] = params.tab_stiffness[..., index]
        out["dof_damping"][..., joint.dofadr[0]] = params.tab_damping[..., index]
        for kind, place in _boxes(index, params).items():
            out["geom_pos"][..., model.geom(f"{kind}_{name}").id, :] = place
        out["geom_pos"][..., model.geom(f"{arm}FOOT_{name}").id, :] = _foot(index, params)
    for axis, name in enumerate("XYZ"):
        joint = model.joint(f"MOUNT_{name}")
        out["jnt_stiffness"][..., joint.id] = params.mount_stiffness[..., axis]
        out["dof_damping"][..., joint.dofadr[0]] = params.mount_damping[..., axis]
    seat = placed(-TAB_SPACING[0] / 2, 0.0, FOOT_HEIGHT - TIP_RADIUS - params.seat_depth - 0.004)
    out["geom_pos"][..., model.geom("SEAT").id, :] = seat
    out["pair_friction"][..., :2] = np.asarray(params.friction)[..., None, None]
    feet = [model.pair(f"{arm}FOOT_{name}:SEAT").id for name in TABS]
    out["pair_solref"][..., feet, 0] = params.foot_contact[..., :1]
    out["pair_solimp"][..., feet, :3] = params.foot_contact[..., None, 1:]
    mount = model.body("MOUNT").id
    out["body_pos"][..., mount, :] = model.body_pos[mount] + params.position
    half = np.asarray(params.roll) / 2
    out["body_quat"][..., mount, :] = placed(np.cos(half), 0.0, 0.0, np.sin(half))
    return out


def placed(*coordinates: Any) -> NDArray[np.float64]:
    """Coordinates of any shape, stacked in a new last axis."""
    return np.stack(np.broadcast_arrays(*coordinates), axis=-1)


def _foot(index: int, params: PartParams) -> NDArray[np.float64]:
    """Place of a foot [..., 3] in the wrist's frame, x up the hand and z backwards."""
    aft, _ = tab_place(index)
    left = params.foot_spread * (1 if index % 2 else -1) + params.foot_offset[..., index // 2]
    rise = params.rear_rise[..., 1] if index >= 2 else 0.0
    return placed(TIP_HEIGHT + FOOT_HEIGHT + rise, left, -TAB_SPACING[0] / 2 - aft)


def _boxes(index: int, params: PartParams) -> dict[str, NDArray[np.float64]]:
    """Places [..., 3] of a slot's lip and blocks in the mount's frame, whose origin is the front tips' first touch."""
    (aft, aside), outward = tab_place(index), outward_of(index)
    overlap = params.hook_overlap[..., index]
    edge = aft + outward * (TIP_RADIUS - overlap)
    # the tips' lowest points touch the lips' edges at the mount's origin height
    top = -np.sqrt(np.maximum(TIP_RADIUS**2 - (TIP_RADIUS - np.maximum(overlap, 0.0)) ** 2, 0.0))
    top = top + (params.rear_rise[..., 0] if index >= 2 else 0.0)
    gone = np.where(overlap < 0, -0.05, 0.0)  # a missing tab meets nothing
    reach = TIP_RADIUS + params.slot_play + BLOCK[1]
    return {
        "LIP": placed(edge + outward * LIP[0], aside, top - LIP[2] + gone),
        "BLOCK1": placed(aft, aside - reach, top - BLOCK[2] + gone),
        "BLOCK2": placed(aft, aside + reach, top - BLOCK[2] + gone),
    }


def from_lips(
    tips: Float[Array, "*tabs 3"], lips: Float[Array, "*tabs 3"], turns: Float[Array, "*tabs 3 3"]
) -> Float[Array, "*tabs 3"]:
    """Places of tips in the frames of their lips, m.

    Args:
        tips: centres of the tips, m, world.
        lips: centres of their lips, m, world.
        turns: of the lips, columns are their axes in the world.
    """
    return (turns * (tips - lips)[..., None]).sum(-2)


def past_lips(local: Float[Array, "*tabs 3"]) -> Bool[Array, "*tabs"]:
    """Which tabs have snapped, by where their tips are: below the lip's edge and sprung back beneath it.

    Args:
        local: centres of the tips in the frames of their lips, m; see :func:`from_lips`.
    """
    below = local[..., 2] < PAST
    near = abs(local[..., 0]) < LIP[0] + TIP_RADIUS * 1.5
    inside = abs(local[..., 1]) < LIP[1]
    return below & near & inside
