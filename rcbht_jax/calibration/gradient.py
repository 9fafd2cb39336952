"""Gradient calibration: soft labels and a linear classifier are trained together while the temperature falls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.compiling import full_precision
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.objective import ridge_leave_one_out
from rcbht_jax.calibration.rest import RestSlopes
from rcbht_jax.calibration.rest_runs import RestRuns
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, gradients_of, limit_values
from rcbht_jax.encoding.soft import cell, overlaps, soft_encode, soft_shares
from rcbht_jax.encoding.thresholds import GradientThresholds, from_free, to_free
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYER_SIZES
from rcbht_jax.types import Array

with needs_extra("learn"):
    import optax  # type: ignore[import-untyped]

FIT_TEMPERATURE = (0.3, 0.03)  # first and last of the fit rule: hotter, noise breaks runs by chance

_FEATURES = 6 * sum(LAYER_SIZES)
_FLOOR = 1e-4  # added to a share under the root, whose slope at 0 is infinite
_GAIN = 4.0  # shares are small numbers; this scales them to weights of order one


@dataclass(frozen=True)
class GradientOptions:
    """Settings of the training."""

    steps: int = 150
    rate: float = 0.05  # learning rate of Adam, for the logarithms of the thresholds
    rate_weights: float = 0.05  # learning rate of Adam, for the classifier
    temperature: tuple[float, float] = (1.0, 0.1)  # first and last, geometric in between
    loss: Literal["logistic", "fit"] = "logistic"  # fit: score of the search, without a classifier
    decay: float = 1e-3  # penalty on the squared weights of the classifier
    batch: int = 0  # trials per step, in a shuffled order; 0 = all
    seed: int = 0  # of the initial weights and of the order of the trials

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 0 or min(self.temperature) <= 0 or min(self.rate, self.rate_weights) <= 0:
            raise InputError(
                f"Training has steps {self.steps}, batch {self.batch}, temperature {self.temperature}, rate "
                f"{self.rate} and rate_weights {self.rate_weights}; expected positive numbers, of batch also 0."
            )
        if self.loss not in ("logistic", "fit"):
            raise InputError(f"The loss {self.loss!r} is not known; expected logistic or fit.")


class Parameters(NamedTuple):
    """Trained parameters, float32."""

    free: Float[Array, "6 limit"]  # see rcbht_jax.encoding.thresholds.from_free; of the fit rule log tolerance last
    weights: Float[Array, "150 class"]
    bias: Float[Array, " class"]


class Batch(NamedTuple):
    """Trials on the device."""

    wrench: Float[Array, "trial time 6"]  # N and Nm
    length: Int[Array, " trial"]  # int32, samples
    weights: Float[Array, "trial sentence cell"]  # overlap of each sentence with each cell of soft labels, samples
    y: Int[Array, "trial sentence"]  # int32


@dataclass(frozen=True)
class TrainResult:
    """Trained thresholds and classifier, and how the training went."""

    thresholds: AnyLimits  # [6, 4]
    parameters: Parameters
    history: list[tuple[float, float, float]]  # per step: seconds, training loss, held-out loss (NaN without)
    path: Float[np.ndarray, "step 6 limit"]  # limits after each step, and tolerance of the fit rule; float64


def batch_of(data: CalibrationData, config: AnyConfig) -> Batch:
    """Calibration data as arrays for :func:`loss`."""
    size = cell(config)
    weights = overlaps(jnp.asarray(data.edges), -(-data.wrench.shape[1] // size), size)
    return Batch(jnp.asarray(data.wrench), jnp.asarray(data.windows.length), weights, jnp.asarray(data.y))


def _orders(trials: int, options: GradientOptions) -> Iterator[NDArray[np.int64]]:
    """Rows of the trials of each step; every trial is used once before any is used again."""
    rng, queue = np.random.default_rng(options.seed), np.zeros(0, np.int64)
    while True:
        if not options.batch:
            yield np.arange(trials)
            continue
        if len(queue) < options.batch:
            queue = np.concatenate([queue, rng.permutation(trials)])
        yield queue[: options.batch]
        queue = queue[options.batch :]


def loss(
    config: AnyConfig, options: GradientOptions, parameters: Parameters, batch: Batch, temperature: Array | float
) -> Float[Array, ""]:
    """Mean loss of the linear classifier on soft label shares, without its penalty.

    With ``fit`` it is the leave-one-trial-out unexplained variance of a ridge classifier
    (:func:`rcbht_jax.calibration.objective.ridge_leave_one_out`).
    """
    limits = limits_from(parameters.free)
    labels = soft_encode(config, limits, batch.wrench, batch.length, temperature)
    x = soft_shares(labels, batch.weights)
    if options.loss == "fit":
        flat = x.reshape(-1, x.shape[-1])
        target = jax.nn.one_hot(batch.y.reshape(-1), parameters.bias.shape[0], dtype=x.dtype)
        with full_precision():
            return 1 - ridge_leave_one_out(jnp.sqrt(flat + _FLOOR), target, batch.y.shape[1])[1]
    with full_precision():
        logits = _GAIN * x @ parameters.weights + parameters.bias[None, None]
    return optax.softmax_cross_entropy_with_integer_labels(logits, batch.y).mean()


def calibrate(
    data: CalibrationData,
    config: AnyConfig,
    start: AnyLimits,
    options: GradientOptions,
    *,
    held_out: CalibrationData | None = None,
    devices: Sequence[jax.Device] | None = None,
    progress: Callable[[int], None] | None = None,
    rest: RestSlopes | RestRuns | None = None,
) -> TrainResult:
    """Train thresholds and classifier, from ``start``.

    Args:
        data: training trials only.
        config: static configuration of the encoder.
        start: initial limits ``[6, 4]``, strictly ordered; by the fit rule FitLimits.
        options: settings of the training.
        held_out: trials whose loss at the temperature of each step is recorded; they are not used otherwise.
        devices: that share the trials of a step; sums over trials then differ in their last digits. None = the default.
        progress: called with the number of steps done since the last call.
        rest: its soft penalty is added to the loss where rest is not labelled constant.

    Raises:
        InputError: the initial thresholds are not strictly ordered, or the training diverges.
    """
    checked_limits(config, start)
    free = np.asarray(_free(start), np.float32)
    if (wrong := ~np.isfinite(free).all(1)).any():
        equal = np.asarray(gradients_of(start))[wrong][0].tolist()
        raise InputError(f"Training starts from strictly ordered thresholds; those of an axis are {equal}.")
    parameters = _first(free, len(data.classes), options)
    # static arguments of a compiled step: the other options may change without compiling it again
    fixed = replace(options, steps=1, temperature=(1.0, 1.0), batch=min(options.batch, 1), seed=0)
    state = _optimizer(fixed).init(parameters)
    batch = batch_of(data, config)
    other = None if held_out is None else batch_of(held_out, config)
    shared = None
    if devices:
        mesh = jax.sharding.Mesh(np.array(devices), ("trial",))
        shared = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("trial"))
        everywhere = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
        parameters, state, batch, other, rest = jax.device_put((parameters, state, batch, other, rest), everywhere)
    history: list[tuple[float, float, float]] = []
    path, began = [], time.perf_counter()
    temperatures = np.geomspace(*options.temperature, options.steps).astype(np.float32)
    for temperature, rows in zip(temperatures, _orders(len(data), options), strict=False):
        # copies are explicit, so that a transfer guard can show that nothing else leaves the device
        now, chosen = jax.device_put((temperature, rows.astype(np.int32)))
        outside = np.nan if other is None else float(jax.device_get(_loss(config, fixed, parameters, other, now)))
        parameters, state, inside = _step(config, fixed, shared, parameters, state, batch, chosen, now, rest)
        value, limits = jax.device_get((inside, _limits(parameters.free)))
        history.append((time.perf_counter() - began, float(value), outside))
        path.append(limits.astype(np.float64))
        if not np.isfinite(history[-1][1]):
            raise InputError("The training diverged: its loss is not finite; choose smaller rates.")
        if progress is not None:
            progress(1)
    last = path[-1]
    found = FitLimits(last[:, :4], last[:, 4]) if last.shape[1] == 5 else GradientThresholds(last)
    return TrainResult(found, parameters, history, np.stack(path))


def _first(free: NDArray[np.float32], classes: int, options: GradientOptions) -> Parameters:
    weights = 0.01 * jax.random.normal(jax.random.key(options.seed), (_FEATURES, classes), free.dtype)
    return Parameters(jnp.asarray(free), weights, jnp.zeros(classes, free.dtype))  # in 64-bit mode the same numbers


def limits_from(free: Float[Array, "6 limit"]) -> AnyLimits:
    """Limits from unconstrained numbers of each axis: four, or five of the fit rule."""
    limits = from_free(free[:, :4])
    return limits if free.shape[1] == 4 else FitLimits(limits.limits, jnp.exp(free[:, 4]))


def _free(limits: AnyLimits) -> Array:
    """Undo :func:`limits_from`."""
    gradients = to_free(GradientThresholds(gradients_of(limits)))
    if not isinstance(limits, FitLimits):
        return gradients
    tolerance = jnp.broadcast_to(jnp.asarray(limits.tolerance, gradients.dtype), gradients.shape[:1])
    return jnp.concatenate([gradients, jnp.log(tolerance)[:, None]], axis=1)


@jax.jit
def _limits(free: Array) -> Array:
    return limit_values(limits_from(free))


_loss = jax.jit(loss, static_argnums=(0, 1))


def _optimizer(options: GradientOptions) -> optax.GradientTransformation:
    return optax.multi_transform(
        {"limits": optax.adam(options.rate), "classifier": optax.adam(options.rate_weights)},
        Parameters("limits", "classifier", "classifier"),
    )


@partial(jax.jit, static_argnums=(0, 1, 2))
def _step(
    config: AnyConfig,
    options: GradientOptions,
    shared: jax.sharding.NamedSharding | None,
    parameters: Parameters,
    state: Any,
    batch: Batch,
    rows: Array,
    temperature: Array,
    rest: RestSlopes | RestRuns | None,
) -> tuple[Parameters, Any, Array]:
    some = jax.tree.map(lambda leaf: leaf[rows], batch) if options.batch else batch
    if shared is not None:
        some = jax.lax.with_sharding_constraint(some, shared)

    def total(parameters: Parameters) -> tuple[Array, Array]:
        value = loss(config, options, parameters, some, temperature)
        penalty = options.decay * jnp.sum(jnp.square(parameters.weights))
        if rest is not None:
            penalty = penalty + rest.soft_penalty(limits_from(parameters.free))
        return value + penalty, value

    gradients, value = jax.grad(total, has_aux=True)(parameters)
    with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
        updates, state = _optimizer(options).update(gradients, state, parameters)
        parameters = Parameters(*optax.apply_updates(parameters, updates))
    return parameters, state, value
