"""Quotients as IEEE 754 rounds them, from those of a device that does not."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax import Encoder, EncoderConfig, preset
from rcbht_jax._util.compiling import host_device
from rcbht_jax.encoding import division
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.types import Array

COUNT = 200_000
PLAIN = jax.lax.div


@pytest.fixture
def pairs() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x = rng.normal(size=COUNT) * 10 ** rng.uniform(-8, 8, COUNT)
    return x.astype(np.float32), (rng.normal(size=COUNT) * 10 ** rng.uniform(-4, 12, COUNT)).astype(np.float32)


def of_a_gpu(x: Array, y: Array) -> Array:
    """Two digits off, either way."""
    bits = jnp.int32 if x.dtype == jnp.float32 else jnp.int64
    wrong = jax.lax.bitcast_convert_type(PLAIN(x, y), bits)
    wrong = wrong + jax.lax.bitcast_convert_type(x, bits) % 5 - 2
    return jnp.where(x == 0, 0, jax.lax.bitcast_convert_type(wrong, x.dtype))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_wrong_digits_are_corrected(
    dtype: type, pairs: tuple[np.ndarray, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    with jax.enable_x64(dtype == np.float64):
        x, y = (each.astype(dtype) / 3 for each in pairs)
        assert (np.asarray(of_a_gpu(jnp.asarray(x), jnp.asarray(y))) != x / y).mean() > 0.5
        monkeypatch.setattr(jax.lax, "div", of_a_gpu)
        np.testing.assert_array_equal(jax.jit(lambda x, y: division.exact(x, y))(x, y), x / y)


def test_quotients_in_the_middle_between_two_numbers_are_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those nearest to a middle, which a second correction by division leaves wrong: (2 q + 1) y = 2 x +- 1."""
    monkeypatch.setattr(jax.lax, "div", of_a_gpu)
    y = np.random.default_rng(1).integers(2**23, 2**24, COUNT) | 1
    inverse = np.array([pow(int(value), -1, 2**25) for value in y])
    for side in (1, -1):
        middle = inverse * side % 2**25  # middle * y = side modulo 2**25: the quotient's 25 digits, if it has as many
        x = (middle * y - side) // 2**25
        use = (middle >= 2**24) & (x >= 2**23)
        assert use.sum() > COUNT / 10
        signs = np.random.default_rng(2).choice([-1, 1], (2, use.sum()))
        pair = (signs[0] * x[use]).astype(np.float32), (signs[1] * y[use]).astype(np.float32)
        np.testing.assert_array_equal(jax.jit(lambda x, y: division.corrected(x, y))(*pair), np.divide(*pair))


@pytest.mark.parametrize("value", [0.0, np.inf, -np.inf, np.nan, 3e38])
def test_values_that_cannot_be_corrected_stay(value: float) -> None:
    x, y = jnp.full(4, value, jnp.float32), jnp.asarray([1, 3, 1e-30, 1e30], jnp.float32)
    np.testing.assert_array_equal(division.corrected(x, y), PLAIN(x, y))


def test_a_quotient_is_the_same_program_on_a_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    ones = jnp.ones(3)
    plain = jax.jit(division.quotient).trace(ones, ones).lower(lowering_platforms=("cpu",)).as_text()
    assert "4.097" not in plain
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    other = jax.jit(lambda x, y: division.quotient(x, y))
    np.testing.assert_array_equal(other(ones, 3 * ones), np.float32(1) / np.float32(3))
    assert "4.097" in on_cuda(ones)
    with jax.enable_x64(True):
        assert "4.097" not in on_cuda(jnp.ones(3, jnp.float64))  # halves of 12 bits are those of single precision


def on_cuda(x: Array) -> str:
    return jax.jit(lambda x, y: division.quotient(x, y)).trace(x, x).lower(lowering_platforms=("cuda",)).as_text()


def test_a_fenced_product_is_rounded_before_it_is_added() -> None:
    """As by a compiler that contracts others, which the one of the tests does not."""
    x, y = np.random.default_rng(5).normal(size=(2, 1000)).astype(np.float32)
    options = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
    rest = jax.jit(lambda x, y, z: division.fenced(x * y) + z, compiler_options=options)(x, y, -(x * y))
    np.testing.assert_array_equal(rest, 0)


def test_derivatives_are_those_of_a_quotient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    x, y = jnp.asarray([2.0, -3.0, 5.0]), jnp.asarray([3.0, 7.0, 11.0])
    for function in (division.corrected, division.quotient):
        total = lambda x, y, f=function: f(x, y).sum()  # noqa: E731
        for found, expected in zip(jax.grad(total, (0, 1))(x, y), (1 / y, -x / (y * y)), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6)
        np.testing.assert_allclose(jax.vmap(jax.grad(function))(x, y), 1 / y, rtol=1e-6)


def test_streams_run_on_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where JAX has a GPU, whose launches would take longer."""
    wrench = np.cumsum(np.random.default_rng(0).normal(size=(300, 6)), 0)
    expected = encoder_of("paper").push(wrench), encoder_of("fit").push(wrench)
    processor = jax.devices("cpu")[0]
    put = jax.device_put
    asked: list[object] = []
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "device_put", lambda x, device=None: (asked.append(device), put(x, device))[1])
    for rule, before in zip(("paper", "fit"), expected, strict=True):
        encoder = encoder_of(rule)
        assert set(asked) == {processor}
        for leaf, other in zip(jax.tree.leaves(encoder.push(wrench)), jax.tree.leaves(before), strict=True):
            np.testing.assert_array_equal(leaf, other)
        encoder.flush()


def encoder_of(rule: str) -> Encoder:
    if rule == "paper":
        return Encoder(EncoderConfig(window=5, dt=0.005), preset("hiro"))
    return Encoder(FitConfig(), FitLimits(np.tile([[400.0, 60, 20, 4]], (6, 1)), np.full(6, 0.6)))


def test_without_a_processor_a_stream_runs_where_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(backend: str) -> list[jax.Device]:
        raise RuntimeError(f"Unknown backend {backend}")

    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert host_device() is None
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert host_device() == jax.devices("cpu")[0]
    monkeypatch.setattr(jax, "local_devices", none)
    assert host_device() is None
