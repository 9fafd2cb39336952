"""A plug with two guide pins and a latch: touch, spiral search, insertion until the latch snaps, pull.

Each pin touches with two spheres, its round end and its shaft; the socket has a front and a back wall, a middle one
between the pins, one beyond each, and a floor. The hook stands in front of the pins.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from sim_mjx.assemblies import latch
from sim_mjx.assemblies.assembly import Assembly, Phase, Range
from sim_mjx.assemblies.draw import COMMON_FAULTS
from sim_mjx.assemblies.fields import MALE, FieldWriter, ball, box, touch
from sim_mjx.assemblies.pressing import APPROACH, PULL, REST, SEARCH, PressTask, at_bottom, draw_task, press
from sim_mjx.assembly.hook import first_touch
from sim_mjx.assembly.parts import placed

PIN, APART, SHAFT = 2.5e-3, 10e-3, 8e-3  # m: radius, from the middle to a pin's axis, shaft's sphere above the end
LEAD = 7e-3  # m, of the pins into the socket when the hook meets its lip
BEHIND = 9e-3  # m, from the middle to the lip's edge
DEPTH = LEAD + latch.TRAVEL  # m, of the floor below the mouth
WALL = 10e-3  # m, half the thickness of the outer walls
PINS = (("L", 1.0), ("R", -1.0))
MIDDLE = APART - PIN  # m, half the breadth of the middle wall without clearance
HEIGHT = -DEPTH / 2
# name: place without clearance, half sizes, direction in which clearance moves it
WALLS = {
    "FRONT": ((PIN + WALL / 4, 0.0, HEIGHT), (WALL / 4, 0.03, DEPTH / 2), (1.0, 0.0, 0.0)),
    "BACK": ((-PIN - WALL, 0.0, HEIGHT), (WALL, 0.03, DEPTH / 2), (-1.0, 0.0, 0.0)),
    "LEFT": ((0.0, APART + PIN + WALL, HEIGHT), (WALL, WALL, DEPTH / 2), (0.0, 1.0, 0.0)),
    "RIGHT": ((0.0, -APART - PIN - WALL, HEIGHT), (WALL, WALL, DEPTH / 2), (0.0, -1.0, 0.0)),
    "MIDDLE_L": ((0.0, MIDDLE / 2, HEIGHT), (WALL, MIDDLE / 2, DEPTH / 2), (0.0, -1.0, 0.0)),
    "MIDDLE_R": ((0.0, -MIDDLE / 2, HEIGHT), (WALL, MIDDLE / 2, DEPTH / 2), (0.0, 1.0, 0.0)),
}


@dataclass(frozen=True)
class PlugVariation(latch.LatchVariation):
    """What varies between trials; see :class:`Variation`."""

    shift: Range = (-2.5e-3, 2.5e-3)  # m, error of the mouth's assumed place; chosen: needs a search
    clearance: Range = (0.15e-3, 0.25e-3)  # m, between pins and walls on each side; chosen
    moved_by: Range = (12e-3, 20e-3)  # m, fault moved-part: beyond any search, and beside the other pin's hole; chosen


def _male(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for name, side in PINS:
        ball(body, f"PIN_{name}", (0.0, side * APART, PIN), PIN)
        ball(body, f"SHAFT_{name}", (0.0, side * APART, SHAFT), PIN)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0.0, side * APART, PIN, 0.0, side * APART, 0.014),
                      size=(PIN, 0.0, 0.0), mass=0.0, contype=0, conaffinity=0, group=2, rgba=MALE)  # fmt: skip
    body.add_geom(name="PLUG", type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.006, 0.015, 0.008), pos=(0.0, 0.0, 0.022),
                  mass=0.04, contype=0, conaffinity=0, group=2, rgba=MALE)  # fmt: skip
    latch.add_hook(spec, body, BEHIND, LEAD + first_touch(latch.HOOK))


def _female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for name, (place, half, _) in WALLS.items():
        box(body, f"WALL_{name}", place, half)
    box(body, "FLOOR", (0.0, 0.0, -DEPTH - 0.002), (0.02, 0.03, 0.002))
    for pin, wall in (("L", "LEFT"), ("R", "RIGHT")):
        for kind in ("PIN", "SHAFT"):
            for name in ("FRONT", "BACK", wall, f"MIDDLE_{pin}"):
                touch(spec, f"{kind}_{pin}", f"WALL_{name}")
        touch(spec, f"PIN_{pin}", "FLOOR")
    latch.add_catch(spec, body, BEHIND, 0.0)


def _write(writer: FieldWriter, own: latch.LatchParts) -> None:
    latch.write(writer, own)
    clearance = np.asarray(own.clearance)[..., None]
    for name, (place, _, outward) in WALLS.items():
        writer.place(f"WALL_{name}", np.array(place) + clearance * np.array(outward))
    writer.place("FLOOR", placed(0.0, 0.0, np.asarray(own.seat, float) - (DEPTH + 0.002)))


def _draw(spec: PlugVariation, rng: np.random.Generator) -> tuple[PressTask, latch.LatchParts]:
    task = draw_task(spec, rng, press=25.0, bottom=2e-3 - DEPTH, gain=3e-4, moment_gain=0.1, drop=1.4e-3)
    return task, latch.draw(spec, rng)


PLUG = Assembly(
    "plug", _male, _female, _write, (APPROACH, SEARCH, Phase("insertion", press, at_bottom), PULL, REST), _draw,
    (latch.MARKS,), latch.is_caught, {**COMMON_FAULTS, **latch.FAULTS}, PlugVariation, timeout=14.0, reach=0.11,
    start=0.015, tabs=(latch.NAME,),
)  # fmt: skip
