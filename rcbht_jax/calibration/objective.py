"""Scores of how well the labels of some thresholds separate the classes, fast enough for thousands of candidates.

All scores are functions of the time per label (:func:`rcbht_jax.calibration.label_durations.label_durations`). They lie
between 0 and 1 (``fit`` may be negative), and larger is better.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.compiling import full_precision
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYER_SIZES
from rcbht_jax.types import Array

SCORES = ("accuracy", "fit", "fisher", "information", "agreement")
RIDGE = 0.02  # penalty of the linear classifier, per sentence
_BINS = 4  # levels of a time share in the mutual information
_BLOCK = 64  # candidates scored at once: fixed, so that a score never depends on how many there are


@dataclass(frozen=True)
class Objective:
    """Weights of the scores; the objective is their weighted sum.

    Attributes:
        accuracy: leave-one-trial-out accuracy of a ridge classifier on the label shares.
        fit: leave-one-trial-out explained variance of the same classifier; smoother than the accuracy.
        fisher: between-class fraction of the variance of the label shares.
        information: mutual information of class and label share, divided by the entropy of the class.
        agreement: mean overlap of the label shares of sentences of one class.

    Example:
        >>> Objective().weights().tolist()
        [1.0, 0.5, 0.0, 0.0, 0.0]
    """

    accuracy: float = 1.0
    fit: float = 0.5
    fisher: float = 0.0
    information: float = 0.0
    agreement: float = 0.0

    @staticmethod
    def of(weights: Mapping[str, float]) -> Objective:
        """From weights by name; scores without a weight do not count.

        Raises:
            InputError: a name is not a score, or no weight is positive.
        """
        unknown = set(weights) - set(SCORES)
        if unknown or not any(weight > 0 for weight in weights.values()):
            raise InputError(
                f"The objective {dict(weights)} cannot be used; give positive weights to some of {', '.join(SCORES)}."
            )
        return Objective(**{name: weights.get(name, 0.0) for name in SCORES})

    def weights(self) -> NDArray[np.float64]:
        """In the order of SCORES."""
        return np.array([getattr(self, name) for name in SCORES])


def shares(times: Int[Array, "*sentences 6 25"]) -> Float[Array, "*sentences 150"]:
    """Share of the time of each label in its layer, from samples."""
    parts = []
    for start, end in itertools.pairwise(itertools.accumulate(LAYER_SIZES, initial=0)):
        layer = times[..., start:end].astype(jnp.float32)
        parts.append(layer / jnp.maximum(layer.sum(-1, keepdims=True), 1))
    return jnp.concatenate(parts, -1).reshape(*times.shape[:-2], -1)


@partial(jax.jit, static_argnames=("classes",))
def _block_scores(
    times: Int[Array, "candidate recording sentence 6 25"], y: Int[Array, "recording sentence"], *, classes: int
) -> Float[Array, "candidate score"]:
    """Scores of a few candidates."""
    target = jax.nn.one_hot(y.reshape(-1), classes)

    def one(candidate: Array) -> Array:
        x = shares(candidate.reshape(-1, *candidate.shape[2:]))
        accuracy, fit = ridge_leave_one_out(jnp.sqrt(x), target, y.shape[1])
        return jnp.stack([accuracy, fit, _fisher(x, target), _information(x, target), _agreement(x, target)])

    with full_precision():
        return jax.vmap(one)(times)


def scores(
    times: Int[Array, "candidate recording sentence 6 25"], y: Int[Array, "recording sentence"], classes: int
) -> Float[np.ndarray, "candidate score"]:
    """All scores, float32 in the order of SCORES; those of a candidate do not depend on the others.

    Args:
        times: int32, samples.
        y: int32, index of the class.
        classes: number of classes.
    """
    y_true = jax.device_put(y)
    blocks = [_block_scores(block, y_true, classes=classes) for block in _blocks(times)]
    return np.concatenate(jax.device_get(blocks))[: len(times)]


@jax.jit
def _blocks(times: Array) -> list[Array]:
    """The candidates in blocks of one size, the last one filled up."""
    count = times.shape[0]
    padded = jnp.concatenate([times, jnp.repeat(times[-1:], -count % _BLOCK, axis=0)])
    return [padded[start : start + _BLOCK] for start in range(0, count, _BLOCK)]


def ridge_leave_one_out(
    x: Float[Array, "sentence feature"], target: Float[Array, "sentence class"], per_trial: int
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Accuracy and explained variance of ridge regression on the classes, each trial left out in turn.

    The residuals of a held-out block are (I - H)^-1 times those of the full fit, where H is the block of the hat
    matrix, so one factorisation serves all trials. The explained variance is smooth in ``x``.

    Args:
        x: features; the sentences of a trial are consecutive.
        target: one-hot classes.
        per_trial: sentences per trial.
    """
    items = x.shape[0]
    x = jnp.concatenate([x - x.mean(0)[None], jnp.ones((items, 1))], 1)
    gram = x.T @ x + RIDGE * items * jnp.diag(jnp.ones(x.shape[1]).at[-1].set(1e-3))
    z = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(gram), x.T, lower=True)
    residual = (target - z.T @ (z @ target)).reshape(-1, per_trial, target.shape[1])
    blocks = z.reshape(z.shape[0], -1, per_trial)
    hat = jnp.einsum("fts,ftr->tsr", blocks, blocks)
    error = jnp.linalg.solve(jnp.eye(per_trial)[None] - hat, residual).reshape(target.shape)
    predicted = jnp.argmax(target - error, -1)
    accuracy = jnp.mean(predicted == jnp.argmax(target, -1), dtype=jnp.float32)
    spread = jnp.sum(jnp.square(target - target.mean(0)[None]))
    return accuracy, 1 - jnp.sum(jnp.square(error)) / spread


def _class_means(x: Array, target: Array) -> Array:
    return (target.T @ x) / jnp.maximum(target.sum(0), 1)[:, None]


def _fisher(x: Array, target: Array) -> Array:
    means = _class_means(x, target)
    between = jnp.sum(target.sum(0)[:, None] * jnp.square(means - x.mean(0)[None]))
    return between / jnp.maximum(jnp.sum(jnp.square(x - x.mean(0)[None])), 1e-12)


def _information(x: Array, target: Array) -> Array:
    """Mean over the labels of I(class; share in levels of 0, 1/3, 2/3, 1) / H(class)."""
    level = jax.nn.one_hot(jnp.round(x * (_BINS - 1)).astype(jnp.int32), _BINS)
    joint = jnp.einsum("ifb,ic->fbc", level, target) / x.shape[0]
    marginal = joint.sum(2, keepdims=True) * joint.sum(1, keepdims=True)
    mutual = jnp.sum(jnp.where(joint > 0, joint * jnp.log(joint / jnp.maximum(marginal, 1e-12)), 0), (1, 2))
    prior = target.mean(0)
    entropy = -jnp.sum(jnp.where(prior > 0, prior * jnp.log(jnp.maximum(prior, 1e-12)), 0))
    return mutual.mean() / jnp.maximum(entropy, 1e-12)


def _agreement(x: Array, target: Array) -> Array:
    """Mean overlap of sentences with the mean sentence of their class; 1 = all sentences of a class are alike."""
    means = target @ _class_means(x, target)
    return jnp.sum(jnp.minimum(x, means)) / jnp.maximum(jnp.sum(x), 1e-12)
