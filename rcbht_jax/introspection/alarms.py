"""When to raise an alarm: a threshold from nominal trials alone, for a rate of false alarms per trial.

A trial raises an alarm if the probability of the alarming class stays above the threshold for the hold time; the
highest level that it holds so long is its peak. The threshold is the conformal quantile of peaks of nominal trials
that the machine did not see (Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World*, 2005, chapter 4):
a new nominal trial exceeds it with at most the chosen probability, whatever the distribution of the peaks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import Ints, Matrix, fit, grouped_folds

FOLDS = 5


def sustained_peak(probability: NDArray[np.floating[Any]], looks: int) -> float:
    """The highest level that ``probability [look]`` keeps for ``looks`` looks in a row; 0 if there are fewer."""
    if len(probability) < looks:
        return 0.0
    return float(np.lib.stride_tricks.sliding_window_view(probability, looks).min(1).max())


def conformal_threshold(peaks: NDArray[np.floating[Any]], share: float) -> float:
    """Threshold that a new nominal trial's peak exceeds with a probability of at most ``share``.

    Args:
        peaks: of nominal trials ``[trial]`` that the machine did not see.
        share: false alarms per nominal trial.

    Raises:
        InputError: there are too few trials to promise so small a share, which takes 1 / share - 1 of them.
    """
    if not 0 < share < 1:
        raise InputError(f"{share:g} false alarms per trial were asked for; expected a number between 0 and 1.")
    rank = int(np.ceil((len(peaks) + 1) * (1 - share) - 1e-9))
    if rank > len(peaks):
        raise InputError(
            f"{len(peaks)} nominal trials cannot promise {share:g} false alarms per trial; "
            f"it takes {int(np.ceil(1 / share - 1 - 1e-9))}."
        )
    return float(np.sort(peaks)[rank - 1])


def peaks(probability: NDArray[np.floating[Any]], groups: NDArray[Any], looks: int) -> NDArray[np.float64]:
    """:func:`sustained_peak` of every trial, in the order of their names: ``[look]`` and trial ``[look]`` to ``[trial]``."""
    return np.array([sustained_peak(probability[groups == trial], looks) for trial in np.unique(groups)])


def held_out(
    machine: ProbabilisticSvm,
    x: Matrix,
    y: Ints,
    groups: NDArray[Any],
    stream: Matrix,
    stream_group: NDArray[Any],
    seed: int,
) -> NDArray[np.float64]:
    """Class probabilities of training trials as they are streamed, each by a machine that saw nothing of the trial.

    Args:
        machine: trained on all of ``x``; gives hyper-parameters and sigmoids.
        x: training features ``[item, feature]``.
        y: class index ``[item]``.
        groups: trial ``[item]``.
        stream: features of looks at training trials ``[look, feature]``.
        stream_group: trial ``[look]``.
        seed: of the folds.

    Returns:
        ``[look, class]``.

    Raises:
        InputError: a streamed trial is not among those that train.
    """
    out = np.full((len(stream), len(machine.svm.classes)), np.nan)
    for train, test in grouped_folds(y, groups, _folds(y, groups), seed):
        one = ProbabilisticSvm(fit(x[train], y[train], machine.svm.classes, machine.svm.spec), machine.sigmoid)
        rows = np.flatnonzero(np.isin(stream_group, groups[test]))
        out[rows] = one.probability(stream[rows])
    if np.isnan(out).any():
        raise InputError("A streamed trial is not among those that train, so that nothing is held out for it.")
    return out


def _folds(y: Ints, groups: NDArray[Any]) -> int:
    return min(FOLDS, *(len(np.unique(groups[y == c])) for c in np.unique(y)))
