"""The pure core computes in the precision of its state or signal, whatever the types of what it is given."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding import encoder, fit, provisional
from rcbht_jax.encoding.batch import encode_batch, encode_on_device
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.soft import soft_encode
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.types import padded
from tests.support.trees import assert_trees_equal

WRENCH = np.random.default_rng(0).normal(size=(2, 60, 2)).cumsum(1).astype(np.float32)
LENGTH = np.array([60, 43], np.int32)
LIMITS = np.array(rj.preset("hiro", ("Fz", "My")).limits)
FIT_LIMITS = FitLimits(LIMITS, np.full(2, 0.5))
EMPTY = {"paper": encoder.init((2,)), "fit": fit.init(FitConfig(), (2,))}


@partial(jax.jit, static_argnums=0)
def steps(rule: str, windows: Any, counts: Any) -> Any:
    """All labels of a stream, the last window of which may be a part; every window is a step of one scan."""
    config = rj.EncoderConfig() if rule == "paper" else FitConfig()
    core, limits = (encoder, LIMITS) if rule == "paper" else (fit, FIT_LIMITS.stacked())
    state, labels = jax.lax.scan(
        lambda state, row: core.step_partial(config, limits, state, *row), EMPTY[rule], (windows, counts)
    )
    rest = windows[-1], counts[-1] * 0 + 3
    looks = [core.flush(config, limits, state, *rest)]
    looks += [provisional.labels(config, limits, state, *rest)] if rule == "fit" else []
    return state, labels, looks


@pytest.mark.parametrize("rule", EMPTY)
@pytest.mark.parametrize("dtype", [np.float64, jnp.bfloat16])
def test_a_stream_keeps_the_precision_of_its_state(rule: str, dtype: Any) -> None:
    windows = WRENCH[0].reshape(12, 5, 2).astype(dtype)
    counts = np.repeat([[5]] * 11 + [[4]], 2, 1)
    expected = steps(rule, jnp.asarray(windows.astype(np.float32)), jnp.asarray(counts, jnp.int32))
    with jax.enable_x64(True):
        assert_trees_equal(steps(rule, jnp.asarray(windows), jnp.asarray(counts, jnp.int64)), expected)


SOFT = jax.jit(soft_encode, static_argnums=0)


@pytest.mark.parametrize("dtype", [np.float16, jnp.bfloat16])
def test_half_precision_is_encoded_in_single(dtype: Any) -> None:
    given = 900 * jnp.asarray(WRENCH, dtype)  # whose sums half precision does not hold
    for run in (jax.jit(encoder.encode, static_argnums=0), encode_on_device, partial(SOFT, temperature=0.3)):
        results = [run(rj.EncoderConfig(), LIMITS, wrench, LENGTH) for wrench in (given, given.astype(jnp.float32))]
        assert_trees_equal(*results)


@pytest.mark.parametrize("config", [rj.EncoderConfig(), FitConfig()], ids=["paper", "fit"])
def test_a_temperature_in_double_precision_changes_nothing(config: Any) -> None:
    limits = FIT_LIMITS if isinstance(config, FitConfig) else LIMITS
    with jax.default_device(jax.devices("cpu")[0]):  # a GPU adds in another order when 64 bits are allowed
        plain = SOFT(config, limits, WRENCH, LENGTH, 0.3)
        with jax.enable_x64(True):
            assert_trees_equal(SOFT(config, limits, WRENCH, LENGTH, jnp.asarray(0.3, jnp.float64)), plain)


def test_arrays_in_double_precision_need_no_warning_without_it() -> None:
    double, config = WRENCH.astype(np.float64), rj.EncoderConfig()
    for run in (
        lambda wrench: encoder.step(config, LIMITS, EMPTY["paper"], wrench[0, :5]),
        lambda wrench: fit.step(FitConfig(), FIT_LIMITS.stacked(), EMPTY["fit"], wrench[0, :5]),
        lambda wrench: encode_batch(config, LIMITS, wrench, LENGTH),
    ):
        assert_trees_equal(run(double), run(WRENCH))


@pytest.mark.parametrize("dtype", [np.float16, np.float64, np.longdouble])
def test_encoders_of_another_precision_are_refused(dtype: Any) -> None:
    with pytest.raises(InputError, match="float32, or float64 in JAX's 64-bit mode"):
        rj.Encoder(rj.EncoderConfig(), LIMITS, dtype)


@pytest.mark.parametrize("config", [rj.EncoderConfig(), FitConfig()], ids=["paper", "fit"])
def test_a_stream_in_double_precision_waits_for_the_64_bit_mode(config: Any) -> None:
    limits = FIT_LIMITS if isinstance(config, FitConfig) else LIMITS
    with jax.enable_x64(True):
        stream, other = (rj.Encoder(config, limits, np.float64) for _ in range(2))
        stream.push(WRENCH[0, :13])
    for call in (lambda: stream.push(WRENCH[0, 13:]), stream.peek, stream.ending, stream.flush, stream.restart):
        with pytest.raises(InputError, match="needs JAX's 64-bit mode"):
            call()
    with jax.enable_x64(True):  # nothing was consumed
        other.push(WRENCH[0, :13])
        assert_trees_equal(stream.push(WRENCH[0, 13:]), other.push(WRENCH[0, 13:]))
        assert_trees_equal(stream.flush(), other.flush())


def test_a_precision_may_be_a_text() -> None:
    single, named = (rj.Encoder(rj.EncoderConfig(), LIMITS, dtype) for dtype in (np.float32, "float32"))
    assert_trees_equal(named.push(WRENCH[0]), single.push(WRENCH[0]))
    with pytest.raises(InputError, match="A stream of single was asked for"):
        rj.Encoder(rj.EncoderConfig(), LIMITS, "single")


def test_data_sets_of_another_precision_are_refused() -> None:
    with pytest.raises(InputError, match="expected float32 or float64"):
        encode_batch(rj.EncoderConfig(), LIMITS, WRENCH.astype(np.float16), LENGTH)


@partial(jax.jit, static_argnums=0)
def behaviours(rule: str, state: Any, window: Any) -> Any:
    """Those of one window and of three samples more, at the end of a stream."""
    config = rj.EncoderConfig() if rule == "paper" else FitConfig()
    core, limits = (encoder, LIMITS) if rule == "paper" else (fit, FIT_LIMITS.stacked())
    return core.flush(config, limits, core.step(config, limits, state, window)[0], window, jnp.full(2, 3)).llb


@pytest.mark.parametrize("rule", EMPTY)
def test_a_state_in_double_precision_takes_samples_in_double_precision(rule: str) -> None:
    with jax.enable_x64(True):
        state = encoder.init((2,), np.float64) if rule == "paper" else fit.init(FitConfig(), (2,), np.float64)
        words = behaviours(rule, state, jnp.full((5, 2), 1 / 3, np.float64))
        values = np.asarray(words.avg)[np.asarray(words.label) > 0]
    assert len(values) == 2
    np.testing.assert_allclose(values, 1 / 3, rtol=1e-14)


def test_the_order_of_recordings_does_not_choose_their_precision() -> None:
    single, double = np.zeros((9, 1), np.float32), np.full((9, 1), 1 / 3)
    for parts in ([single, double], [double, single]):
        wrench, _ = padded(parts)
        assert wrench.dtype == np.float64
        assert (wrench == 1 / 3).any()
