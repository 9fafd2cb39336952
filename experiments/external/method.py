"""The one method that is used on every data set, and the choice that led to it.

An SVM on the words (ranks of the features, RBF kernel, C = 10) and extremely randomised trees on the wrench itself
(statistics and 16 resampled values) average their probabilities. Members, features, C and the size of the forest were
chosen by the mean accuracy over six benchmarks of HIRO (:mod:`experiments.external.choice`), before the combination was
scored on recordings of other laboratories.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import StratifiedKFold

from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import segments
from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.probability import FOLDS, fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.types import Recordings

FAMILIES = ("histogram", "attributes", "course", "edges")
SVM = SvmSpec("rbf", 10.0, True, "scale", ranks=True)
TREES, VALUES = 400, 16
WINDOW, SHORT, FEW = 5, 2, 10  # samples per line; those of recordings with fewer than FEW windows
ABOUT = {
    "words": list(FAMILIES),
    "svm": "ranks, rbf, C 10, gamma scale",
    "thresholds": "auto; what it takes for rest was changed when all sets had been scored, for kitting's rest",
    "window": f"{WINDOW}, {SHORT} where half of the recordings have fewer than {FEW} windows",
    "trees": f"{TREES}, on statistics and {VALUES} values of each axis",
    "looks at the external sets before the choice": (
        "trees on richer words and the wrench together were scored once on LP1, LP2 and LP4 with another programme"
    ),
    "the choice": (
        "made with scikit-learn's SVC and its probabilities (mean over HIRO .948, two repeats; the next .946, .944); "
        "repeated with this package's probabilities (external_choice.json) three members are better. It was "
        "not changed after the external sets were scored; three members are a row of their own."
    ),
}

Matrix = Float[np.ndarray, "item feature"]
Rows = Int[np.ndarray, " row"]
Member = Callable[[Matrix, Rows, Rows, Rows, int], Matrix]  # svm or trees


def describe(
    recordings: Recordings, items: LabelledIntervals, families: tuple[str, ...] = FAMILIES
) -> tuple[Matrix, Matrix]:
    """Features of the words, and of the wrench itself."""
    return describe_words(recordings, items, recordings, families), describe_wrench(segments(recordings, items))


def describe_words(
    recordings: Recordings, items: LabelledIntervals, rest: Recordings, families: tuple[str, ...] = FAMILIES
) -> Matrix:
    """Features of the words, whose thresholds come from what rests in ``rest``."""
    short = np.median(recordings.length) < FEW * WINDOW
    window = SHORT if short else WINDOW
    limits = auto_thresholds(rest, window)
    tracks = encode_batch(EncoderConfig(dt=recordings.dt, window=window), limits, recordings.wrench, recordings.length)
    return extract_features(tracks, items, FeatureSpec(families=families)).values.astype(np.float64)


def describe_wrench(parts: raw.Segments) -> Matrix:
    """Statistics and resampled values of every axis."""
    return np.concatenate([raw.statistics(parts), raw.resampled(parts, VALUES).reshape(len(parts), -1)], 1)


def trees(x: Matrix, y: Rows, train: Rows, test: Rows, seed: int) -> Matrix:
    """Probabilities of the classes ``[test item, class]``."""
    forest = ExtraTreesClassifier(TREES, random_state=seed).fit(x[train], y[train])
    out = np.zeros((len(test), int(y.max()) + 1))
    out[:, forest.classes_] = forest.predict_proba(x[test])
    return out


def svm(x: Matrix, y: Rows, train: Rows, test: Rows, seed: int) -> Matrix:
    """Probabilities of the classes ``[test item, class]``; every class needs two items in ``train``."""
    names = [str(code) for code in range(int(y.max()) + 1)]
    try:
        machine = fit_probabilistic(x[train], y[train], train, names, SVM, seed)
    except InputError:  # folds that keep groups together may put the few items of a class into one
        exact = StratifiedKFold(min(FOLDS, int(np.bincount(y[train]).min())), shuffle=True, random_state=seed)
        machine = fit_probabilistic(x[train], y[train], train, names, SVM, seed, exact)
    return machine.probability(x[test])


def of_known(make: Member, x: Matrix, y: Rows, train: Rows, test: Rows, seed: int) -> Matrix:
    """Probabilities of a member ``[test item, class]``; a class with a single item in ``train`` is not learned."""
    kept = train[np.bincount(y[train])[y[train]] > 1]
    known, code = np.unique(y[kept], return_inverse=True)
    local = np.zeros_like(y)
    local[kept] = code
    out = np.zeros((len(test), int(y.max()) + 1))
    out[:, known] = make(x, local, kept, test, seed)
    return out


def believe(words: Matrix, wrench: Matrix, y: Rows, train: Rows, test: Rows, seed: int) -> Matrix:
    """Probabilities of the vote ``[test item, class]``; a class with a single item in ``train`` is not learned."""
    rows = (y, train, test, seed)
    return (of_known(svm, words, *rows) + of_known(trees, wrench, *rows)) / 2


def summed(members: Sequence[tuple[Member, Matrix]], y: Rows) -> Any:
    """Members whose probabilities are added, as an estimator of :mod:`rcbht_jax.learning.validation`."""

    def predict(train: Rows, test: Rows, seed: int) -> tuple[Rows, dict[str, Any]]:
        return sum(of_known(make, x, y, train, test, seed) for make, x in members).argmax(1), {}

    return predict
