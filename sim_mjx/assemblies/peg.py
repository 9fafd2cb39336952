"""Peg in a hole, round or square: touch, spiral search, compliant insertion.

The round peg searches upright, the square one leaning in a direction that rotates, so that a corner enters first.
The peg touches with two rings of small spheres, its rounded lower edge and a guide above it; the hole has flat walls
and a floor. A round peg has six spheres per ring in a hole of six walls, a square one four in a hole of four.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from rcbht_jax.types import Array
from sim_mjx.assemblies.assembly import Assembly, AssemblyTrial, FaultOf, Phase, Range, Variation
from sim_mjx.assemblies.draw import COMMON_FAULTS, uniform, with_mount, with_own
from sim_mjx.assemblies.fields import MALE, FieldWriter, ball, box, mark, touch
from sim_mjx.assemblies.pressing import APPROACH, SEARCH, SEARCH_LEANING, PressTask, at_bottom, draw_task, press, rested
from sim_mjx.assembly.parts import placed

RADIUS, EDGE = 8e-3, 1.5e-3  # m, of the peg, and of its rounded edge
GUIDE = 13e-3  # m, of the upper ring above the tip
DEPTH, WALL = 16e-3, 20e-3  # m, of the hole; half the thickness and the breadth of its walls
HIGHEST = 1.5e-3  # m, of the tip above the floor when it is in


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PegParts:
    """Parameters of peg and hole."""

    clearance: Float[Array, "*batch"]  # m, between peg and hole on each side; negative = it does not fit
    floor: Float[Array, "*batch"]  # m, how much the floor is raised


@dataclass(frozen=True)
class PegVariation(Variation):
    """What varies between trials; see :class:`Variation`."""

    shift: Range = (-3.5e-3, 3.5e-3)  # m, error of the hole's assumed place, x and y; chosen: needs a search
    clearance: Range = (0.10e-3, 0.20e-3)  # m, on each side; chosen: a loose fit of 16 mm
    stop_at: Range = (0.5, 2.5)  # s, fault early-stop; chosen: before any peg is in
    tight: Range = (-0.4e-3, -0.2e-3)  # m, fault tight: the clearance of a peg that is too thick; chosen
    jam: Range = (1.0, 1.5)  # fault rough: friction that slows search and insertion; chosen
    askew: Range = (0.06, 0.12)  # rad, fault askew: lean of the peg in the hand, any direction; chosen
    blocked: Range = (5e-3, 10e-3)  # m, fault blocked: how much what lies in the hole raises its floor; chosen


def _ring(sides: int) -> list[tuple[float, float]]:
    """Where the spheres of a ring are, as shares of the distance from the axis to a wall."""
    if sides == 4:
        return [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
    angles = 2 * np.pi * np.arange(sides) / sides
    return [(float(np.cos(angle)), float(np.sin(angle))) for angle in angles]


def _walls(sides: int, index: int) -> list[int]:
    """Walls that a sphere of the ring may meet: those of its corner, or the one it faces and its neighbours."""
    if sides == 4:
        return [index, (index + 1) % 4]
    return [(index + step) % sides for step in (-1, 0, 1)]


def _male(sides: int, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for index, (x, y) in enumerate(_ring(sides)):
        out = RADIUS - EDGE
        ball(body, f"EDGE_{index}", (x * out, y * out, EDGE), EDGE)
        ball(body, f"GUIDE_{index}", (x * out, y * out, GUIDE), EDGE)
    kind = mujoco.mjtGeom.mjGEOM_BOX if sides == 4 else mujoco.mjtGeom.mjGEOM_CYLINDER
    size = (RADIUS, RADIUS, 0.02) if sides == 4 else (RADIUS, 0.02, 0.0)
    body.add_geom(name="PEG", type=kind, size=size, pos=(0.0, 0.0, 0.02 + EDGE), mass=0.05, contype=0,
                  conaffinity=0, group=2, rgba=MALE)  # fmt: skip
    mark(body, "PEG_TIP")


def _female(sides: int, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    far = RADIUS + WALL
    for wall in range(sides):
        angle = 2 * np.pi * wall / sides
        place = (far * np.cos(angle), far * np.sin(angle), -DEPTH / 2)
        box(body, f"WALL_{wall}", place, (WALL, WALL, DEPTH / 2), angle)
    box(body, "FLOOR", (0.0, 0.0, -DEPTH - 0.002), (0.03, 0.03, 0.002))
    mark(body, "HOLE")
    for index in range(sides):
        for wall in _walls(sides, index):
            touch(spec, f"EDGE_{index}", f"WALL_{wall}")
            if sides == 4 or wall == index:
                touch(spec, f"GUIDE_{index}", f"WALL_{wall}")
        touch(spec, f"EDGE_{index}", "FLOOR")


def _write(sides: int, writer: FieldWriter, own: PegParts) -> None:
    clearance = np.asarray(own.clearance)
    far = RADIUS + WALL + clearance
    for wall in range(sides):
        angle = 2 * np.pi * wall / sides
        writer.place(f"WALL_{wall}", placed(far * np.cos(angle), far * np.sin(angle), -DEPTH / 2))
    writer.place("FLOOR", placed(0.0, 0.0, own.floor - DEPTH - 0.002))


def _draw(lean: float, spec: PegVariation, rng: np.random.Generator) -> tuple[PressTask, PegParts]:
    task = draw_task(spec, rng, press=12.0, bottom=2 * HIGHEST - DEPTH, lean=lean)
    return task, PegParts(uniform(rng, spec.clearance), np.asarray(0.0))


def is_in(local: Float[Array, "*mark 3"]) -> Bool[Array, "*mark"]:
    """Whether the tip is in the hole and near its floor; ``local`` is its place from the middle of the mouth, m."""
    return (local[..., 2] < HIGHEST - DEPTH) & (abs(local[..., 0]) < 1e-3) & (abs(local[..., 1]) < 1e-3)


def _askew(trial: AssemblyTrial, spec: PegVariation, rng: np.random.Generator) -> AssemblyTrial:
    """The peg leans in the hand."""
    angle, lean = uniform(rng, (0.0, 2 * np.pi)), uniform(rng, spec.askew)
    grip = np.array([lean * np.cos(angle), lean * np.sin(angle), trial.parts.grip[2]])
    return replace(trial, parts=replace(trial.parts, grip=grip))


FAULTS: dict[str, FaultOf] = {
    **COMMON_FAULTS,
    # the peg is too thick for its hole
    "tight": lambda trial, spec, rng: with_own(trial, clearance=uniform(rng, spec.tight)),
    # peg and hole are rough: search and insertion take longer; a square peg may jam
    "rough": lambda trial, spec, rng: with_mount(trial, friction=uniform(rng, spec.jam)),
    "askew": _askew,
    # something lies in the hole
    "blocked": lambda trial, spec, rng: with_own(trial, floor=uniform(rng, spec.blocked)),
}


def peg(name: str, sides: int, search: Phase, lean: float = 0.0) -> Assembly:
    """A peg with six sides, in place of a round one, or with four.

    Args:
        name: of the assembly.
        sides: of peg and hole.
        search: how the hole is found. lean: rad, as of :class:`sim_mjx.assemblies.pressing.PressTask`.
    """
    phases = (APPROACH, search, Phase("insertion", press, at_bottom), Phase("rest", press, rested))
    return Assembly(
        name, partial(_male, sides), partial(_female, sides), partial(_write, sides), phases, partial(_draw, lean),
        (("PEG_TIP", "HOLE"),), is_in, FAULTS, PegVariation, timeout=14.0, reach=0.12, start=0.015,
    )  # fmt: skip


ROUND = peg("peg-in-hole", 6, SEARCH)
SQUARE = peg("square-peg", 4, SEARCH_LEANING, lean=0.03)
