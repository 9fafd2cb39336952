"""The wrist sensor as the robot logs it: delay, bias, noise, quantisation, tare, low-pass filter, world frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.types import Array
from sim_mjx.assembly.controllers import Rotation, Wrench

LONGEST_DELAY = 12  # control periods that the buffers can hold
LOADED = 1.0  # N, above the first reading: the hand touches something


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorParams:
    """One trial's sensor.

    The filter is x' = a x + b u, y = c x + d u. The recorded one has a DC gain of 1.1338, because its authors
    took d = b; ``d`` = 0.0730 would be right.
    """

    a: Float[Array, "*batch"]
    b: Float[Array, "*batch"]
    c: Float[Array, "*batch"]
    d: Float[Array, "*batch"]
    delay: Int[Array, "*batch"]  # control periods between contact and reading
    noise: Float[Array, "*batch 6"]  # standard deviation before the filter, N and Nm
    step: Float[Array, "*batch 6"]  # quantisation, N and Nm
    bias: Float[Array, "*batch 6"]  # drift since the tare, N and Nm, world frame, after the filter
    tared: Float[Array, "*batch"]  # 1 = the weight at the start is subtracted
    reference: Float[Array, "*batch 3"]  # m, wrist frame, the point that moments refer to
    offset: Float[Array, "*batch 6"] | None = None  # N and Nm, wrist frame, read without a load; None = nothing
    # N and Nm, wrist frame: a factor of the covariance of what a solver adds to the wrench of a contact from one period
    # to the next; None = nothing
    jitter: Float[Array, "*batch 6 6"] | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SensorState:
    """Memory of the chain; ``delay`` is ``LONGEST_DELAY``."""

    filtered: Float[Array, "*batch 6"]  # filter state
    buffer: Float[Array, "*batch delay 6"]  # readings, newest first
    tare: Float[Array, "*batch 6"]  # first reading


def required(field: str, values: Any) -> str:
    """What a field of :class:`SensorParams` must be where it is not, in words; "" = it is, or may be anything.

    Args:
        field: its name.
        values: of one trial.

    >>> required("delay", 40), required("delay", 11), required("noise", 0.0)
    ('0 to 11 control periods', '', '')
    """
    found = np.asarray(values)
    if field == "step" and not (found > 0).all():
        return "more than zero, since readings are rounded to its multiples"
    if field == "noise" and not (found >= 0).all():
        return "zero or more"
    if field == "delay" and not ((np.round(found) >= 0) & (np.round(found) < LONGEST_DELAY)).all():
        return f"0 to {LONGEST_DELAY - 1} control periods"  # others would be clipped silently
    return ""


def begin(params: SensorParams, first: Wrench) -> SensorState:
    """State after the first raw reading, wrist frame, about the wrist point."""
    first = _about_reference(params, first)
    return SensorState(jnp.zeros_like(first), jnp.broadcast_to(first, (LONGEST_DELAY, 6)), first)


def read(
    params: SensorParams, state: SensorState, raw: Wrench, noise: Float[Array, " 6"], rotation: Rotation
) -> tuple[SensorState, Wrench]:
    """One control period.

    Args:
        params: one trial's sensor.
        state: before.
        raw: force and moment of the part on the hand, N and Nm, wrist frame, about the wrist point.
        noise: standard normal numbers.
        rotation: of the wrist, columns are its axes in the world.

    Returns:
        the new state and the logged wrench, N and Nm, world frame.
    """
    buffer = _remembered(params, state, raw)
    late = buffer[params.delay] - params.tared * state.tare + noise * params.noise
    if params.jitter is not None:
        loaded = jnp.linalg.norm(buffer[params.delay, :3] - state.tare[:3]) > LOADED
        late = late + jnp.where(loaded, params.jitter @ noise, 0.0)
    if params.offset is not None:
        late = late + params.offset
    return _filtered(params, state, buffer, jnp.round(late / params.step) * params.step, rotation)


def read_exactly(
    params: SensorParams, state: SensorState, raw: Wrench, rotation: Rotation
) -> tuple[SensorState, Wrench]:
    """As :func:`read` without noise, jitter and quantisation: a smooth function of the raw wrench."""
    buffer = _remembered(params, state, raw)
    return _filtered(params, state, buffer, buffer[params.delay] - params.tared * state.tare, rotation)


def _remembered(params: SensorParams, state: SensorState, raw: Wrench) -> Float[Array, "delay 6"]:
    """The buffer with a new reading."""
    return jnp.concatenate([_about_reference(params, raw)[None], state.buffer[:-1]])


def _about_reference(params: SensorParams, raw: Wrench) -> Wrench:
    return jnp.concatenate([raw[:3], raw[3:] - jnp.cross(params.reference, raw[:3])])


def _filtered(
    params: SensorParams, state: SensorState, buffer: Float[Array, "delay 6"], u: Wrench, rotation: Rotation
) -> tuple[SensorState, Wrench]:
    """The filter's new state, and what it gives in world axes."""
    y = params.c * state.filtered + params.d * u
    filtered = params.a * state.filtered + params.b * u
    logged = jnp.concatenate([rotation @ y[:3], rotation @ y[3:]]) + params.bias
    return SensorState(filtered, buffer, state.tare), logged
