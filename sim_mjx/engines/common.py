"""Steps that all engines share before and after the physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Bool, Float, Float32, Int

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import ONE_ARM, Program, Rollouts

SETTLING = 200  # physics steps before time zero, in which the tool's weight bends the servos
P = ParamSpec("P")
R = TypeVar("R")

BLOCK = 16  # trials
LARGEST = 1e5  # N or Nm; beyond it the physics has diverged


def single(function: Callable[P, R]) -> Callable[P, R]:
    """The function in single precision, also where the program around it has set ``jax_enable_x64``.

    >>> with jax.enable_x64(True):
    ...     single(jnp.zeros)(3).dtype.name, jnp.zeros(3).dtype.name
    ('float32', 'float64')
    """

    @wraps(function)
    def inside(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(False):
            return function(*args, **kwargs)

    return inside


def forward_only(values: Any) -> Any:
    """A pytree as it is; derivatives go through it forwards, and backwards it raises a sentence.

    >>> float(jax.jvp(forward_only, (2.0,), (1.0,))[1])
    1.0

    Raises:
        InputError: it is differentiated in reverse mode.
    """
    leaves, tree = jax.tree.flatten(values)
    floats = [number for number, leaf in enumerate(leaves) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)]
    for number, leaf in zip(floats, _forward_only([leaves[number] for number in floats]), strict=True):
        leaves[number] = leaf
    return jax.tree.unflatten(tree, leaves)


@jax.custom_jvp
def _forward_only(leaves: list[Any]) -> list[Any]:
    return leaves


@_forward_only.defjvp
def _(primals: Any, tangents: Any) -> Any:
    return primals[0], [_forwards.bind(tangent) for tangent in tangents[0]]


def _refuse(*_: Any) -> Any:
    raise InputError(
        "The physics has no derivatives in reverse mode (jax.grad, jax.vjp, jax.jacrev); use forward mode: jax.jvp or "
        "jax.jacfwd."
    )


_forwards = Primitive("forwards")  # a tangent as it is
_forwards.def_impl(lambda tangent: tangent)
_forwards.def_abstract_eval(lambda tangent: tangent)
ad.deflinear2(_forwards, _refuse)
batching.defvectorized(_forwards)
mlir.register_lowering(_forwards, lambda _, tangent: [tangent])


@contextmanager
def unwarned() -> Iterator[None]:
    """Without MuJoCo's warnings of physics that diverges, which it prints and adds to a file in the working folder.

    Trials that diverge are marked. A handler of warnings that the program has set stays.

    >>> with unwarned():
    ...     mujoco.get_mju_user_warning() is None
    False
    """
    if mujoco.get_mju_user_warning() is not None:
        yield
        return
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def select_lanes(which: Bool[Array, " lane"], first: Any, second: Any) -> Any:
    """In each lane the leaves [lane, ...] of the first tree where ``which`` is true, else of the second."""
    return jax.tree.map(lambda a, b: jnp.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b), first, second)


def sane(values: Float[np.ndarray, "*batch reading"]) -> Bool[np.ndarray, "*batch"]:
    """Whether sensor readings or wrenches are finite and small enough for physics that has not diverged."""
    return (np.abs(values) < LARGEST).all(-1)  # false for NaN


def collect(
    wrench: Float32[np.ndarray, "trial time reading"],
    joints: Float32[np.ndarray, "trial time joint"],
    phases: Int[np.ndarray, "trial time"],
    past: Bool[np.ndarray, "trial time tab"],
    program: Program = ONE_ARM,
) -> Rollouts:
    """Cut the logs where the trials ended and mark those whose physics diverged.

    Args:
        wrench: N and Nm. joints: rad. phases: as logged.
        past: which tabs were past their lips, including the period after a trial's end, which decides ``seated``.
        program: that wrote the logs.
    """
    # a phase is logged one period after the measurement that began it
    at = phases[:, :, None] == np.arange(program.ended)
    entered = np.where(at.any(1), np.maximum(at.argmax(1) - 1, 0), -1)
    length = (phases < program.ended).sum(1).astype(np.int32)
    count, longest = len(length), int(length.max())
    kept = [np.zeros((count, longest, log.shape[2]), np.float32) for log in (wrench, joints)]
    diverged = np.zeros(count, np.bool_)
    for rows in blocks(count):
        logs = [log[rows, :longest] for log in (wrench, joints)]
        inside = np.arange(longest)[None] < length[rows, None]
        holds = sane(logs[0]) & np.isfinite(logs[1]).all(2)
        diverged[rows] = (~holds & inside).any(1)
        keep = (inside & ~diverged[rows, None])[..., None]
        for out, log in zip(kept, logs, strict=True):
            np.copyto(out[rows], log, where=keep)
    seated = past[np.arange(count), np.minimum(length, past.shape[1] - 1)] & ~diverged[:, None]
    inside = (np.arange(longest)[None] < length[:, None]) & ~diverged[:, None]
    within = past[:, :longest] & inside[..., None]
    return Rollouts(kept[0], kept[1], length, program.onsets(entered), seated, diverged, within)


def blocks(count: int) -> Iterator[slice]:
    """Slices of a few rows of a large array, so that temporaries stay in a core's cache."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))
