"""The recorded sessions with one set of the camera's parts, whose hooks catch.

The same plastic parts were used in sessions A, B and C: what differs between sessions is where the female part stood
and how its stand yields. Angles and tip come from the drawing (:data:`sim_mjx.assembly.hooked_parts.HOOK`), the rest
was identified from A and one half of B's grid (``python -m experiments.simulation.joint_fit``). Then the heights of
rear lips, feet and seat, the rear overlap, the play of the stop and the stand of B were set by hand, so that the rear
hooks carry the whole push and the hand may fall when they let go (``docs/snap_fit.md``). C was not fitted: its part
stands where the preset of session C has it, relative to B's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.hooked_parts import HookedParams
from sim_mjx.presets.session import SessionPreset
from sim_mjx.presets.session_a import SESSION_A
from sim_mjx.presets.session_b import SESSION_B
from sim_mjx.presets.session_c import SESSION_C

CAMERA = HookedParams(
    tab_stiffness=np.full(4, 10.24e3),
    tab_damping=np.full(4, 64.0),  # critical, with the armature of a tab
    hook_overlap=np.array([0.833e-3, 0.833e-3, 1.02e-3, 1.02e-3]),
    hook_wear=np.zeros(4),
    tab_cut=np.zeros(4),
    stop_play=np.array(0.1e-3),
    foot_reach=np.array(0.0),
    lip_impedance=np.full(4, 0.97),
    slot_play=np.array(1.358e-3),
    seat_depth=np.array(3.85e-3),
    foot_spread=np.array(10.9e-3),
    foot_offset=np.array([-7.915e-3, -6.705e-3]),
    rear_rise=np.array([-1.4e-3, 0.0]),
    foot_contact=np.array([0.02452, 0.9175, 0.96, 0.2741e-3]),
    friction=np.array(0.308),  # plastic on plastic: 0.2 to 0.4
    mount_stiffness=np.array([4139.0, 3184.0, 6500.0]),
    mount_damping=np.array([127.2, 39.65, 200.0]),
    position=np.array([0.174e-3, -1.641e-3, 2.8e-3]),
    roll=np.array(0.01435),
)


def hooked(session: SessionPreset, parts: HookedParams) -> SessionPreset:
    """A session with hooks that catch, under a name of its own.

    Example:
        >>> hooked(SESSION_B, CAMERA).name
        'hooked-B'
    """
    return replace(session, name=f"hooked-{session.name}", parts=parts)


_STAND_OF_A = replace(
    CAMERA,
    mount_stiffness=np.array([3914.0, 5718.0, 6481.0]),
    mount_damping=np.array([19.31, 200.2, 55.8]),
    position=np.array([-1.123e-3, 2.345e-3, 1.42e-3]),
    roll=np.array(0.01158),
)
_FROM_B_TO_C = SESSION_C.parts.position - SESSION_B.parts.position
HOOKED_A = hooked(SESSION_A, _STAND_OF_A)
HOOKED_B = hooked(SESSION_B, CAMERA)
HOOKED_C = hooked(SESSION_C, replace(CAMERA, position=CAMERA.position + _FROM_B_TO_C))
