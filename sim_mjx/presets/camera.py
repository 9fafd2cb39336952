"""The camera's parts: one set of numbers for all sessions, because the same plastic parts were used in all of them.

Stiffness, angles, and tip come from the drawing (:data:`sim_mjx.assembly.parts.HOOK`); the rest was identified from
sessions A and B together (``python -m experiments.simulation.joint_fit``). What differs between sessions is where the
female part stood and how its stand yields.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.parts import PartParams

CAMERA = PartParams(
    tab_stiffness=np.full(4, 8.54e3),
    tab_damping=np.full(4, 58.0),  # critical, with the armature of a tab
    hook_overlap=np.full(4, 0.79e-3),
    hook_wear=np.zeros(4),
    tab_cut=np.zeros(4),
    shank_play=np.array(0.1e-3),
    slot_play=np.array(1.5e-3),
    seat_depth=np.array(2.6e-3),
    foot_spread=np.array(11e-3),
    foot_offset=np.array([-6e-3, -6e-3]),
    rear_rise=np.array([0.3e-3, -0.3e-3]),
    foot_contact=np.array([0.015, 0.9, 0.96, 0.3e-3]),
    friction=np.array(0.3),  # plastic on plastic: 0.2 to 0.4
    mount_stiffness=np.full(3, 5e3),
    mount_damping=np.full(3, 60.0),
    position=np.zeros(3),
    roll=np.array(0.0),
)
# What may differ between sessions.
PLACEMENT = ("mount_stiffness", "mount_damping", "position", "roll")


def on_stand(
    mount_stiffness: tuple[float, float, float],
    mount_damping: tuple[float, float, float],
    position: tuple[float, float, float],
    roll: float,
) -> PartParams:
    """The camera's parts on the stand of a session.

    Args:
        mount_stiffness: N/m, of the stand along x, y and z.
        mount_damping: Ns/m, likewise.
        position: m, shift of the female part from its nominal place, world.
        roll: rad, its turn about the vertical.

    Example:
        >>> float(on_stand((5e3, 5e3, 5e3), (60.0, 60.0, 60.0), (0.0, 0.0, 0.001), 0.01).position[2])
        0.001
    """
    values = (mount_stiffness, mount_damping, position, roll)
    return replace(CAMERA, **{name: np.array(value) for name, value in zip(PLACEMENT, values, strict=True)})
