"""The kernel for GPUs, without one: its arithmetic in Pallas's interpreter, and that it compiles for CUDA."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.encoding import batch, encoder, gpu
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.types import LabelTracks
from tests.encoding.test_encoder import wrench_of
from tests.support.trees import assert_trees_equal

SAMPLES = 163
LIMITS = jnp.asarray(preset().limits, jnp.float32)
LENGTH = jnp.asarray([SAMPLES, SAMPLES - 2, 100, 1, 0], jnp.int32)
CONFIGS = {
    "default": EncoderConfig(),
    "long window": EncoderConfig(window=70, latency_cap=0.1, contact_first=True, adj_exempt=False, gate=False),
}


def recordings() -> jax.Array:
    styles = ("steps", "ramps", "noise", "steps", "ramps")
    return jnp.asarray(np.stack([wrench_of(seed, style, SAMPLES) for seed, style in enumerate(styles)]), jnp.float32)


def by_kernel(config: EncoderConfig, wrench: jax.Array) -> LabelTracks:
    trials, _, axes = wrench.shape
    limits = jnp.tile(LIMITS.T, (1, trials))
    tracks = gpu.encode(config, limits, wrench, LENGTH, block=16, interpret=True)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf.reshape(-1, trials, axes), 0, -1), tracks)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=list(CONFIGS))
def test_the_kernel_gives_the_labels_of_the_scan(config: EncoderConfig) -> None:
    wrench = recordings()
    expected = jax.jit(encoder.encode, static_argnums=0)(config, LIMITS, wrench, LENGTH)
    assert all((np.asarray(track.label) != 0).sum() > 0 for track in (expected.primitive, expected.mc, expected.llb))
    assert_trees_equal(by_kernel(config, wrench), expected)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=list(CONFIGS))
def test_packed_labels_are_those_of_the_compact_form(config: EncoderConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    wrench = recordings()
    expected = batch.encode_on_device(config, LIMITS, wrench, LENGTH)
    monkeypatch.setattr(batch, "_by_kernels", lambda *_: True)
    monkeypatch.setattr(gpu, "encode_packed", partial(gpu.encode_packed, block=16, interpret=True))
    batch._packed.clear_cache()
    assert_trees_equal(batch.encode_on_device(config, LIMITS, wrench, LENGTH), expected)
    batch._packed.clear_cache()  # it holds programs of the interpreter


def for_cuda(function: jax.stages.Wrapped, *args: Any) -> str:
    """The program of a jitted function for a GPU, which JAX 0.12 wants named where there is none."""
    device = jax.sharding.AbstractDevice("NVIDIA H100", num_cores=None, platform="gpu")
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((1,), ("x",), abstract_device=device)):
        return function.trace(*args).lower(lowering_platforms=("cuda",)).as_text()


def test_packed_labels_compile_for_cuda() -> None:
    assert "triton" in for_cuda(batch._packed, EncoderConfig(), jnp.tile(LIMITS, (5, 1, 1)), recordings(), LENGTH)


def test_what_gpu_users_call_compiles_for_cuda_and_has_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    config, wrench = EncoderConfig(), recordings()

    def push(wrench: jax.Array) -> jax.Array:
        return encoder.encode(config, LIMITS, wrench, LENGTH).llb.avg.sum()

    slope = jax.jvp(push, (wrench,), (wrench,))
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    encode = jax.jit(partial(encoder.encode, config))
    assert "triton" in for_cuda(encode, LIMITS, wrench, LENGTH)
    np.testing.assert_array_equal(jax.jvp(push, (wrench,), (wrench,)), slope)  # here, on a CPU: the scan
    assert np.abs(slope).min() > 0


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_gpu_in_64_bit_mode_runs_the_kernel_in_single_precision_alone(monkeypatch: Any, dtype: Any) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with jax.enable_x64(True):
        encode = jax.jit(partial(encoder.encode, EncoderConfig()))
        program = for_cuda(encode, LIMITS, recordings().astype(dtype), LENGTH.astype(jnp.int64))
    assert ("triton" in program) == (dtype == jnp.float32)


def test_what_the_kernel_cannot_do_is_left_to_the_scan() -> None:
    assert gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((8, 100, 6), jnp.float32))
    assert not gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((8, 100, 6), jnp.float64))
    assert not gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((4_000_000, 100, 6), jnp.float32))
    assert not gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((12_000_000, 5, 6), jnp.float32))  # what lanes hold
    assert gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((32_768, 2000, 6), jnp.float32), packed=True)
    assert not gpu.fits(EncoderConfig(), jax.ShapeDtypeStruct((131_072, 2000, 6), jnp.float32), packed=True)


def test_a_batch_keeps_within_the_memory() -> None:
    config, samples = EncoderConfig(window=5), 2000
    wrench = np.zeros((1, samples, 6), np.float32)
    size = batch._batch_within(2**30, config, wrench)
    assert size % batch.ROWS == 0
    assert size * samples // 5 * 6 * batch.BY_SCAN <= 2**30 < (size + batch.ROWS) * samples // 5 * 6 * batch.BY_SCAN
    assert batch._batch_within(1, config, wrench) == batch.ROWS
