"""The recorded sessions with one set of the camera's parts, whose hooks catch.

The same plastic parts were used in sessions A, B and C: what differs between sessions is where the female part stood
and how its stand yields. Angles and tip come from the drawing (:data:`sim_mjx.assembly.hooked_parts.HOOK`), the rest
was identified from A and one half of B's grid (``python -m experiments.simulation.joint_fit``), twice, and partly set
by hand on the same half: the part lies halfway between the two results (``docs/snap_fit.md``). C was not fitted: its
part stands where the preset of session C has it, relative to B's.
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
    tab_stiffness=np.full(4, 10.23e3),
    tab_damping=np.full(4, 64.0),  # critical, with the armature of a tab
    hook_overlap=np.array([0.7197e-3, 0.7197e-3, 0.95e-3, 0.95e-3]),
    hook_wear=np.zeros(4),
    tab_cut=np.zeros(4),
    stop_play=np.array(0.2531e-3),
    foot_reach=np.array(1.33e-3),
    lip_impedance=np.array([0.9633, 0.9633, 0.9805, 0.9805]),
    slot_play=np.array(1.073e-3),
    seat_depth=np.array(3.763e-3),
    foot_spread=np.array(9.613e-3),
    foot_offset=np.array([-2.311e-3, -2.764e-3]),
    rear_rise=np.array([-1.303e-3, -0.2567e-3]),
    foot_contact=np.array([0.01216, 0.8851, 0.96, 0.6658e-3]),
    friction=np.array(0.2275),  # plastic on plastic: 0.2 to 0.4
    mount_stiffness=np.array([3833.0, 3394.0, 6581.0]),
    mount_damping=np.array([181.3, 81.25, 154.1]),
    position=np.array([-3.227e-3, -1.6e-3, 1.224e-3]),
    roll=np.array(0.03577),
    tilt=np.zeros(2),
)


IMPRATIO = 3.0  # of scenes with hooks: with 1 resting contacts creep, and hooks let go seconds too early


def hooked(session: SessionPreset, parts: HookedParams) -> SessionPreset:
    """A session with hooks that catch, under a name of its own.

    Example:
        >>> hooked(SESSION_B, CAMERA).name
        'hooked-B'
    """
    return replace(session, name=f"hooked-{session.name}", parts=parts, impratio=IMPRATIO)


_STAND_OF_A = replace(  # from "python -m experiments.simulation.joint_fit --stands --session hooked-A"
    CAMERA,
    mount_stiffness=np.array([2669.0, 2018.0, 7082.0]),
    mount_damping=np.array([23.5, 228.6, 48.91]),
    position=np.array([-1.616e-3, 1.295e-3, 1.543e-3]),
    roll=np.array(0.01461),
    tilt=np.array([-0.00291, -0.0124]),
)
_FROM_B_TO_C = SESSION_C.parts.position - SESSION_B.parts.position
HOOKED_A = hooked(SESSION_A, _STAND_OF_A)
HOOKED_B = hooked(SESSION_B, CAMERA)
HOOKED_C = hooked(SESSION_C, replace(CAMERA, position=CAMERA.position + _FROM_B_TO_C))
