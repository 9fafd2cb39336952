"""Estimators on the raw wrench: common methods for time series, and probes that see only a few samples.

Each takes segments ``[time, channel]`` of any lengths. Those that need equal lengths resample to ``LENGTH`` samples by
linear interpolation, which removes the duration. Normalisation, random kernels and hyper-parameters are fitted on the
training rows.

Sources: MiniRocket (Dempster et al. 2021), MultiRocket and Hydra (Tan et al. 2022, Dempster et al. 2023), all of the
library aeon; SAX (Lin et al. 2007), bag of SAX words (Lin et al. 2012), 1d-SAX (Malinowski et al. 2013) of tslearn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.stats import norm
from sklearn.ensemble import RandomForestClassifier

from experiments._lib.arrays import Floats
from rcbht_jax.errors import InputError
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.learning.validation import Estimator, Prediction, nested_svm

LENGTH = 512
TREES = 200
PIECES, LEVELS = 16, 8  # 1d-SAX: segments of the series, letters for the mean and for the slope
WINDOW, WORD, LETTERS = 64, 4, 4  # SAX bag of words
FLAT = 0.01  # N or Nm: a window that varies less is flat, not noise blown up to full height
SVM = Grid(kernels=("linear", "rbf"), costs=(0.01, 0.1, 1.0, 10.0, 100.0), scalings=(False, True))

Segments = Sequence[Floats]


def resampled(segments: Segments, length: int = LENGTH) -> Floats:
    """``[item, channel, length]`` by straight lines between samples; a single sample is repeated."""
    out = np.empty((len(segments), segments[0].shape[1], length))
    for place, segment in zip(out, segments, strict=True):
        at = np.linspace(0, len(segment) - 1, length)
        for row, channel in zip(place, segment.T, strict=True):
            row[:] = np.interp(at, np.arange(len(segment)), channel)
    return out


def centred(segments: Segments) -> list[Floats]:
    """Segments without their mean: no absolute offset is left."""
    return [segment - segment.mean(0) for segment in segments]


def statistics(segments: Segments) -> Floats:
    """``[item, 13 x channel]``: moments, quantiles, ends, slope and roughness of each channel."""
    rows = []
    for x in segments:
        time = np.linspace(-0.5, 0.5, len(x))[:, None] * (len(x) > 1)  # a single sample has no slope
        slope = (time * x).sum(0) / max(float((time**2).sum()), 1e-12)
        rough = np.abs(np.diff(x, axis=0)).mean(0) if len(x) > 1 else np.zeros(x.shape[1])
        quantiles = np.quantile(x, [0, 0.1, 0.25, 0.5, 0.75, 0.9, 1], axis=0)
        rows.append(np.concatenate([x.mean(0), x.std(0), *quantiles, x[0], x[-1], slope, rough]))
    return np.array(rows)


def sax_bag(segments: Segments) -> Floats:
    """Share of each SAX word ``[item, channel x LETTERS ** WORD]``; a word that repeats counts once.

    Every window is normalised by itself, so neither offset nor size is left.
    """
    x = sliding_window_view(resampled(segments), WINDOW, axis=-1)
    x = x - x.mean(-1, keepdims=True)
    scaled = x / np.maximum(x.std(-1, keepdims=True), FLAT)
    means = scaled.reshape(*x.shape[:-1], WORD, WINDOW // WORD).mean(-1)
    letters = np.searchsorted(norm.ppf(np.arange(1, LETTERS) / LETTERS), means)
    words = letters @ LETTERS ** np.arange(WORD)
    first = np.ones(words.shape, bool)
    first[..., 1:] = words[..., 1:] != words[..., :-1]
    size = LETTERS**WORD
    lane = np.arange(words.shape[0] * words.shape[1]).reshape(*words.shape[:2], 1) * size
    counts = np.bincount((lane + words)[first], minlength=words.shape[0] * words.shape[1] * size)
    counts = counts.reshape(*words.shape[:2], size)
    return (counts / counts.sum(-1, keepdims=True)).reshape(len(words), -1)


def estimator(x: NDArray[Any], y: NDArray[np.int64], make: Callable[[int], Any]) -> Estimator:
    """Estimator from a classifier with ``fit`` and ``predict``, made anew for every seed."""

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> Prediction:
        return make(seed).fit(x[train], y[train]).predict(x[test]).astype(np.int64), {}

    return learn


def forest(x: Floats, y: NDArray[np.int64]) -> Estimator:
    """Random forest of 200 trees on ``[item, feature]``."""
    return estimator(x, y, lambda seed: RandomForestClassifier(TREES, random_state=seed))


def first_sample(segments: Segments, items: LabelledIntervals) -> Estimator:
    """Forest on the first sample alone."""
    return forest(np.array([segment[0] for segment in segments]), items.y)


def first_second(segments: Segments, items: LabelledIntervals) -> Estimator:
    """Forest on the statistics of the first second alone."""
    samples = round(1 / items.intervals[0].dt)
    return forest(statistics([segment[:samples] for segment in segments]), items.y)


def of_aeon(name: str, x: Floats, y: NDArray[np.int64]) -> Estimator:
    """A classifier of the library aeon, by its name."""
    try:
        from aeon.classification import convolution_based, interval_based
    except ImportError as error:
        raise InputError('the peers need the library aeon; run them by "make peers".') from error
    make = getattr(convolution_based, name, None) or getattr(interval_based, name)
    return estimator(x, y, lambda seed: make(random_state=seed))


def one_d_sax(segments: Segments, items: LabelledIntervals) -> Estimator:
    """Letters for the mean and slope of equal parts, normalised by the training rows, with an SVM."""
    from tslearn.piecewise import OneD_SymbolicAggregateApproximation

    x = resampled(segments).transpose(0, 2, 1)

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> Prediction:
        mean, width = x[train].mean((0, 1)), np.maximum(x[train].std((0, 1)), FLAT)
        sax = OneD_SymbolicAggregateApproximation(PIECES, LEVELS, LEVELS)
        letters = sax.fit_transform((x - mean) / width).reshape(len(x), -1).astype(np.float64)
        return nested_svm({"": letters / (LEVELS - 1)}, items.y, items.trial, SVM)(train, test, seed)

    return learn


def sax_words(segments: Segments, items: LabelledIntervals) -> Estimator:
    """Bag of SAX words with an SVM."""
    return nested_svm({"": sax_bag(segments)}, items.y, items.trial, SVM)
