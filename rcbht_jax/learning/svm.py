"""Support vector machines on feature matrices: fitting, decision values without scikit-learn, selection.

One-versus-one C-SVC with linear, polynomial (degree 3) and Gaussian kernels. The default gamma is "auto"
(1 / number of features), the default of scikit-learn 0.18 that the authors used, and not today's "scale";
the cost grid is theirs, 1e-5 ... 1e4 in powers of ten (evaluation notes, "Definitions").

Selection is always nested: kernel, cost, scaling and the feature matrix itself are chosen by grouped
cross-validation inside the training side of a split, so nothing is ever chosen on the items that give the
score. Items of one group (a trial) are never on both sides.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.selection import group_numbers
from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError
from rcbht_jax.learning import metrics
from rcbht_jax.learning.class_groups import Split as Split
from rcbht_jax.learning.class_groups import TooFewTrials, check_seed, fewest_groups, groups_of_classes, training_all
from rcbht_jax.learning.scaling import Scale, fit_scale

KERNELS = ("linear", "poly", "rbf")
COSTS = tuple(10.0**p for p in range(-5, 5))
DEGREE = 3
_VALUES = 2**24  # of a kernel at once, 128 MiB: streams and stores have millions of items

Matrix = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Weight = NDArray[np.float64] | None  # positive: [feature] multiplies scaled features, [item] counts; None = ones

_MIN_ITERATIONS, _PER_ITEM = 20_000, 100  # bounds of the solver while selecting: costs that reach them are hopeless


@dataclass(frozen=True)
class SvmSpec:
    """Hyper-parameters of one classifier.

    Raises:
        InputError: a value is of another type or out of range.
    """

    kernel: str = "poly"  # one of KERNELS
    cost: float = 1.0  # C
    scaling: bool = False  # standardise features by mean and deviation of the training side
    gamma: str = "auto"  # "auto" = 1 / features, "scale" = 1 / (features x variance)
    balanced: bool = False  # weigh classes by the inverse of their frequency
    features: str = ""  # which candidate feature matrix; "" = the only one
    floor: float = 0.0  # least deviation to divide by when scaling, so that a rare label does not dominate
    ranks: bool = False  # scale by ranks among the training side instead of mean and deviation

    def __post_init__(self) -> None:
        make_plain(self)
        if self.kernel not in KERNELS or self.gamma not in ("auto", "scale") or not 0 < self.cost < float("inf"):
            raise InputError(
                f"an SVM with kernel {self.kernel!r}, gamma {self.gamma!r} and cost {self.cost} does not exist; "
                f"choose a kernel of {', '.join(KERNELS)}, gamma auto or scale, and a positive cost."
            )
        if self.floor < 0:
            raise InputError(f"The floor of deviations is {self.floor}; expected zero or more.")
        if self.ranks and not self.scaling:
            raise InputError("ranks are a way of scaling; choose scaling with them.")


@dataclass(frozen=True)
class Grid:
    """What nested selection may choose from; ties go to the earlier kernel, no scaling, the smaller cost.

    Raises:
        InputError: nothing to choose from, costs that do not increase, or a value of another type.
    """

    kernels: tuple[str, ...] = KERNELS
    costs: tuple[float, ...] = COSTS  # increasing; those too hard to solve are passed over
    scalings: tuple[bool, ...] = (False, True)
    gamma: str = "auto"
    balanced: bool = False  # balanced class weights, and selection by balanced accuracy
    inner: int = 5  # folds of the selection
    floor: float = 0.0  # see SvmSpec
    ranks: bool = False  # scaled features are ranks, see SvmSpec

    def __post_init__(self) -> None:
        make_plain(self)
        for name in ("kernels", "costs", "scalings"):
            if not getattr(self, name):
                raise InputError(f"There are no {name} to choose from; give at least one.")
        if list(self.costs) != sorted(set(self.costs)):
            raise InputError(f"The costs are {self.costs}; expected increasing ones.")

    def paths(self, candidates: Sequence[str]) -> list[SvmSpec]:
        """Every choice but the cost, which is set to the smallest."""
        return [
            SvmSpec(kernel, self.costs[0], scaling, self.gamma, self.balanced, name, self.floor, self.ranks and scaling)
            for name in candidates
            for scaling in self.scalings
            for kernel in self.kernels
        ]


@dataclass(frozen=True)
class SvmModel:
    """A fitted one-versus-one SVM as plain arrays; ``predict`` needs NumPy only.

    Pairs are ordered (0, 1), (0, 2), ... (1, 2), ...; a positive decision value votes for the first class.
    """

    spec: SvmSpec
    gamma: float  # the number that "auto" or "scale" stood for
    classes: tuple[str, ...]  # [class]
    center: NDArray[np.float64]  # [feature] subtracted first
    width: NDArray[np.float64]  # [feature] divided by second
    knots: NDArray[np.float64]  # [knot, feature] quantiles of the training items for ranks; [0, feature] = no ranks
    support: NDArray[np.float64]  # [vector, feature] after scaling, sorted by class
    support_count: NDArray[np.int64]  # [class] vectors per class
    dual: NDArray[np.float64]  # [class - 1, vector] signed dual coefficients, as in libsvm
    intercept: NDArray[np.float64]  # [pair]

    def decision(self, x: Matrix) -> NDArray[np.float64]:
        """One-versus-one decision values ``[item, pair]`` of ``[item, feature]``.

        Raises:
            InputError: the number of features is not the model's.
        """
        if x.ndim != 2 or x.shape[1] != self.center.size:
            raise InputError(f"features of shape {x.shape} do not fit a model of {self.center.size} features.")
        scaled = Scale(self.center, self.width, self.knots)(x)
        if self.spec.kernel == "linear":  # one normal vector per pair costs far less than every support vector
            return np.asarray(scaled @ (self.support.T @ self.pair_weights()) + self.intercept, np.float64)
        weights, step = self.pair_weights(), 1 + _VALUES // max(len(self.support), 1)
        blocks = [scaled[first : first + step] for first in range(0, max(len(scaled), 1), step)]
        parts = [gram(block, self.support, self.spec.kernel, self.gamma) @ weights for block in blocks]
        return np.concatenate(parts) + self.intercept

    def pair_weights(self) -> NDArray[np.float64]:
        """``[vector, pair]``: libsvm keeps class i's weight against j in row j - 1, class j's in row i."""
        edge = np.concatenate([[0], np.cumsum(self.support_count)])
        first, second = pairs(len(self.classes))
        weights = np.zeros((edge[-1], first.size))
        for p, (i, j) in enumerate(zip(first, second, strict=True)):
            weights[edge[i] : edge[i + 1], p] = self.dual[j - 1, edge[i] : edge[i + 1]]
            weights[edge[j] : edge[j + 1], p] = self.dual[i, edge[j] : edge[j + 1]]
        return weights

    def predict_index(self, x: Matrix) -> NDArray[np.int64]:
        """Class index ``[item]`` by majority of pair votes; ties go to the earlier class."""
        return vote(self.decision(x), len(self.classes))

    def predict(self, x: Matrix) -> NDArray[np.str_]:
        """Class name ``[item]``."""
        return np.array(self.classes)[self.predict_index(x)]


def pairs(classes: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and second class of every pair, in the order of the decision values."""
    first, second = np.triu_indices(classes, 1)
    return first.astype(np.int64), second.astype(np.int64)


def vote(decision: Matrix, classes: int) -> NDArray[np.int64]:
    """Class index ``[item]`` from decision values ``[item, pair]``."""
    first, second = pairs(classes)
    winner = np.where(decision > 0, first, second)
    votes = (winner[..., None] == np.arange(classes)).sum(1)
    return votes.argmax(-1).astype(np.int64)


def gram(a: Matrix, b: Matrix, kernel: str, gamma: float, dot: Matrix | None = None) -> NDArray[np.float64]:
    """Kernel values ``[items of a, items of b]``; ``dot`` = ``a @ b.T``, where it is known."""
    product = np.asarray(a @ b.T if dot is None else dot, np.float64)
    if kernel == "linear":
        return product
    if kernel == "poly":
        return (gamma * product) ** DEGREE
    square = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2 * product
    return np.exp(-gamma * np.maximum(square, 0))


def _gamma(x: Matrix, kind: str, sample_weight: Weight = None) -> float:
    variance = float(x.var()) if kind == "scale" else 1.0
    if kind == "scale" and sample_weight is not None:
        center = np.average(x.mean(1), weights=sample_weight)
        variance = float(np.average(((x - center) ** 2).mean(1), weights=sample_weight))
    return 1.0 / (x.shape[1] * (variance if variance > 0 else 1.0))


def fit(
    x: Matrix, y: Ints, classes: Sequence[str], spec: SvmSpec, weight: Weight = None, sample_weight: Weight = None
) -> SvmModel:
    """Train on ``[item, feature]`` with class indices ``[item]``; ``weight`` ``[feature]`` follows the scaling.

    ``sample_weight`` ``[item]``, positive, is how often each item counts; None = once.

    Raises:
        InputError: a class has no item, or a feature is not finite.
    """
    _check(x, y, classes)
    x = np.asarray(x, np.float64)
    scale = fit_scale(x, spec.scaling, spec.floor, spec.ranks, weight, sample_weight)
    scaled = scale(x)
    gamma = _gamma(scaled, spec.gamma, sample_weight)
    if spec.balanced and sample_weight is not None:  # SVC balances by the number of items
        count = np.bincount(y, sample_weight)
        sample_weight = sample_weight * (count.sum() / (len(count) * count))[y]
    balanced = spec.balanced and sample_weight is None
    machine = solved(scaled, y, spec.kernel, spec.cost, balanced, -1, gamma, sample_weight)
    # scikit-learn turns the sign around when there are two classes only.
    sign = -1.0 if len(classes) == 2 else 1.0
    return SvmModel(
        spec=spec,
        gamma=gamma,
        classes=tuple(classes),
        center=scale.center,
        width=scale.width,
        knots=scale.knots,
        support=machine.support_vectors_,
        support_count=machine.n_support_.astype(np.int64),
        dual=sign * machine.dual_coef_,
        intercept=sign * machine.intercept_,
    )


def solved(
    x: Matrix,
    y: Ints,
    kernel: str,
    cost: float,
    balanced: bool = False,
    iterations: int = -1,
    gamma: float = 1.0,
    sample_weight: Weight = None,
) -> Any:
    """A fitted ``SVC``; its ``fit_status_`` is 1 if it stopped at the bound on iterations (-1 = none)."""
    # Imported by those who train only: it takes longer to import than a stream may take to start.
    with needs_extra("learn"):
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.svm import SVC

    weight = "balanced" if balanced else None
    machine = SVC(C=cost, kernel=kernel, degree=DEGREE, gamma=gamma, class_weight=weight, max_iter=iterations)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return machine.fit(x, y, sample_weight)


def _check(x: Matrix, y: Ints, classes: Sequence[str]) -> None:
    if x.ndim != 2 or x.shape[0] != y.shape[0]:
        raise InputError(f"features of shape {x.shape} do not fit {y.shape[0]} items; expected one row per item.")
    if not np.isfinite(x).all():
        raise InputError(f"feature {int(np.argwhere(~np.isfinite(x))[0, 1])} is not finite.")
    count = np.bincount(y, minlength=len(classes))
    if len(classes) < 2 or len(count) > len(classes) or (count == 0).any():
        raise InputError(
            f"the classes {', '.join(classes)} have {count.tolist()} items; at least two classes with at "
            "least one item each are needed."
        )


def grouped_folds(y: Ints, groups: NDArray[Any], folds: int | Any, seed: int, group: str = "trial") -> list[Split]:
    """Stratified folds that keep groups together, in a seeded order: scikit-learn's StratifiedGroupKFold.

    Where one of these would not train every class, the groups are divided otherwise, if they can be.

    Args:
        y: class index ``[item]``.
        groups: trial ``[item]``.
        folds: how many, or a scikit-learn splitter to use instead.
        seed: of the shuffle; a splitter has its own.
        group: what a group is called where there are too few.

    Raises:
        InputError: too few groups of a class, no such seed, or the splitter divides a group, has an empty side, or is
            none.
    """
    with needs_extra("learn"):
        from sklearn.model_selection import StratifiedGroupKFold

    if not isinstance(folds, int | np.integer):
        if isinstance(folds, str) or not hasattr(folds, "split"):
            raise InputError(f"The folds are {type(folds).__name__}; expected a number, or a scikit-learn splitter.")
        splits = [(np.asarray(a, np.int64), np.asarray(b, np.int64)) for a, b in folds.split(y, y, groups)]
        if not splits or not all(len(side) for split in splits for side in split):
            raise InputError(f"{folds} gives no split, or one with nothing to train on or to test; choose another.")
        number = group_numbers(groups)  # missing values are one group: NaN is not equal to NaN
        if any(np.intersect1d(number[train], number[test]).size for train, test in splits):
            raise InputError(f"{folds} puts items of one trial on both sides; use one for groups, such as GroupKFold.")
        return splits
    check_seed(seed)
    fewest = fewest_groups(y, groups)
    if folds < 2 or fewest < folds:
        if fewest < 2:
            raise TooFewTrials(f"The rarest class has {fewest} {group}; cross-validation needs two of every class.")
        possible = "2" if fewest == 2 else f"2 to {fewest}"
        raise TooFewTrials(f"{folds} folds: the rarest class has {fewest} {group}s, so choose {possible} folds.")
    found = StratifiedGroupKFold(folds, shuffle=True, random_state=seed).split(y, y, groups)
    return training_all([(a.astype(np.int64), b.astype(np.int64)) for a, b in found], y, groups, seed)


def _inner_folds(y: Ints, groups: NDArray[Any], most: int, seed: int) -> list[Split]:
    """Folds of the items whose class has two groups or more."""
    classes = np.unique(y)
    several = classes[groups_of_classes(y, groups, classes) > 1]
    if len(several) < 2:
        raise TooFewTrials(
            f"Kernel, cost and scaling are chosen on the training part, where {len(several) or 'no'} class has two "
            "trials; it takes two such classes, or a single kernel, cost, scaling and set of features."
        )
    rows = np.flatnonzero(np.isin(y, several))
    folds = grouped_folds(y[rows], groups[rows], min(most, fewest_groups(y[rows], groups[rows])), seed)
    return [(rows[train], rows[test]) for train, test in folds]


def select(
    candidates: Mapping[str, Matrix],
    y: Ints,
    groups: NDArray[Any],
    grid: Grid,
    seed: int,
    weights: Mapping[str, Weight] | None = None,
    progress: Callable[[int], Any] | None = None,
) -> SvmSpec:
    """The grid's best choice by grouped cross-validation on the items given (training items).

    Args:
        candidates: feature matrices ``[item, feature]`` of the same items, by name.
        y: class index ``[item]``.
        groups: trial ``[item]``.
        grid: choices; fewer inner folds are used when a class has fewer trials than ``grid.inner``. A class with a
            single trial has no part in the choice, if two others remain.
        seed: of the folds.
        weights: of the features ``[feature]``, by name of the matrix, where they do not all weigh the same.
        progress: called with 1 after each fold.

    Raises:
        InputError: fewer than two classes have two trials or more, and there is something to choose.
    """
    paths = grid.paths(list(candidates))
    if len(paths) == len(grid.costs) == 1:
        return paths[0]
    splits = _inner_folds(y, groups, grid.inner, seed)
    scores = np.zeros((len(paths), len(grid.costs)))
    score = metrics.balanced_accuracy if grid.balanced else metrics.accuracy
    for train, test in splits:
        scaled, dot, made_for = np.zeros((0, 0)), np.zeros((0, 0)), None
        for i, spec in enumerate(paths):  # all kernels of one matrix follow each other, share its scaling and products
            if made_for != (made_for := (spec.features, spec.scaling)):
                scaled = _scaled(candidates[spec.features], train, spec, (weights or {}).get(spec.features))
                dot = scaled @ scaled[train].T
            predicted = _predicted(scaled, y, train, test, spec, grid.costs, dot)
            scores[i] += [score(y[test], s) for s in predicted]
        if progress:
            progress(1)
    best = int(scores.round(9).argmax())
    return replace(paths[best // len(grid.costs)], cost=grid.costs[best % len(grid.costs)])


def predictions(
    x: Matrix, y: Ints, train: Ints, test: Ints, spec: SvmSpec, costs: Sequence[float], weight: Weight = None
) -> list[NDArray[np.int64]]:
    """Class index ``[test item]`` for each cost (increasing), trained on the rows ``train`` of ``x``.

    Once no dual variable reaches its bound the solution no longer depends on the cost, so the path along
    the costs ends there and the last answer stands for the rest. It also ends where the solver gives up:
    larger costs are harder still, and repeating the last solved answer keeps ties from choosing them.
    """
    return _predicted(_scaled(x, train, spec, weight), y, train, test, spec, costs)


def _scaled(x: Matrix, train: Ints, spec: SvmSpec, weight: Weight) -> NDArray[np.float64]:
    return fit_scale(x[train], spec.scaling, spec.floor, spec.ranks, weight)(x)


def _predicted(
    scaled: Matrix, y: Ints, train: Ints, test: Ints, spec: SvmSpec, costs: Sequence[float], dot: Matrix | None = None
) -> list[NDArray[np.int64]]:
    kernel = gram(scaled, scaled[train], spec.kernel, _gamma(scaled[train], spec.gamma), dot)
    among, against, known = kernel[train], kernel[test], y[train]
    share = len(known) / (np.bincount(known).max() * len(np.unique(known))) if spec.balanced else 1.0
    predicted: list[NDArray[np.int64]] = []
    for cost in costs:
        bound = max(_MIN_ITERATIONS, _PER_ITEM * len(known))
        machine = solved(among, known, "precomputed", cost, spec.balanced, bound)
        if predicted and machine.fit_status_ == 1:
            break
        predicted.append(machine.predict(against).astype(np.int64))
        if np.abs(machine.dual_coef_).max() < cost * share:
            break
    return predicted + [predicted[-1]] * (len(costs) - len(predicted))
