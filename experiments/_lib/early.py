"""Rules of early classification: when to stop on the beliefs of classifiers of growing prefixes, and their scores.

ECONOMY-gamma (Achenchabe, Bondu, Cornuejols and Dachraoui 2021, Machine Learning 110, section 4.2, with the largest
probability as the confidence of several classes) and CALIMERA (Bilski and Jastrzebska 2023, Information Processing and
Management 60), written from the papers. The cost of a decision is weight * error + (1 - weight) * delay. A rule is
fitted on calibrated beliefs of classifiers that were not trained on the items; the delay at a time is the share of the
whole that has passed. A fitted rule is a function of beliefs ``[time, item, class]`` that uses none of them before
their time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from sklearn.kernel_ridge import KernelRidge

Beliefs = Float[np.ndarray, "time item classes"]
Rule = Callable[[Beliefs], Int[np.ndarray, " item"]]  # index of the time of each item's decision


def certain(level: float) -> Rule:
    """Stop at the first belief of at least ``level``, else at the end."""
    return lambda beliefs: first(beliefs.max(2) >= level)


def first(stops: Bool[np.ndarray, "time item"]) -> Int[np.ndarray, " item"]:
    """Index of the first time at which a rule stops; the last one where it never does.

    >>> first(np.array([[False, False], [True, False], [True, False]])).tolist()
    [1, 2]
    """
    return np.concatenate([stops[:-1], np.ones_like(stops[:1])]).argmax(0)


def economy(
    beliefs: Beliefs, y: Int[np.ndarray, " item"], delay: Float[np.ndarray, " time"], weight: float, groups: int
) -> Rule:
    """ECONOMY-gamma: stop where no later time has a smaller expected cost.

    At each time the items are divided into groups by quantiles of their confidence. Later costs are estimated from the
    errors of later groups and a Markov chain between the groups of consecutive times.
    """
    confidence, wrong = beliefs.max(2), beliefs.argmax(2) != y
    inner = np.arange(1, groups) / groups
    edges = np.quantile(confidence, inner, axis=1).T  # [time, groups - 1]
    group = np.stack([np.searchsorted(row, values, "right") for row, values in zip(edges, confidence, strict=True)])
    member = group[..., None] == np.arange(groups)  # [time, item, group]
    size = member.sum(1)
    error = np.where(size > 0, (member * wrong[..., None]).sum(1) / np.maximum(size, 1), wrong.mean(1)[:, None])
    moves = np.einsum("tig,tih->tgh", member[:-1].astype(float), member[1:].astype(float))
    share = member.mean(1)
    # A group without items goes on as all items do.
    chain = np.where(size[:-1, :, None] > 0, moves / np.maximum(size[:-1, :, None], 1), share[1:, None, :])
    stops = np.zeros((len(delay), groups), bool)
    for now in range(len(delay)):
        reach, costs = np.eye(groups), []
        for then in range(now, len(delay)):
            costs.append(weight * reach @ error[then] + (1 - weight) * delay[then])
            reach = reach @ chain[then] if then + 1 < len(delay) else reach
        stops[now] = np.argmin(costs, axis=0) == 0

    def decide(seen: Beliefs) -> Int[np.ndarray, " item"]:
        rows = zip(stops, edges, seen.max(2), strict=True)
        return first(np.stack([stop[np.searchsorted(edge, values, "right")] for stop, edge, values in rows]))

    return decide


def calimera(beliefs: Beliefs, delay: Float[np.ndarray, " time"], weight: float) -> Rule:
    """CALIMERA: stop where a regression predicts that waiting costs no less than deciding now.

    The cost now is estimated by the belief itself. From the last time backwards a kernel ridge regression learns the
    difference between the cost of going on, by the rule of the later times, and of deciding now.
    """
    cost = weight * (1 - beliefs.max(2)) + (1 - weight) * delay[:, None]
    later, regressions = cost[-1], []
    for now in reversed(range(len(delay) - 1)):
        x = _described(beliefs[now])
        regressions.insert(0, KernelRidge(kernel="rbf").fit(x, later - cost[now]))
        waits = regressions[0].predict(x) < 0
        later = np.where(waits, later, cost[now])

    def decide(seen: Beliefs) -> Int[np.ndarray, " item"]:
        stops = [model.predict(_described(belief)) >= 0 for model, belief in zip(regressions, seen[:-1], strict=True)]
        return first(np.stack([*stops, np.ones(seen.shape[1], bool)]))

    return decide


def _described(belief: Float[np.ndarray, "item classes"]) -> Float[np.ndarray, "item feature"]:
    """The probabilities, the largest, and its distance from the next."""
    best = np.sort(belief, axis=1)[:, ::-1]
    return np.concatenate([belief, best[:, :1], best[:, :1] - best[:, 1:2]], 1)


def harmonic_mean(accuracy: float, earliness: float) -> float:
    """Harmonic mean of the accuracy and of the share that is spared (Schaefer and Leser 2020); 0 if either is 0.

    >>> harmonic_mean(0.9, 0.4)
    0.72
    """
    spared = 1 - earliness
    return round(2 * accuracy * spared / (accuracy + spared), 12) if accuracy * spared > 0 else 0.0


def worth(
    beliefs: Beliefs, y: Int[np.ndarray, " item"], delay: Float[np.ndarray, " time"], at: Int[np.ndarray, " item"]
) -> tuple[float, float, float]:
    """Accuracy, earliness and harmonic mean of decisions at the times ``at``; earliness is the mean delay."""
    right = beliefs[at, np.arange(len(y))].argmax(1) == y
    accuracy, earliness = float(right.mean()), float(delay[at].mean())
    return accuracy, earliness, harmonic_mean(accuracy, earliness)
