"""Large programs that compile quickly on a CPU."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax._util import compiling


@pytest.fixture
def afresh() -> Iterator[None]:
    compiling.compiler_options.cache_clear()
    yield
    compiling.compiler_options.cache_clear()


def test_a_program_is_compiled_once_for_a_shape_and_a_static_argument() -> None:
    @compiling.jit(static_argnums=0)
    def powers(count: int, x: jax.Array) -> jax.Array:
        return jnp.stack([x**n for n in range(count)])

    x = np.linspace(0, 1, 5, dtype=np.float32)
    for _ in range(3):
        np.testing.assert_array_equal(powers(3, x), jax.jit(powers.__wrapped__, static_argnums=0)(3, x))
    assert powers.on("cpu")._cache_size() == 1
    powers(4, x)
    assert powers.on("cpu")._cache_size() == 2
    assert powers.__name__ == "powers"


def test_options_go_to_the_compiler_of_a_cpu_alone(afresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
    assert compiling.compiler_options("cpu", False) == known
    assert compiling.compiler_options("cpu", True) == (known and known | {"xla_backend_optimization_level": 0})
    assert compiling.compiler_options("cuda", True) == {}
    given = []
    monkeypatch.setattr(compiling.jax, "jit", lambda function, **options: given.append(options))
    compiling.jit(donate_argnums=1)(lambda x, y: x + y).on("cpu")
    assert given == [{"compiler_options": known, "donate_argnums": 1}]


def test_a_version_of_jax_without_the_option_gets_none(afresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "_CPU_OPTIONS", {"xla_cpu_no_such_option": False})
    assert compiling.compiler_options("cpu") == {}
    assert float(compiling.jit()(lambda x: x + 1)(np.float32(2))) == 3.0
