"""Class probabilities of one-versus-one support vector machines: Platt sigmoids and pairwise coupling.

A sigmoid per pair turns a decision value into the probability of the pair's first class; it is fitted on decision
values of held-out items (grouped cross-validation), by the Newton method of Lin, Lin and Weng, "A note on Platt's
probabilistic outputs for support vector machines" (2007). Pairs are joined by the second method of Wu, Lin and
Weng, "Probability estimates for multi-class classification by pairwise coupling" (2004), section 4.2: with
``r[i, j]`` the probability of i among {i, j}, minimise ``sum (r[j, i] p[i] - r[i, j] p[j])^2`` over all p that sum
to one. ``couple`` and ``couple_jax`` give that minimum itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.compiling import full_precision
from rcbht_jax.errors import InputError
from rcbht_jax.learning.class_groups import fewest_groups
from rcbht_jax.learning.scaling import SPREAD
from rcbht_jax.learning.svm import DEGREE, Ints, Matrix, SvmModel, SvmSpec, Weight, fit, grouped_folds, pairs
from rcbht_jax.types import Array

CERTAIN = 1e-7  # pair probabilities are kept this far from 0 and 1, as in libsvm
FOLDS = 5
STEP = np.float32(1e30)  # slope of a ramp that is a step
_STEPS = 100  # of Newton's method, at most
_SHORTEST = 1e-10  # step of the line search
_RIDGE = 1e-12  # keeps the Hessian invertible
_FLAT = 1e-5  # gradient at which the fit is done


@dataclass(frozen=True)
class ProbabilisticSvm:
    """A one-versus-one SVM with one sigmoid per pair; NumPy, double precision."""

    svm: SvmModel
    sigmoid: NDArray[np.float64]  # [pair, 2] slope a and offset b: P(first class) = 1 / (1 + exp(a f + b))

    def probability(self, x: Matrix) -> NDArray[np.float64]:
        """Class probabilities ``[item, class]`` of features ``[item, feature]``."""
        return couple(pair_probability(self.svm.decision(x), self.sigmoid), len(self.svm.classes))


def fit_probabilistic(
    x: Matrix,
    y: Ints,
    groups: NDArray[Any],
    classes: Sequence[str],
    spec: SvmSpec,
    seed: int = 0,
    folds: int | Any = FOLDS,
    weight: Weight = None,
    sample_weight: Weight = None,
) -> ProbabilisticSvm:
    """Train the SVM on all items and its sigmoids on held-out decision values.

    Args:
        x: features ``[item, feature]``.
        y: class index ``[item]``.
        groups: trial ``[item]``; items of one trial are never on both sides of a fold.
        classes: names.
        spec: hyper-parameters.
        seed: of the folds.
        folds: how many, fewer where a class has fewer trials; or a scikit-learn splitter that tests every item once.
        weight: positive ``[feature]`` by which scaled features are multiplied; None = ones.
        sample_weight: positive ``[item]``, how often each counts; None = once.

    Raises:
        InputError: as of :func:`held_out_decisions`, or a feature is not finite.
    """
    held_out = held_out_decisions(x, y, groups, classes, spec, seed, folds, weight, sample_weight)
    sigmoids = fit_sigmoids(held_out, y, len(classes), sample_weight)
    return ProbabilisticSvm(fit(x, y, classes, spec, weight, sample_weight), sigmoids)


def held_out_decisions(
    x: Matrix,
    y: Ints,
    groups: NDArray[Any],
    classes: Sequence[str],
    spec: SvmSpec,
    seed: int = 0,
    folds: int | Any = FOLDS,
    weight: Weight = None,
    sample_weight: Weight = None,
) -> NDArray[np.float64]:
    """Decision values ``[item, pair]``, each by an SVM that was trained without the item's trial.

    Args:
        x, y, groups, classes, spec, seed, folds, weight, sample_weight: as of :func:`fit_probabilistic`.

    Raises:
        InputError: a class has fewer than two trials, a fold holds them all, or the splitter does not test every item
            once.
    """
    number = min(folds, fewest_groups(y, groups)) if isinstance(folds, int | np.integer) else folds
    splits = grouped_folds(y, groups, number, seed)
    if not np.array_equal(np.sort(np.concatenate([test for _, test in splits])), np.arange(len(y))):
        raise InputError(f"{folds} does not test every item exactly once, which held-out decision values need.")
    out = np.empty((len(y), pairs(len(classes))[0].size))
    for train, test in splits:
        if len(absent := np.setdiff1d(y, y[train])):
            raise InputError(
                f"A fold holds every group of {classes[absent[0]]}; add groups with it, or choose other folds or "
                "smaller groups."
            )
        counted = None if sample_weight is None else sample_weight[train]
        out[test] = fit(x[train], y[train], classes, spec, weight, counted).decision(x[test])
    return out


def fit_sigmoids(decision: Matrix, y: Ints, classes: int, sample_weight: Weight = None) -> NDArray[np.float64]:
    """One sigmoid per pair ``[pair, 2]`` from held-out decision values ``[item, pair]`` and classes ``[item]``."""
    weight = np.ones(len(y)) if sample_weight is None else sample_weight
    first, second = pairs(classes)
    rows = [(y == i) | (y == j) for i, j in zip(first, second, strict=True)]
    return np.stack([fit_sigmoid(decision[row, p], y[row] == first[p], weight[row]) for p, row in enumerate(rows)])


def fit_sigmoid(decision: Matrix, positive: NDArray[np.bool_], sample_weight: Weight = None) -> NDArray[np.float64]:
    """Slope and offset of Platt's sigmoid, by maximum likelihood of smoothed targets (Lin, Lin and Weng 2007).

    Args:
        decision: float ``[item]``, positive for the positive class.
        positive: ``[item]``; both kinds must occur.
        sample_weight: ``[item]``, how often each counts; None = once.

    Raises:
        InputError: only one kind of item.
    """
    f = np.asarray(decision, np.float64)
    if not 0 < positive.sum() < len(f):
        raise InputError(f"a sigmoid needs items of both classes; {positive.sum()} of {len(f)} are of the first.")
    w = np.ones(len(f)) if sample_weight is None else sample_weight
    count, others = w[positive].sum(), w[~positive].sum()
    # Targets are drawn inwards by one item each, so that separable classes keep a finite slope.
    target = np.where(positive, (count + 1) / (count + 2), 1 / (others + 2))
    point = np.array([0.0, np.log((others + 1) / (count + 1))])
    loss = _loss(point, f, target, w)
    for _ in range(_STEPS):
        gradient, hessian = _derivatives(point, f, target, w)
        if np.abs(gradient).max() < _FLAT:
            break
        direction = -np.linalg.solve(hessian, gradient)
        step = 1.0
        while step >= _SHORTEST:
            tried = point + step * direction
            new = _loss(tried, f, target, w)
            if new < loss + 1e-4 * step * float(gradient @ direction):
                point, loss = tried, new
                break
            step /= 2
        else:
            break  # as flat as double precision can tell
    return point


def _loss(point: NDArray[np.float64], f: Matrix, target: Matrix, weight: Matrix) -> float:
    z = point[0] * f + point[1]
    return float(np.sum(weight * (np.logaddexp(0, z) - (1 - target) * z)))


def _sigmoid(x: Matrix) -> NDArray[np.float64]:
    """1 / (1 + exp(-x)) without overflow."""
    return np.asarray(np.exp(-np.logaddexp(0, -x)), np.float64)


def _derivatives(
    point: NDArray[np.float64], f: Matrix, target: Matrix, weight: Matrix
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p = _sigmoid(-(point[0] * f + point[1]))
    design = np.stack([f, np.ones_like(f)], 1)
    gradient = design.T @ (weight * (target - p))
    hessian = (design * (weight * p * (1 - p))[:, None]).T @ design + _RIDGE * np.eye(2)
    return gradient, hessian


def pair_probability(decision: Matrix, sigmoid: Matrix) -> NDArray[np.float64]:
    """Probability ``[item, pair]`` of each pair's first class, from decision values ``[item, pair]``."""
    return np.clip(_sigmoid(-(decision * sigmoid[:, 0] + sigmoid[:, 1])), CERTAIN, 1 - CERTAIN)


def couple(pair: Matrix, classes: int) -> NDArray[np.float64]:
    """Class probabilities ``[item, class]`` from pair probabilities ``[item, pair]``, at the exact minimum.

    The matrix is that of the quadratic form (Wu, Lin and Weng 2004, equation 18), plus ones: the constraint makes these
    a constant, and they make the form positive definite.
    """
    first, second = pairs(classes)
    r = np.zeros((len(pair), classes, classes))
    r[:, first, second], r[:, second, first] = pair, 1 - pair
    q = 1 - r * r.swapaxes(1, 2)
    q[:, np.arange(classes), np.arange(classes)] += (r * r).sum(1)
    z = np.linalg.solve(q, np.ones((len(pair), classes, 1)))[..., 0]
    z = np.maximum(z, 0.0)  # never negative but by rounding (theorem 2)
    return np.asarray(z / z.sum(1, keepdims=True), np.float64)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SvmArrays:
    """The same machine in single precision, laid out for one small product per belief."""

    center: Array  # float32 [feature]
    scale: Array  # float32 [feature], one over the width
    knots: Array  # float32 [knot, feature], lower ends of the ramps whose mean is the rank; [0, feature] = no ranks
    ramps: Array  # float32 [knot, feature], slopes of these ramps; STEP where two knots are one
    support: Array  # float32 [vector, feature]; [0, feature] for a linear kernel
    weight: Array  # float32 [vector, pair]; [feature, pair] for a linear kernel
    intercept: Array  # float32 [pair]
    sigmoid: Array  # float32 [pair, 2]


def to_arrays(model: ProbabilisticSvm) -> SvmArrays:
    """A fitted machine for :func:`probability_jax`; a linear kernel becomes its normal vectors.

    Equal support vectors, of items that counted several times, become one.
    """
    svm = model.svm
    support, inverse = np.unique(svm.support, axis=0, return_inverse=True)
    weight = np.zeros((len(support), svm.intercept.size))
    np.add.at(weight, inverse.ravel(), svm.pair_weights())
    if svm.spec.kernel == "linear":
        weight, support = support.T @ weight, support[:0]
    knots = svm.knots.astype(np.float32)
    gap = np.diff(knots, axis=0)
    ramps = np.where(gap > 1 / STEP, 1 / np.maximum(gap, 1 / STEP), STEP)
    arrays = (svm.center, 1 / svm.width, knots[:-1], ramps, support, weight, svm.intercept, model.sigmoid)
    return SvmArrays(*(np.asarray(a, np.float32) for a in arrays))


def probability_jax(arrays: SvmArrays, kernel: str, gamma: float, classes: int, x: Array) -> Array:
    """Class probabilities ``[class]`` of one row of features ``[feature]``, float32; ``jax.vmap`` for many.

    Args:
        arrays: from :func:`to_arrays`.
        kernel: of the machine.
        gamma: of the machine; not used by the linear kernel.
        classes: how many.
        x: float32 features.
    """
    scaled = _scaled_jax(arrays, x)
    with full_precision():
        decision = _kernel_jax(arrays, kernel, gamma, scaled) @ arrays.weight + arrays.intercept
    pair = jax.nn.sigmoid(-(decision * arrays.sigmoid[:, 0] + arrays.sigmoid[:, 1]))
    return couple_jax(jnp.clip(pair, CERTAIN, 1 - CERTAIN), classes)


def _scaled_jax(arrays: SvmArrays, x: Array) -> Array:
    if arrays.knots.shape[0] > 0:
        half = jnp.where(arrays.ramps < STEP, jnp.float32(0), jnp.float32(0.5))  # the middle of a step on it
        ramp = jnp.clip((x[None] - arrays.knots) * arrays.ramps + half, 0, 1)
        x = (jnp.mean(ramp, axis=0) - 0.5) * SPREAD
    return (x - arrays.center) * arrays.scale


def _kernel_jax(arrays: SvmArrays, kernel: str, gamma: float, x: Array) -> Array:
    if kernel == "linear":
        return x
    dot = arrays.support @ x
    if kernel == "poly":
        return (gamma * dot) ** DEGREE
    square = x @ x + jnp.sum(arrays.support * arrays.support, axis=1) - 2 * dot
    return jnp.exp(-gamma * jnp.maximum(square, 0))


def couple_jax(pair: Array, classes: int) -> Array:
    """As :func:`couple`, for one item: ``[pair]`` of any float type to ``[class]``; ``jax.vmap`` for many."""
    first, second = pairs(classes)
    source = np.full((classes, classes), 2 * first.size)
    source[first, second], source[second, first] = np.arange(first.size), first.size + np.arange(first.size)
    r = jnp.concatenate([pair, 1 - pair, jnp.zeros_like(pair[:1])])[source]
    q = jnp.diag(jnp.sum(r * r, axis=0)) - r * r.T + 1
    rows = jnp.concatenate([q, jnp.ones_like(q[:, :1])], axis=1)
    # Gauss-Jordan without pivoting: stable, because the matrix is symmetric and positive definite.
    for t in range(classes):
        row = rows[t : t + 1] / rows[t, t]
        rows = jnp.where(jnp.arange(classes)[:, None] == t, row, rows - rows[:, t : t + 1] * row)
    z = jnp.maximum(rows[:, -1], 0)
    return z / jnp.sum(z)
