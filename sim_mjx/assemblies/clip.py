"""A clip with one hook: touch, press until it snaps, pull to see whether it holds.

Four rounded corners of the clip slide between four walls before its hook meets the lip; the corners end on a seat.
"""

from __future__ import annotations

import mujoco
import numpy as np

from sim_mjx.assemblies import latch
from sim_mjx.assemblies.assembly import Assembly, Phase
from sim_mjx.assemblies.draw import COMMON_FAULTS
from sim_mjx.assemblies.fields import MALE, FieldWriter, ball, box, touch
from sim_mjx.assemblies.pressing import APPROACH, PULL, REST, PressTask, at_bottom, draw_task, press
from sim_mjx.assembly.hook import first_touch
from sim_mjx.assembly.parts import placed

HALF = (5e-3, 8e-3)  # m, of the clip, along and across the direction in which its hook bends
CORNER = 1.5e-3  # m, radius
LEAD = 4e-3  # m, of the corners into the slot when the hook meets its lip
BEHIND = 8e-3  # m, from the clip's middle to the lip's edge
DEPTH = LEAD + latch.TRAVEL  # m, of the seat below the mouth
WALL = 10e-3  # m, half the thickness of the walls
CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
WALLS = (("FRONT", 0, 1.0), ("LEFT", 1, 1.0), ("BACK", 0, -1.0), ("RIGHT", 1, -1.0))


def _male(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for index, (x, y) in enumerate(CORNERS):
        ball(body, f"CORNER_{index}", (x * (HALF[0] - CORNER), y * (HALF[1] - CORNER), CORNER), CORNER)
    body.add_geom(name="BODY", type=mujoco.mjtGeom.mjGEOM_BOX, size=(*HALF, 0.01), pos=(0.0, 0.0, 0.01 + CORNER),
                  mass=0.03, contype=0, conaffinity=0, group=2, rgba=MALE)  # fmt: skip
    latch.add_hook(spec, body, BEHIND, first_touch(latch.HOOK))


def _female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for name, axis, side in WALLS:
        box(body, f"WALL_{name}", _wall(axis, side), (WALL, WALL, DEPTH / 2) if axis else (WALL, 0.02, DEPTH / 2))
    box(body, "SEAT", (0.0, 0.0, -DEPTH - 0.002), (0.02, 0.02, 0.002))
    for index, (x, y) in enumerate(CORNERS):
        for name, axis, side in WALLS:
            if side == (x, y)[axis]:
                touch(spec, f"CORNER_{index}", f"WALL_{name}")
        touch(spec, f"CORNER_{index}", "SEAT")
    latch.add_catch(spec, body, BEHIND, -LEAD)


def _wall(axis: int, side: float) -> tuple[float, float, float]:
    far = side * (HALF[axis] + WALL)
    return (far, 0.0, -DEPTH / 2) if axis == 0 else (0.0, far, -DEPTH / 2)


def _write(writer: FieldWriter, own: latch.LatchParts) -> None:
    latch.write(writer, own)
    clearance = np.asarray(own.clearance)[..., None]
    for name, axis, side in WALLS:
        writer.place(f"WALL_{name}", np.array(_wall(axis, side)) + side * clearance * np.eye(3)[axis])
    writer.place("SEAT", placed(0.0, 0.0, np.asarray(own.seat, float) - (DEPTH + 0.002)))


def _draw(spec: latch.LatchVariation, rng: np.random.Generator) -> tuple[PressTask, latch.LatchParts]:
    task = draw_task(spec, rng, press=25.0, bottom=2e-3 - DEPTH, gain=3e-4, moment_gain=0.1, touch_force=2.0)
    return task, latch.draw(spec, rng)


CLIP = Assembly(
    "clip", _male, _female, _write, (APPROACH, Phase("press", press, at_bottom), PULL, REST), _draw,
    (latch.MARKS,), latch.is_caught, {**COMMON_FAULTS, **latch.FAULTS}, latch.LatchVariation, timeout=8.0, reach=0.10,
    start=0.015, tabs=(latch.NAME,),
)  # fmt: skip
