"""A snap hook: a cantilever whose rounded tip passes a lip, springs back beneath it and is held there.

The beam is a spring that slides sideways; the lip is a pair of turned boxes, one face of each inclined to the direction
of insertion: the lead-in above its edge, the retention face below. Forces follow from two angles, friction and
overlap, as in design guides for snap-fit joints.

Source: the formulas of such guides for a cantilever of constant rectangular section (for example Bayer MaterialScience,
"Snap-Fit Joints for Plastics", 2000), corrected for the deflection of a rounded tip.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError

FACE, DEPTH = 2.2e-3, 0.5e-3  # m, half the length of a lip's faces, and of what is behind them
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])  # quaternion
WIDTH = 3.1e-3  # m, half the width of a lip
ARMATURE = 0.1  # kg, makes the tab slow enough for a 2.5 ms step
Box = tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 4"], tuple[float, ...]]
RIGHT_ANGLE = np.pi / 2 + 1e-9  # rad
STEEP_EDGE = 0.2e-3  # m, least edge of a steep lip, which is made of thin boxes
# Stiff enough for 0.1 mm at 20 N, soft enough for a 2.5 ms step.
SOLREF, SOLIMP = (0.005, 1.0), (0.97, 0.99, 2e-4, 0.5, 2.0)


@dataclass(frozen=True)
class Hook:
    """One tab and its lip. Angles are between a face and the direction of insertion; steeper is harder to pass."""

    stiffness: float  # N/m, of the beam at its tip
    overlap: float  # m, how far the tip reaches under the lip; zero or less = it touches nothing
    lead_angle: float  # rad, of the face that is passed by pressing
    retention_angle: float  # rad, of the face that is passed by pulling
    friction: float  # sliding
    tip_radius: float = 0.4e-3  # m
    edge: float = 0.1e-3  # m, height of the lip's edge, between its two faces

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value) or (value <= 0 and field.name != "overlap"):
                raise InputError(f"The hook's {field.name} is {value}; expected a positive number.")
        if max(self.lead_angle, self.retention_angle) > RIGHT_ANGLE:
            raise InputError(
                f"The hook's lead_angle is {self.lead_angle:g} and its retention_angle {self.retention_angle:g}; "
                "expected radians, each at most a right angle."
            )
        if not self.blunt and self.edge < STEEP_EDGE:
            raise InputError(
                f"The hook's edge is {self.edge * 1e3:g} mm; angles that sum to more than 90 degrees need "
                f"{STEEP_EDGE * 1e3:g} mm or more."
            )

    @property
    def blunt(self) -> bool:
        """Whether both faces belong to one solid wedge."""
        return bool(self.lead_angle + self.retention_angle <= RIGHT_ANGLE)


def beam_stiffness(modulus: float, width: float, thickness: float, length: float) -> float:
    """Force over deflection at the tip of a cantilever: E b h^3 / (4 L^3).

    Args:
        modulus: of elasticity, Pa.
        width: m. thickness: m, in the direction of bending. length: m.

    Returns:
        N/m.

    Example:
        >>> round(beam_stiffness(2.3e9, 6.2e-3, 1.9e-3, 14.2e-3))  # ABS; the camera's tabs in its 14.2 mm cover
        8540
    """
    return modulus * width * thickness**3 / (4 * length**3)


def strain(overlap: float, thickness: float, length: float) -> float:
    """Largest strain of a cantilever whose tip is deflected by the overlap: 3 y h / (2 L^2).

    Args:
        overlap: m. thickness: m, in the direction of bending. length: m.

    Example:
        >>> round(strain(0.8e-3, 1.9e-3, 14.2e-3), 4)
        0.0113
    """
    return 1.5 * overlap * thickness / length**2


def mating_force(hook: Hook) -> float:
    """Force by which a slow press passes the lip, N.

    Example:
        >>> hook = Hook(8540.0, 0.8e-3, np.radians(30), np.radians(60), friction=0.2)
        >>> round(mating_force(hook), 2), round(separation_force(hook), 2)
        (5.6, 15.15)
    """
    return _passing_force(hook, hook.lead_angle)


def separation_force(hook: Hook) -> float:
    """Force of a slow pull that frees the hook, N; infinite where friction alone holds it (mu tan b >= 1)."""
    return _passing_force(hook, hook.retention_angle)


def _passing_force(hook: Hook, angle: float) -> float:
    """k y (mu + tan a) / (1 - mu tan a), with the deflection y at which a rounded tip leaves the inclined face."""
    slope = np.tan(angle)
    deflection = max(hook.overlap - hook.tip_radius * (1 - np.cos(angle)), 0.0)
    if deflection == 0:
        return 0.0  # before friction is asked: nothing touches the face
    if hook.friction * slope >= 1:
        return np.inf
    return float(hook.stiffness * deflection * (hook.friction + slope) / (1 - hook.friction * slope))


def worn(hook: Hook, depth: float) -> Hook:
    """The hook after ``depth`` (m) of its tip has been rubbed off: it reaches less far and is blunter."""
    return replace(hook, overlap=hook.overlap - depth, tip_radius=hook.tip_radius + depth)


def broken(hook: Hook) -> Hook:
    """The hook without its head: its beam touches nothing."""
    return replace(hook, overlap=-hook.tip_radius)


def first_touch(hook: Hook, overlap: Any = None) -> Any:
    """Height of the tip's centre above the lower end of the lip's edge, m, as it first meets the lead-in.

    Args:
        hook: its angles, tip and edge.
        overlap: m, of any shape; default the hook's.
    """
    a, reach = hook.lead_angle, (hook.overlap if overlap is None else overlap) - hook.tip_radius
    return hook.edge + (reach + hook.tip_radius / np.cos(a)) / np.tan(a)


def lip_boxes(hook: Hook) -> dict[str, Box]:
    """Place (m), turn (quaternion) and half sizes (m) of the two boxes of a lip.

    The frame has its origin at the lower end of the lip's edge, x into the lip (outwards), z against the insertion.
    """
    boxes: dict[str, Box] = {}
    for name, angle, up in (("LEAD", hook.lead_angle, 1.0), ("BACK", hook.retention_angle, -1.0)):
        along = np.array([np.sin(angle), 0.0, up * np.cos(angle)])
        normal = np.array([-np.cos(angle), 0.0, up * np.sin(angle)])
        # a thicker one would stand out on the other side
        depth = DEPTH if hook.blunt else hook.edge / (2 * np.sin(angle))
        corner = np.array([0.0, 0.0, hook.edge if up > 0 else 0.0])
        turn, matrix = np.zeros(4), np.stack([along, np.cross(normal, along), normal], axis=1)
        mujoco.mju_mat2Quat(turn, matrix.ravel())
        boxes[name] = (corner + FACE * along - depth * normal, turn, (FACE, WIDTH, depth))
    return boxes


def facing(outward: float, turn: Float64[np.ndarray, " 4"] = UNTURNED) -> Float64[np.ndarray, " 4"]:
    """A quaternion, turned by half a turn about z where ``outward`` is -1: a lip on the other side."""
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, UNTURNED if outward > 0 else np.array([0.0, 0.0, 0.0, 1.0]), turn)
    return quat


def add_tab(hand: mujoco.MjsBody, name: str, hook: Hook, place: Float64[np.ndarray, " 3"]) -> None:
    """Hang a tab on the hand: a sphere on a spring.

    Args:
        hand: body that carries it.
        name: of the tab; its joint and tip are named after it.
        hook: its parameters.
        place: m, of the tip's centre in the hand's frame, in which the tab bends along -x.
    """
    body = hand.add_body(name=f"TAB_{name}", pos=place)
    damping = 2 * np.sqrt(hook.stiffness * ARMATURE)  # critical: a plastic beam does not ring for long
    body.add_joint(
        name=f"TAB_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(-1.0, 0.0, 0.0), armature=ARMATURE,
        stiffness=[hook.stiffness, 0.0, 0.0], damping=[damping, 0.0, 0.0],
    )  # fmt: skip
    body.add_geom(
        name=f"TIP_{name}", size=(hook.tip_radius, 0.0, 0.0), mass=0.002, contype=0, conaffinity=0,
        rgba=(0.9, 0.5, 0.1, 1.0),
    )  # fmt: skip


def add_lip(
    spec: mujoco.MjSpec, holder: mujoco.MjsBody, name: str, hook: Hook, place: Float64[np.ndarray, " 3"]
) -> None:
    """Put the lip of a tab on its holder, and let the tab's tip touch it.

    Args:
        spec: that holds both. holder: body that carries the lip.
        name: of the tab. hook: its parameters.
        place: m, of the lower end of the lip's edge in the holder's frame, whose z points against the insertion; the
            lip lies along x.
    """
    for kind, (offset, turn, size) in lip_boxes(hook).items():
        holder.add_geom(
            name=f"{kind}_{name}", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=place + offset, quat=turn,
            mass=0.0, contype=0, conaffinity=0, rgba=(0.3, 0.3, 0.3, 1.0),
        )  # fmt: skip
        pair = spec.add_pair(
            name=f"TIP_{name}:{kind}_{name}", geomname1=f"TIP_{name}", geomname2=f"{kind}_{name}", condim=3
        )
        pair.friction = (hook.friction, hook.friction, 0.005, 1e-4, 1e-4)
        pair.solref, pair.solimp = SOLREF, SOLIMP
