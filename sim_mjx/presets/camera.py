"""The recorded sessions with one set of the camera's parts, whose hooks catch.

The same plastic parts were used in sessions A, B and C: what differs between sessions is where the female part stood
and how its stand yields. Angles and tip come from the drawing (:data:`sim_mjx.assembly.hooked_parts.HOOK`), the rest
was identified from A and one half of B's grid (``python -m experiments.simulation.joint_fit``). Then the depth of the
seat, the play of the slots, overlap and impedance of the rear hooks, friction, and the place of B's part from left to
right were set by hand on the same half (``docs/snap_fit.md``). C was not fitted: its part stands where the preset of
session C has it, relative to B's.
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
    tab_stiffness=np.full(4, 10.28e3),
    tab_damping=np.full(4, 64.0),  # critical, with the armature of a tab
    hook_overlap=np.array([0.703e-3, 0.703e-3, 1e-3, 1e-3]),
    hook_wear=np.zeros(4),
    tab_cut=np.zeros(4),
    stop_play=np.array(0.248e-3),
    foot_reach=np.array(0.526e-3),
    lip_impedance=np.array([0.964, 0.964, 0.988, 0.988]),
    slot_play=np.array(1e-3),
    seat_depth=np.array(3.55e-3),
    foot_spread=np.array(10.18e-3),
    foot_offset=np.array([-1.819e-3, -4.293e-3]),
    rear_rise=np.array([-1.115e-3, -0.2224e-3]),
    foot_contact=np.array([0.01366, 0.8737, 0.96, 0.5971e-3]),
    friction=np.array(0.25),  # plastic on plastic: 0.2 to 0.4
    mount_stiffness=np.array([3833.0, 3394.0, 6581.0]),
    mount_damping=np.array([181.3, 81.25, 154.1]),
    position=np.array([-3.227e-3, -1.6e-3, 1.224e-3]),
    roll=np.array(0.03253),
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
    mount_stiffness=np.array([2267.0, 2258.0, 7209.0]),
    mount_damping=np.array([21.64, 178.7, 49.11]),
    position=np.array([-2.043e-3, 1.709e-3, 1.841e-3]),
    roll=np.array(0.02494),
)
_FROM_B_TO_C = SESSION_C.parts.position - SESSION_B.parts.position
HOOKED_A = hooked(SESSION_A, _STAND_OF_A)
HOOKED_B = hooked(SESSION_B, CAMERA)
HOOKED_C = hooked(SESSION_C, replace(CAMERA, position=CAMERA.position + _FROM_B_TO_C))
