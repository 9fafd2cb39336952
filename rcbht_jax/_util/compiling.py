"""``jax.jit`` for large programs: on a CPU, most compile in two thirds of the time without XLA's fusion emitters.

JAX takes options of the compiler only for programs that are no part of another one. So this is for functions that the
host calls, not for those that users may call under ``jax.jit``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, update_wrapper
from typing import Any

import jax
import jax.numpy as jnp

# JAX 0.10's default emitters also make batched kinematics a hundred times slower on a CPU.
_CPU_OPTIONS: dict[str, str | bool] = {"xla_cpu_use_fusion_emitters": False}


@cache
def compiler_options(backend: str) -> dict[str, str | bool]:
    """Options of ``jax.jit`` for programs of a backend; a version of JAX that does not know them gets none."""
    if backend != "cpu":
        return {}
    try:
        with jax.default_device(jax.devices("cpu")[0]):
            jax.jit(jnp.negative, compiler_options=_CPU_OPTIONS).lower(jnp.float32(0)).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return _CPU_OPTIONS


class Jitted:
    """A function that is compiled at its first call, not at import, for the backend that is the default then."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.on = cache(lambda backend: jax.jit(function, compiler_options=compiler_options(backend), **options))
        update_wrapper(self, function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """What ``jax.jit`` of the function returns."""
        return self.on(jax.default_backend())(*args, **kwargs)


def jit(**options: Any) -> Callable[[Callable[..., Any]], Jitted]:
    """A decorator like ``partial(jax.jit, **options)``.

    >>> @jit(static_argnums=0)
    ... def times(count, x):
    ...     return count * x
    >>> float(times(3, 2.0))
    6.0
    """
    return lambda function: Jitted(function, options)
