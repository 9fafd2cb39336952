"""A hook on the male part and its lip on the female one, as clip and plug have them; see ``sim_mjx.assembly.hook``."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from rcbht_jax.types import Array
from sim_mjx.assemblies.assembly import FaultOf, Range, Variation
from sim_mjx.assemblies.draw import uniform, with_own
from sim_mjx.assemblies.fields import MARK, FieldWriter, mark
from sim_mjx.assembly.hook import ARMATURE, Hook, add_lip, add_tab, beam_stiffness, first_touch

# An ABS beam of 6 x 1.9 x 14 mm; its separation force is more than twice the pull that tests the latch.
HOOK = Hook(
    beam_stiffness(2.3e9, 6.2e-3, 1.9e-3, 14.2e-3), overlap=0.8e-3, lead_angle=np.radians(30),
    retention_angle=np.radians(60), friction=0.2,
)  # fmt: skip
NAME = "LATCH"
AWAY = 4e-3  # m, by which the lip of a hook without its head is moved aside: it is then out of reach
PLAY = 0.25e-3  # m, of a caught hook beneath its lip
MARKS = (f"TIP_{NAME}", f"EDGE_{NAME}")
TRAVEL = (  # m, from the first touch of the lip until the hook has sprung back, with its play
    first_touch(HOOK) + HOOK.tip_radius + (HOOK.overlap - HOOK.tip_radius * (1 - np.cos(HOOK.retention_angle)))
    / np.tan(HOOK.retention_angle) + PLAY
)  # fmt: skip


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LatchParts:
    """Parameters of parts with a hook; the seat is what stops the press."""

    stiffness: Float[Array, "*batch"]  # N/m, of the hook at its tip
    overlap: Float[Array, "*batch"]  # m, how far the lip reaches over the hook; zero or less = the hook has no head
    clearance: Float[Array, "*batch"]  # m, between guides and walls on each side
    seat: Float[Array, "*batch"]  # m, how much the seat is raised


@dataclass(frozen=True)
class LatchVariation(Variation):
    """What varies between trials of parts with a hook; see :class:`Variation`."""

    shift: Range = (-0.8e-3, 0.8e-3)  # m, error of the mouth's assumed place, x and y; chosen: needs no search
    beam: Range = (0.85, 1.15)  # factor on the hook's stiffness; as for the camera's tabs
    overlap: Range = (0.70e-3, 0.85e-3)  # m, of lip over hook; chosen: tolerance of moulding
    clearance: Range = (0.10e-3, 0.20e-3)  # m, between guides and walls on each side; chosen
    stop_at: Range = (0.5, 1.6)  # s, fault early-stop; chosen: before any hook snaps
    stiff: Range = (6.0, 9.0)  # factor, fault stiff-hook: more than most presses can bend; chosen
    worn: Range = (0.05e-3, 0.15e-3)  # m, fault worn-hook: what is left of the overlap; chosen
    chip: Range = (0.8e-3, 2.0e-3)  # m, fault chip: something on the seat keeps the hook above its lip; chosen


def draw(spec: LatchVariation, rng: np.random.Generator) -> LatchParts:
    """The parts' parameters of one trial."""
    stiffness = HOOK.stiffness * uniform(rng, spec.beam)
    return LatchParts(stiffness, uniform(rng, spec.overlap), uniform(rng, spec.clearance), np.asarray(0.0))


def add_hook(spec: mujoco.MjSpec, body: mujoco.MjsBody, x: float, height: float) -> None:
    """Hang the hook on the male part, its edge line at ``x`` and its tip's centre at ``height``, m."""
    add_tab(body, NAME, HOOK, np.array([x + HOOK.overlap - HOOK.tip_radius, 0.0, height]))
    spec.body(f"TAB_{NAME}").add_geom(
        name="BEAM", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0.0, 0.0, 0.0, -5e-4, 0.0, 0.014), mass=0.0,
        size=(HOOK.tip_radius, 0.0, 0.0), contype=0, conaffinity=0, group=2, rgba=MARK,
    )  # fmt: skip


def add_catch(spec: mujoco.MjSpec, body: mujoco.MjsBody, x: float, height: float) -> None:
    """Put the lip on the female part, the lower end of its edge at ``height``, m, and let the hook touch it."""
    place = np.array([x, 0.0, height])
    add_lip(spec, body, NAME, HOOK, place)
    mark(body, MARKS[1], (x, 0.0, height))


def write(writer: FieldWriter, own: LatchParts) -> None:
    """Spring and lip of a trial."""
    stiffness, overlap = np.asarray(own.stiffness), np.asarray(own.overlap)
    writer.spring(f"TAB_{NAME}", stiffness, 2 * np.sqrt(stiffness * ARMATURE))
    aside = np.where(overlap > 0, HOOK.overlap - overlap, AWAY)
    for geom in (f"LEAD_{NAME}", f"BACK_{NAME}", MARKS[1]):
        writer.place(geom, writer.nominal("geom_pos", "geom", geom) + aside[..., None] * np.array([1.0, 0.0, 0.0]))


def is_caught(local: Float[Array, "*mark 3"]) -> Bool[Array, "*mark"]:
    """Whether the hook's tip is beneath the lip; ``local`` is its centre from the lower end of the lip's edge, m."""
    beneath = (local[..., 0] > -HOOK.tip_radius) & (local[..., 0] < 2e-3)
    return (local[..., 2] < 0.0) & (local[..., 2] > -3e-3) & beneath


FAULTS: dict[str, FaultOf] = {
    # the hook's head has broken off
    "broken-hook": lambda trial, spec, rng: with_own(trial, overlap=np.asarray(-1e-3)),
    # the hook does not bend, as if its slot were filled
    "stiff-hook": lambda trial, spec, rng: with_own(
        trial, stiffness=trial.parts.own.stiffness * uniform(rng, spec.stiff)
    ),
    # the hook's edge is worn off: it snaps, but does not hold, or slips by beside the lip, which is no pass
    "worn-hook": lambda trial, spec, rng: with_own(trial, overlap=uniform(rng, spec.worn)),
    # something lies on the seat
    "chip": lambda trial, spec, rng: with_own(trial, seat=uniform(rng, spec.chip)),
}
