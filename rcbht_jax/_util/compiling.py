"""``jax.jit`` for large programs: on a CPU, most compile in two thirds of the time without XLA's fusion emitters.

JAX takes options of the compiler only for programs that are no part of another one. So this is for functions that the
host calls, not for those that users may call under ``jax.jit``.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache, update_wrapper
from typing import Any, cast

import jax
import jax.numpy as jnp

# JAX 0.10's default emitters also make batched kinematics a hundred times slower on a CPU.
_CPU_OPTIONS: dict[str, str | bool | int] = {"xla_cpu_use_fusion_emitters": False}
_QUICK = {"xla_backend_optimization_level": 0}


def full_precision() -> AbstractContextManager[None]:
    """Products of matrices that are traced in this context keep all digits: a GPU would round the factors to ten bits.

    >>> with full_precision():
    ...     x = jnp.ones((2, 2)) @ jnp.ones(2)
    """
    return cast("AbstractContextManager[None]", jax.default_matmul_precision("highest"))


@cache
def compiler_options(backend: str, quick: bool = False) -> dict[str, str | bool | int]:
    """Options of ``jax.jit`` for programs of a backend; a version of JAX that does not know them gets none.

    ``quick``: the program compiles in half of the time or less, and takes two or three times as long to run.
    """
    if backend != "cpu":
        return {}
    options = _CPU_OPTIONS | (_QUICK if quick else {})
    try:
        with jax.default_device(jax.devices("cpu")[0]):
            jax.jit(jnp.negative, compiler_options=options).lower(jnp.float32(0)).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def host_device() -> jax.Device | None:
    """The processor, for streams: the launches for one window take a GPU longer than the work takes a processor.

    None: JAX's default device is the processor, or JAX has only others (``JAX_PLATFORMS``).
    """
    if jax.default_backend() == "cpu":
        return None
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        return None


class Jitted:
    """A function that is compiled at its first call, not at import, for the backend that is the default then.

    Args:
        function: to compile.
        options: of ``jax.jit``.
        host: its arguments are on :func:`host_device`.
        quick: as in :func:`compiler_options`.
    """

    def __init__(
        self, function: Callable[..., Any], options: dict[str, Any], host: bool = False, quick: bool = False
    ) -> None:
        self.on = cache(lambda backend: jax.jit(function, compiler_options=compiler_options(backend, quick), **options))
        self._host = host
        update_wrapper(self, function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """What ``jax.jit`` of the function returns."""
        backend = "cpu" if self._host and host_device() is not None else jax.default_backend()
        return self.on(backend)(*args, **kwargs)


def jit(host: bool = False, quick: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Jitted]:
    """A decorator like ``partial(jax.jit, **options)``; ``host`` and ``quick`` as in :class:`Jitted`.

    >>> @jit(static_argnums=0)
    ... def times(count, x):
    ...     return count * x
    >>> float(times(3, 2.0))
    6.0
    """
    return lambda function: Jitted(function, options, host, quick)
