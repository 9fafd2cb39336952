"""The kernel as a function of JAX."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import warp as wp

from rcbht_jax.types import Array
from sim_mjx.engines.fused.kernel import Sizes, period
from sim_mjx.engines.fused.prepare import Structure

STATE = ("new_qpos", "new_qvel", "new_qacc", "new_sensordata")  # outputs of the kernel
BLOCK = 32  # threads: a trial's registers leave room for few, and small batches spread over all multiprocessors


@lru_cache
def _call(size: Sizes) -> tuple[Any, tuple[str, ...]]:
    kernel = period(size)
    names = tuple(argument.label for argument in kernel.adj.args)
    return wp.jax_kernel(kernel, num_outputs=5, block_dim=BLOCK), names[: names.index("still")]


def advance(
    structure: Structure, numbers: dict[str, Array], substeps: int, body: tuple[Array, Array, Array, Array],
    before: Array, after: Array, still: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """One control period.

    Args:
        structure: of the scene. numbers: see ``prepare.numbers_of``.
        substeps: physics steps.
        body: qpos, qvel, qacc_warmstart, sensordata [trial, ...].
        before, after: controls at the beginning and the end [trial, actuator].
        still: trials that keep still [trial].

    Returns:
        the body after it, whose sensors are read in the last step, and each tip's place in its lip's frame before it
        [trial, tab, 3], m.
    """
    count, joints = body[0].shape
    numbered = structure.numbered
    tabs = len(numbered["tip_geom"])
    size = Sizes(len(numbered["body_parentid"]), joints, len(numbered["pair_geom"]), substeps)
    call, names = _call(size)
    given = numbered | numbers | {"numbers": structure.numbers}
    dims = dict(zip(STATE, (leaf.shape for leaf in body), strict=True))
    return call(
        *(given[name] for name in names), still.astype(jnp.int32), before, after, *body,
        launch_dims=count, output_dims=dims | {"places": (count, tabs, 3)},
    )  # fmt: skip
