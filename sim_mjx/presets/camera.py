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
    tab_stiffness=np.full(4, 10240.0),
    tab_damping=np.full(4, 64.0),  # critical, with the armature of a tab
    hook_overlap=np.array([0.000833, 0.000833, 0.0007513, 0.0007513]),
    hook_wear=np.zeros(4),
    tab_cut=np.zeros(4),
    shank_play=np.array(0.0001),
    slot_play=np.array(0.001358),
    seat_depth=np.array(0.0028),
    foot_spread=np.array(0.0109),
    foot_offset=np.array([-0.007915, -0.006705]),
    rear_rise=np.array([-0.0015, -0.0003738]),
    foot_contact=np.array([0.02452, 0.9175, 0.96, 0.0002741]),
    friction=np.array(0.308),  # plastic on plastic: 0.2 to 0.4
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
