"""What an action does: set-points of the force law, or increments of the references."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Float

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.env.config import EnvConfig

DAMPING = 0.05  # of the inverse of the Jacobian, m and rad: a nearly singular arm is slow, not wild


def action_size(config: EnvConfig, joints: int, wrists: int) -> int:
    """Size of an action.

    Args:
        config: its ``action`` decides.
        joints: of the robot.
        wrists: of the robot.

    >>> action_size(EnvConfig(action="joint"), 7, 1)
    7
    """
    return {"set-points": 6, "joint": joints, "cartesian": 6 * wrists}[config.action]


def with_set_points(params: Any, offset: Float[Array, "*batch 6"]) -> Any:
    """A trial's parameters with set-points of the force law shifted by the same offset in all phases.

    Args:
        params: of a trial or a batch, with a :class:`sim_mjx.assembly.task.TaskParams` as ``task``.
        offset: added to the set-points, N and Nm, in their frame.

    Raises:
        InputError: the scenario's controller has no force law.
    """
    task: Any = getattr(params, "task", None)
    if not (hasattr(task, "force") and hasattr(task, "moment")):
        raise InputError('This scenario has no force law; choose action="joint" or action="cartesian".')
    rows = jnp.broadcast_to(offset[..., None, :], (*offset.shape[:-1], task.force.shape[-2], 6))
    return replace(params, task=replace(task, force=task.force + rows[..., :3], moment=task.moment + rows[..., 3:]))


def joint_increments(
    config: EnvConfig, action: Float[Array, " action"], jacobian: Float[Array, "twist joint"]
) -> Float[Array, " joint"]:
    """Increments of the joint references in one control period, rad; equal in all periods of a step.

    Args:
        config: its ``action`` selects the kind of action.
        action: within -1 and 1.
        jacobian: of the wrists, velocity (m/rad) above angular velocity, world axes.
    """
    if config.action == "set-points":
        return jnp.zeros(jacobian.shape[1], action.dtype)
    if config.action == "joint":
        return action * (config.angle / config.periods)
    scale = jnp.array([config.shift] * 3 + [config.turn] * 3, action.dtype) / config.periods
    twist = (action.reshape(-1, 6) * scale[None]).ravel()
    square = jacobian @ jacobian.T + DAMPING**2 * jnp.eye(len(twist), dtype=action.dtype)
    return jacobian.T @ jnp.linalg.solve(square, twist)
