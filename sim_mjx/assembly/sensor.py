"""The wrist sensor as the robot logs it: delay, bias, noise, quantisation, tare, low-pass filter, world frame.

Source: design page "HIRO task", controller facts, point 4, and the data audit's noise figures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.errors import InputError

Array = Any
# m, wrist frame; M = r x F during session A's early rotation (R^2 of My .998) with r from the kinematic pivot
REFERENCE = (-0.0484, -0.0003, -0.001)
LONGEST_DELAY = 12  # control periods that the buffers can hold


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorParams:
    """One trial's sensor.

    The filter is x' = a x + b u, y = c x + d u. The recorded one has a DC gain of 1.1338, because its authors
    took d = b; ``d`` = 0.0730 would be right.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    delay: Array  # int32, control periods between contact and reading
    noise: Array  # [6] standard deviation before the filter, N and Nm
    step: Array  # [6] quantisation, N and Nm
    bias: Array  # [6] drift since the tare, N and Nm, world frame, after the filter
    tared: Array  # 1 = the weight at the start is subtracted
    reference: Array  # [3] m, wrist frame, the point that moments refer to


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorState:
    """Memory of the chain."""

    filtered: Array  # [6] filter state
    buffer: Array  # [LONGEST_DELAY, 6] readings, newest first
    tare: Array  # [6] first reading


# Per session: control periods of delay, m that moments refer to, N and Nm read in free space since the tare.
# Delays as the ringing after mating shows, points from the search that fitted the parts.
REAL: dict[str, tuple[int, tuple[float, float, float], tuple[float, ...]]] = {
    "A": (11, (-0.0463, 0.0014, -0.0019), (-0.023, -0.003, -0.023, -0.0006, 0.0008, -0.0001)),
    "B": (11, (-0.0491, -0.0007, -0.0014), (-0.314, -0.411, -0.059, -0.0198, 0.0061, -0.0021)),
    "C": (11, (-0.0491, -0.0007, -0.0014), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
}


def real_sensor(session: str = "A") -> SensorParams:
    """The JR3 chain of sessions A, B and C.

    Raises:
        InputError: unknown session.
    """
    if session not in REAL:
        raise InputError(f"There is no sensor of session {session!r}; expected one of {', '.join(REAL)}.")
    delay, reference, bias = REAL[session]
    return SensorParams(
        a=np.array(0.8541), b=np.array(0.2064), c=np.array(0.6555), d=np.array(0.2064),
        delay=np.array(delay, np.int32),
        noise=np.array([0.105, 0.077, 0.065, 0.0017, 0.0042, 0.0038]),
        step=np.array([0.024, 0.008, 0.008, 0.0008, 0.0008, 0.0008]),
        bias=np.array(bias), tared=np.array(1.0), reference=np.array(reference),
    )  # fmt: skip


def simulated_sensor() -> SensorParams:
    """The OpenHRP chain: 2.4 Hz, DC gain 1, hardly any noise."""
    return SensorParams(
        a=np.array(0.92681), b=np.array(0.073196), c=np.array(1.0), d=np.array(0.0), delay=np.array(1, np.int32),
        noise=np.full(6, 1e-5), step=np.full(6, 1e-6), bias=np.zeros(6), tared=np.array(0.0),
        reference=np.array(REFERENCE),
    )  # fmt: skip


def begin(params: SensorParams, first: Array) -> SensorState:
    """State after the first raw reading [6], wrist frame, about the wrist point."""
    first = jnp.concatenate([first[:3], first[3:] - jnp.cross(params.reference, first[:3])])
    return SensorState(jnp.zeros_like(first), jnp.broadcast_to(first, (LONGEST_DELAY, 6)), first)


def read(
    params: SensorParams, state: SensorState, raw: Array, noise: Array, rotation: Array
) -> tuple[SensorState, Array]:
    """One control period.

    Args:
        params: one trial's sensor.
        state: before.
        raw: force and moment of the part on the hand [6], N and Nm, wrist frame, about the wrist point.
        noise: standard normal numbers [6].
        rotation: of the wrist [3, 3], columns are its axes in the world.

    Returns:
        the new state and the logged wrench [6], N and Nm, world frame.
    """
    about = raw[3:] - jnp.cross(params.reference, raw[:3])
    buffer = jnp.concatenate([jnp.concatenate([raw[:3], about])[None], state.buffer[:-1]])
    late = buffer[params.delay] - params.tared * state.tare + noise * params.noise
    u = jnp.round(late / params.step) * params.step
    y = params.c * state.filtered + params.d * u
    filtered = params.a * state.filtered + params.b * u
    logged = jnp.concatenate([rotation @ y[:3], rotation @ y[3:]]) + params.bias
    return SensorState(filtered, buffer, state.tare), logged
