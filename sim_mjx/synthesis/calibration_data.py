"""Simulated trials as calibration data, which stays on the device."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from rcbht_jax.calibration.dataset import CalibrationData, device_calibration_data
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly import task
from sim_mjx.assembly.task import STATES
from sim_mjx.engines import device
from sim_mjx.synthesis.records import MOST_WRENCH


def states_corpus(out: device.Outcome, config: EncoderConfig) -> CalibrationData:
    """The completed trials with an interval for each of their four states, on the device.

    A completed trial went through all states, seated all its tabs and did not diverge.

    Args:
        out: of :func:`sim_mjx.engines.device.run`, of one arm.
        config: of the encoder.

    Raises:
        InputError: there is none.
    """
    edges, y, usable = _states(out)
    return _corpus(config, out.wrench, edges, y, usable, STATES)


def whole_corpus(
    out: device.Outcome, y: Int[np.ndarray, " trial"], classes: tuple[str, ...], config: EncoderConfig
) -> CalibrationData:
    """The trials that did not seat all tabs and did not diverge, one interval each, on the device.

    Args:
        out: of :func:`sim_mjx.engines.device.run`.
        y: index into ``classes``; -1 leaves a trial out.
        classes: their names.
        config: of the encoder.

    Raises:
        InputError: there is none.
    """
    edges, y_true, usable = _whole(out, jax.device_put(y.astype(np.int32)))
    return _corpus(config, out.wrench, edges, y_true, usable, classes)


def _corpus(
    config: EncoderConfig, wrench: Array, edges: Array, y: Array, usable: Array, classes: tuple[str, ...]
) -> CalibrationData:
    order, count = _first(usable)
    usable_count = int(jax.device_get(count))
    if not usable_count:
        raise InputError(f"None of the {len(wrench)} simulated trials is usable; simulate more, to calibrate on.")
    wrench, edges, y = _rows(usable_count, order, (wrench, edges, y))
    return device_calibration_data(config, wrench, edges, y, classes)


@jax.jit
def _states(out: device.Outcome) -> tuple[Array, Array, Array]:
    """Edges ``[trial, 5]``, samples; classes ``[trial, 4]``; which trials were completed."""
    # a phase is logged one period after the measurement that began it
    begun = [(out.phase < phase).sum(1, dtype=jnp.int32) - 1 for phase in (task.ROTATION, task.INSERTION, task.MATING)]
    edges = jnp.stack([jnp.zeros_like(out.length), *begun, out.length], axis=1)
    entered = (out.phase == task.MATING).any(1)  # a trial that ran out of time is logged as if it had passed all
    y = jnp.broadcast_to(jnp.arange(len(STATES), dtype=jnp.int32)[None], (len(out.phase), len(STATES)))
    return edges, y, _sane(out) & entered & out.seated.all(1) & (jnp.diff(edges, axis=1) > 0).all(1)


@jax.jit
def _whole(out: device.Outcome, y: Array) -> tuple[Array, Array, Array]:
    edges = jnp.stack([jnp.zeros_like(out.length), out.length], axis=1)
    return edges, y[:, None], _sane(out) & ~out.seated.all(1) & (y >= 0)


def _sane(out: device.Outcome) -> Array:
    inside = jnp.arange(out.wrench.shape[1], dtype=jnp.int32)[None] < out.length[:, None]
    return ((jnp.abs(out.wrench) <= MOST_WRENCH).all(2) | ~inside).all(1)  # false for NaN


@jax.jit
def _first(usable: Array) -> tuple[Array, Array]:
    """The trials, usable ones first, and how many they are."""
    return jnp.argsort(~usable, stable=True), usable.sum(dtype=jnp.int32)


@partial(jax.jit, static_argnums=0)
def _rows(count: int, order: Array, leaves: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(leaf[order[:count]] for leaf in leaves)
