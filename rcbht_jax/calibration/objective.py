"""How well the labels of a set of thresholds tell sentences apart: fast scores for thousands of candidates.

All scores see the time per label only (:func:`rcbht_jax.calibration.label_durations.label_durations`), lie between 0 and 1
(``fit`` may be negative) and are larger where the thresholds are better.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

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
        accuracy: share of sentences that a ridge classifier says correctly when their trial is left out.
        fit: share of the variance of the classes that it explains then; smoother than the accuracy.
        fisher: between-class share of the variance of the label shares.
        information: mutual information of class and label share, over the entropy of the class.
        agreement: mean overlap of the label shares of two sentences of one class.
    """

    accuracy: float = 1.0
    fit: float = 0.5
    fisher: float = 0.0
    information: float = 0.0
    agreement: float = 0.0

    @staticmethod
    def of(weights: Mapping[str, float]) -> Objective:
        """From names and weights.

        Raises:
            InputError: a name is not a score, or no weight is positive.
        """
        unknown = set(weights) - set(SCORES)
        if unknown or not any(weight > 0 for weight in weights.values()):
            raise InputError(
                f"the objective {dict(weights)} cannot be used; give positive weights to some of {', '.join(SCORES)}."
            )
        return Objective(**{name: weights.get(name, 0.0) for name in SCORES})

    def weights(self) -> NDArray[np.float64]:
        """In the order of SCORES."""
        return np.array([getattr(self, name) for name in SCORES])


def shares(times: Array) -> Array:
    """Share of each label in its layer: ``[..., sentence, 6, 25]`` samples -> float32 ``[..., sentence, 150]``."""
    parts = []
    for start, end in itertools.pairwise(itertools.accumulate(LAYER_SIZES, initial=0)):
        layer = times[..., start:end].astype(jnp.float32)
        parts.append(layer / jnp.maximum(layer.sum(-1, keepdims=True), 1))
    return jnp.concatenate(parts, -1).reshape(*times.shape[:-2], -1)


@partial(jax.jit, static_argnames=("classes",))
def score_block(times: Array, y: Array, *, classes: int) -> Array:
    """All scores of a few candidates.

    Args:
        times: int32 ``[candidate, recording, sentence, 6, 25]``.
        y: int32 ``[recording, sentence]``, class.
        classes: number of classes.

    Returns:
        float32 ``[candidate, score]`` in the order of SCORES.
    """
    target = jax.nn.one_hot(y.reshape(-1), classes)

    def one(candidate: Array) -> Array:
        x = shares(candidate.reshape(-1, *candidate.shape[2:]))
        accuracy, fit = ridge_leave_one_out(jnp.sqrt(x), target, y.shape[1])
        return jnp.stack([accuracy, fit, _fisher(x, target), _information(x, target), _agreement(x, target)])

    with jax.default_matmul_precision("highest"):  # a GPU would round the factors to ten bits
        return jax.vmap(one)(times)


def scores(times: Array, y: Array, classes: int) -> NDArray[np.float32]:
    """:func:`score_block` for any number of candidates; a candidate's scores do not depend on the others."""
    truth = jax.device_put(y)
    made = [score_block(block, truth, classes=classes) for block in _blocks(times)]
    return np.concatenate(jax.device_get(made))[: len(times)]


@jax.jit
def _blocks(times: Array) -> list[Array]:
    """The candidates in blocks of one size, the last one filled up."""
    count = times.shape[0]
    padded = jnp.concatenate([times, jnp.repeat(times[-1:], -count % _BLOCK, axis=0)])
    return [padded[start : start + _BLOCK] for start in range(0, count, _BLOCK)]


def ridge_leave_one_out(x: Array, target: Array, per_trial: int) -> tuple[Array, Array]:
    """Accuracy and explained variance of ridge regression on the classes, each trial left out in turn.

    The residuals of a left-out block are (I - H)^-1 times those of the full fit, H the block of the hat matrix,
    so one factorisation serves all trials. Smooth in ``x [sentence, feature]``, except for the accuracy.
    """
    items = x.shape[0]
    x = jnp.concatenate([x - x.mean(0)[None], jnp.ones((items, 1))], 1)
    gram = x.T @ x + RIDGE * items * jnp.diag(jnp.ones(x.shape[1]).at[-1].set(1e-3))
    z = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(gram), x.T, lower=True)
    residual = (target - z.T @ (z @ target)).reshape(-1, per_trial, target.shape[1])
    blocks = z.reshape(z.shape[0], -1, per_trial)
    hat = jnp.einsum("fts,ftr->tsr", blocks, blocks)
    error = jnp.linalg.solve(jnp.eye(per_trial)[None] - hat, residual).reshape(target.shape)
    said = jnp.argmax(target - error, -1)
    accuracy = jnp.mean(said == jnp.argmax(target, -1), dtype=jnp.float32)
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
