"""A bench for snap hooks: a hand presses tabs past their lips and pulls them out; forces are compared with theory.

The hand moves at constant speed and does not give way; the lips stand still. The bench uses C MuJoCo: agreement of the
other engines with it is tested elsewhere (:mod:`sim_mjx.validation.engine_parity`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from sim_mjx.assembly.hook import Hook, add_lip, add_tab, first_touch

SPEED = 2e-3  # m/s, of the hand; the recorded assemblies press as slowly
CLEARANCE = 0.5e-3  # m, above the first touch and beyond the last
MASS, SERVO = 10.0, (2e5, 2e3)  # kg, and N/m, Ns/m: a hand that gives way by micrometres and is not shaken
SPACING = 0.04  # m, between the tabs of a part


@dataclass(frozen=True)
class Curve:
    """A press or a pull."""

    travel: Float64[np.ndarray, " time"]  # m, of the hand in the direction of insertion, 0 = first touch
    force: Float64[np.ndarray, " time"]  # N, on the hand against the insertion; negative = it is pulled in, or held
    deflection: Float64[np.ndarray, "time tab"]  # m, of each tab away from its lip

    @property
    def peak(self) -> float:
        """N, the largest force against a press, or the largest that holds against a pull."""
        pressed = self.travel[-1] > self.travel[0]
        return float(self.force.max() if pressed else -self.force.min())


def press_and_pull(
    hooks: Sequence[Hook], lower: Sequence[float] | None = None, step: float = 1.25e-3
) -> tuple[Curve, Curve]:
    """Press a part with these tabs down past its lips, and pull it out again.

    Args:
        hooks: one or more, in a row.
        lower: m, how much later each tab touches than the first ones; None = all at once.
        step: s, of the physics. With 2.5 ms a tab that flies back chatters, and peaks are wrong by up to 60 %.

    Returns:
        the press and the pull, with a value for every step.

    Raises:
        InputError: there is no hook, or ``lower`` is not as long.

    Example:
        >>> hook = Hook(8540.0, 0.8e-3, np.radians(30), np.radians(60), friction=0.2)
        >>> pressed, pulled = press_and_pull([hook])
        >>> round(pressed.peak), round(pulled.peak)
        (6, 15)
    """
    if not hooks or (lower is not None and len(lower) != len(hooks)):
        raise InputError(f"hooks has {len(hooks)} elements; expected at least one, and in lower as many or None.")
    model, depth = _rig(hooks, lower or [0.0] * len(hooks), step)
    data = mujoco.MjData(model)
    steps = round(depth / SPEED / step)
    down = np.linspace(0.0, depth, steps + 1)
    pressed = _moved(model, data, down)
    return pressed, _moved(model, data, down[::-1])


def _rig(hooks: Sequence[Hook], lower: Sequence[float], step: float) -> tuple[mujoco.MjModel, float]:
    """The bench's model, and how far its hand goes down, m."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = step, (0.0, 0.0, 0.0)
    spec.option.cone, spec.option.integrator = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    hand = spec.worldbody.add_body(name="HAND")
    hand.mass, hand.inertia, hand.explicitinertial = MASS, (0.01, 0.01, 0.01), True
    hand.add_joint(name="HAND", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0.0, 0.0, -1.0))
    servo = spec.add_actuator(name="HAND", target="HAND", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = SERVO[0], -SERVO[0], -SERVO[1]
    deepest = 0.0
    for index, (hook, later) in enumerate(zip(hooks, lower, strict=True)):
        beside = index * SPACING
        add_tab(hand, str(index), hook, np.array([hook.overlap - hook.tip_radius, beside, 0.0]))
        edge = -first_touch(hook) - CLEARANCE - later
        add_lip(spec, spec.worldbody, str(index), hook, np.array([0.0, beside, edge]))
        below = hook.tip_radius + (max(hook.overlap, 0.0) + hook.tip_radius) / np.tan(hook.retention_angle)
        deepest = max(deepest, -edge + below + CLEARANCE)
    return spec.compile(), deepest


def _moved(model: mujoco.MjModel, data: mujoco.MjData, wanted: Float64[np.ndarray, " time"]) -> Curve:
    travel, force = np.empty(len(wanted)), np.empty(len(wanted))
    deflection = np.empty((len(wanted), model.nq - 1))
    for index, place in enumerate(wanted):
        data.ctrl[0] = place
        mujoco.mj_step(model, data)
        travel[index], deflection[index] = data.qpos[0] - CLEARANCE, data.qpos[1:]
        force[index] = data.qfrc_actuator[0] - MASS * data.qacc[0]
    return Curve(travel, force, deflection)
