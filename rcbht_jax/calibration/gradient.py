"""Thresholds by gradients: soft labels and a linear classifier trained together, temperature annealed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.objective import ridge_leave_one_out
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.soft import overlaps, soft_encode, soft_shares
from rcbht_jax.encoding.thresholds import GradientThresholds, from_free, to_free
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYER_SIZES
from rcbht_jax.types import Array

with needs_extra("learn"):
    import optax  # type: ignore[import-untyped]

_FEATURES = 6 * sum(LAYER_SIZES)
_FLOOR = 1e-4  # of a share under the root, whose slope at 0 is infinite
_GAIN = 4.0  # shares are small numbers; this gives the classifier's weights a handy scale


@dataclass(frozen=True)
class GradientOptions:
    """How to train."""

    steps: int = 150
    rate: float = 0.05  # of Adam, for the logarithms of the thresholds
    rate_weights: float = 0.05  # of Adam, for the classifier
    temperature: tuple[float, float] = (1.0, 0.1)  # first and last, geometric in between
    loss: Literal["logistic", "hinge", "fit"] = "logistic"  # fit: that of the search's objective, without a classifier
    decay: float = 1e-3  # penalty of the classifier's squared weights
    batch: int = 0  # trials per step, the next ones of a shuffled order; 0 = all
    straight_through: bool = False  # hard labels forward, gradients of the soft ones
    seed: int = 0  # of the classifier's first weights and of the order of the trials

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 0 or min(self.temperature) <= 0 or min(self.rate, self.rate_weights) <= 0:
            raise InputError("training needs steps, positive temperatures and positive rates.")
        if self.loss not in ("logistic", "hinge", "fit"):
            raise InputError(f"the loss {self.loss!r} is not known; expected logistic, hinge or fit.")


class Parameters(NamedTuple):
    """What is trained."""

    free: Array  # float32 [6, 4], see rcbht_jax.encoding.thresholds.from_free
    weights: Array  # float32 [150, class]
    bias: Array  # float32 [class]


class Batch(NamedTuple):
    """Trials on the device."""

    wrench: Array  # float32 [trial, time, 6]
    length: Array  # int32 [trial]
    weights: Array  # float32 [trial, sentence, window]
    y: Array  # int32 [trial, sentence]


@dataclass(frozen=True)
class TrainResult:
    """The end of a training."""

    thresholds: GradientThresholds  # [6, 4]
    parameters: Parameters
    history: list[tuple[float, float, float]]  # per step: seconds, training loss, held-out loss (NaN without)
    path: NDArray[np.float64]  # [step, 6, 4] thresholds after each step


def batch_of(corpus: CalibrationData, config: EncoderConfig) -> Batch:
    """A corpus as arrays for :func:`loss`."""
    windows = -(-corpus.wrench.shape[1] // config.window)
    weights = overlaps(jnp.asarray(corpus.edges), windows, config.window)
    return Batch(jnp.asarray(corpus.wrench), jnp.asarray(corpus.windows.length), weights, jnp.asarray(corpus.y))


def _orders(trials: int, options: GradientOptions) -> Iterator[NDArray[np.int64]]:
    """Rows of the trials of each step; every trial once before any comes again."""
    size = min(options.batch, trials)
    rng, left = np.random.default_rng(options.seed), np.zeros(0, np.int64)
    while True:
        if not options.batch:
            yield np.arange(trials)
            continue
        if len(left) < size:
            left = np.concatenate([left, rng.permutation(trials)])
        yield left[:size]
        left = left[size:]


def loss(
    config: EncoderConfig, options: GradientOptions, parameters: Parameters, batch: Batch, temperature: Array | float
) -> Array:
    """Mean loss of the linear classifier on soft label shares, without its penalty.

    With ``fit`` it is the share of the variance of the classes that a ridge classifier does not explain when each trial
    is left out in turn (:func:`rcbht_jax.calibration.objective.ridge_leave_one_out`).
    """
    limits = from_free(parameters.free).limits
    labels = soft_encode(
        config, limits, batch.wrench, batch.length, temperature, straight_through=options.straight_through
    )
    x = soft_shares(labels, batch.weights)
    if options.loss == "fit":
        flat = x.reshape(-1, x.shape[-1])
        target = jax.nn.one_hot(batch.y.reshape(-1), parameters.bias.shape[0])
        return 1 - ridge_leave_one_out(jnp.sqrt(flat + _FLOOR), target, batch.y.shape[1])[1]
    said = _GAIN * x @ parameters.weights + parameters.bias[None, None]
    if options.loss == "logistic":
        return optax.softmax_cross_entropy_with_integer_labels(said, batch.y).mean()
    # Crammer and Singer: the margin over the best wrong class.
    true = jax.nn.one_hot(batch.y, said.shape[-1], dtype=said.dtype)
    margin = jnp.sum(said * true, -1) - jnp.max(said - 1e9 * true, -1)
    return jnp.maximum(1 - margin, 0).mean()


def calibrate(
    corpus: CalibrationData,
    config: EncoderConfig,
    start: GradientThresholds,
    options: GradientOptions,
    *,
    held_out: CalibrationData | None = None,
    progress: Callable[[int], None] | None = None,
) -> TrainResult:
    """Train thresholds and classifier on a corpus, from ``start``.

    Args:
        corpus: training trials only.
        config: static configuration of the encoder.
        start: first thresholds ``[6, 4]``, strictly ordered.
        options: how to train.
        held_out: trials whose loss, at the temperature of the step, is recorded and nothing else.
        progress: called with the number of steps done since the last call.

    Raises:
        InputError: limits of the start coincide, or the loss is no longer finite.
    """
    free = np.asarray(to_free(start), np.float32)
    if not np.isfinite(free).all():
        raise InputError("training starts from strictly ordered thresholds; two of the given limits are equal.")
    parameters = _first(free, len(corpus.classes), options)
    # what a compiled step depends on: the rest may change without compiling it again
    fixed = replace(options, steps=1, temperature=(1.0, 1.0), batch=min(options.batch, 1), seed=0)
    state = _optimizer(fixed).init(parameters)
    batch = batch_of(corpus, config)
    other = None if held_out is None else batch_of(held_out, config)
    history: list[tuple[float, float, float]] = []
    path, began = [], time.perf_counter()
    temperatures = np.geomspace(*options.temperature, options.steps).astype(np.float32)
    for temperature, rows in zip(temperatures, _orders(len(corpus), options), strict=False):
        # copies are explicit: a transfer guard can show that nothing else leaves the device
        warmth, chosen = jax.device_put((temperature, rows.astype(np.int32)))
        outside = np.nan if other is None else float(jax.device_get(_loss(config, fixed, parameters, other, warmth)))
        parameters, state, inside = _step(config, fixed, parameters, state, batch, chosen, warmth)
        value, found = jax.device_get((inside, _limits(parameters.free)))
        history.append((time.perf_counter() - began, float(value), outside))
        path.append(found.astype(np.float64))
        if not np.isfinite(history[-1][1]):
            raise InputError("the training diverged: its loss is not finite; choose smaller rates.")
        if progress is not None:
            progress(1)
    return TrainResult(GradientThresholds(path[-1]), parameters, history, np.stack(path))


def _first(free: NDArray[np.float32], classes: int, options: GradientOptions) -> Parameters:
    weights = 0.01 * jax.random.normal(jax.random.key(options.seed), (_FEATURES, classes))
    return Parameters(jnp.asarray(free), weights, jnp.zeros(classes))


@jax.jit
def _limits(free: Array) -> Array:
    limits: Array = from_free(free).limits
    return limits


_loss = jax.jit(loss, static_argnums=(0, 1))


def _optimizer(options: GradientOptions) -> optax.GradientTransformation:
    return optax.multi_transform(
        {"limits": optax.adam(options.rate), "classifier": optax.adam(options.rate_weights)},
        Parameters("limits", "classifier", "classifier"),
    )


@partial(jax.jit, static_argnums=(0, 1))
def _step(
    config: EncoderConfig,
    options: GradientOptions,
    parameters: Parameters,
    state: Any,
    batch: Batch,
    rows: Array,
    temperature: Array,
) -> tuple[Parameters, Any, Array]:
    some = jax.tree.map(lambda leaf: leaf[rows], batch) if options.batch else batch

    def total(parameters: Parameters) -> tuple[Array, Array]:
        value = loss(config, options, parameters, some, temperature)
        return value + options.decay * jnp.sum(jnp.square(parameters.weights)), value

    gradients, value = jax.grad(total, has_aux=True)(parameters)
    with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
        updates, state = _optimizer(options).update(gradients, state, parameters)
        parameters = Parameters(*optax.apply_updates(parameters, updates))
    return parameters, state, value
