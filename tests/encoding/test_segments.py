"""Lines through windows at their edges: few samples, slopes on a limit, no slope at all."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.encoding.segments import as_floating, fit, gradient_label, soft_windows, whole_windows
from rcbht_jax.labels import Primitive

LIMITS = jnp.array([70.0, 46.0, 23.0, 1.0])
RISING = (Primitive.PIMP, Primitive.BPOS, Primitive.MPOS, Primitive.SPOS, Primitive.CONS)
FALLING = (Primitive.NIMP, Primitive.BNEG, Primitive.MNEG, Primitive.SNEG, Primitive.CONS)


def test_a_slope_on_a_limit_belongs_to_the_larger_side() -> None:
    below = jnp.nextafter(LIMITS, jnp.zeros(4))
    for sign, names in ((1, RISING), (-1, FALLING)):
        assert gradient_label(sign * LIMITS, LIMITS[:, None]).tolist() == list(names[:-1])
        assert gradient_label(sign * below, LIMITS[:, None]).tolist() == list(names[1:])
    assert int(gradient_label(jnp.float32(0), LIMITS)) == Primitive.CONS


@pytest.mark.parametrize("window", [5, 100])
def test_a_line_through_fewer_than_two_samples_is_none_and_has_derivatives(window: int) -> None:
    """Of a padded window of a recording, for example."""
    count, start = jnp.array([0, 1, 2], jnp.int32), jnp.zeros(3, jnp.int32)

    def ends(samples: jax.Array) -> tuple[jax.Array, jax.Array]:
        x = fit(samples, count, LIMITS[:, None], 0.005, start)
        return x.vmax.sum() + x.vmin.sum() + x.area.sum() + x.rise.sum(), x.label

    samples = jnp.asarray(np.random.default_rng(0).normal(size=(window, 3)), jnp.float32)
    slopes, label = jax.jit(jax.grad(ends, has_aux=True))(samples)
    assert (np.asarray(label) > 0).tolist() == [False, False, True]
    assert np.isfinite(slopes).all()


@pytest.mark.parametrize("samples", [0, 1, 4, 5, 6, 10])
def test_windows_hold_every_sample_once_and_no_window_is_empty(samples: int) -> None:
    count = np.array([0, 1, 4, 5, 6, samples], np.int32).clip(0, samples)
    padded, sizes = whole_windows(jnp.tile(jnp.arange(1.0, samples + 1)[:, None], 6), jnp.asarray(count), 5)
    assert len(padded) == 5 * len(sizes) == len(range(0, samples, 5)) * 5
    for lane, whole in enumerate(count.tolist()):
        assert sizes[:, lane].tolist() == [len(range(first, min(first + 5, whole))) for first in range(0, samples, 5)]
        np.testing.assert_array_equal(padded[:samples, lane], np.arange(1, samples + 1))
        assert not np.any(padded[samples:, lane])


@pytest.mark.parametrize(
    ("given", "made"), [(np.int32, np.float32), (np.float16, np.float32), (np.float64, np.float64)]
)
def test_a_signal_is_encoded_in_single_or_double_precision(given: Any, made: Any) -> None:
    with jax.enable_x64(True):
        assert as_floating(np.ones(3, given)).dtype == made


@pytest.mark.parametrize("temperature", [0.5, 1.0])
def test_a_soft_sign_turns_within_the_temperature_and_is_certain_at_the_small_limit(temperature: float) -> None:
    def up(slope: float) -> float:
        shares = np.asarray(soft_windows(jnp.float32(slope), LIMITS, temperature))
        return float(shares[2] / (shares[2] + shares[5]))

    assert up(1.0) > 1 - 1e-6
    assert up(-1.0) < 1e-6
    assert up(0.0) == pytest.approx(0.5)
    assert up(0.02 * temperature) == pytest.approx(1 / (1 + np.exp(-40 * 0.02 / 1.02)), rel=1e-4)


def test_no_slope_is_constant_at_any_temperature_and_has_derivatives() -> None:
    def constant(slope: jax.Array, limits: jax.Array) -> jax.Array:
        return soft_windows(slope, limits, 1.0)[6]

    value, slopes = jax.value_and_grad(constant, argnums=(0, 1))(jnp.float32(0), LIMITS)
    assert 1 - 2e-4 < float(value) < 1
    assert all(np.isfinite(leaf).all() for leaf in slopes)
