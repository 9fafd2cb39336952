"""A segmenter: labels every sample of recordings whose intervals are unknown.

Two ensembles of extremely randomised trees (Geurts et al. 2006) in series. The first reads the wrench and its words in
windows that end at the sample. The second reads the same and the beliefs of the first until then; it is trained on
beliefs about recordings that the first was not trained on (stacked sequential learning, Cohen and Carvalho 2005).
If there are few recordings, copies at other speeds and forces are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import plural
from rcbht_jax._util.values import expect
from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, config_of, limits_for
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.features.trailing import (
    WINDOWS,
    Course,
    RunningTotals,
    decision_period,
    latest_words,
    trailing_statistics,
    with_norms,
)
from rcbht_jax.labels import LAYERS
from rcbht_jax.learning.segment_metrics import UNKNOWN
from rcbht_jax.types import Recordings

with needs_extra("learn"):
    from sklearn.base import BaseEstimator, clone
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.model_selection import GroupKFold
    from sklearn.utils.validation import check_is_fitted

ENOUGH = 8  # recordings; fewer are completed by copies
SPREAD = 0.3  # copies differ in speed and force by factors of exp(-SPREAD) to exp(SPREAD)
FOLDS = 4  # in which the first ensemble forms beliefs about recordings that it was not trained on

Tables = list[NDArray[np.float64]]  # [moment, column] of each recording


@dataclass(kw_only=True, eq=False, repr=False)
class WrenchSegmenter(BaseEstimator):  # type: ignore[misc]
    """Labels every sample of recordings.

    Args:
        words: also use the newest published words of each axis.
        offline: use later samples as well; by default no label depends on samples after it.
        trees: number of trees in each ensemble.
        window: samples per straight-line fit of the words.
        random_state: seed of trees, folds and copies.
        rule: of the words, ``"paper"`` or ``"fit"`` (docs/fit_rule.md).
        tolerance: for the fit rule, in the units of the axes: a number, or one for each axis; ``"auto"`` = from the
            recordings of ``fit``.

    Attributes:
        classes_: sorted class indices; one without a sample at a decision, about every 25 ms, is never believed.
        axes_: names of the axes and their units.
        thresholds_: gradient thresholds of the words.
        tolerance_: tolerances ``[axis]`` of the words; None by the paper's rule.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force = rng.normal(size=(4, 200, 1)) * 0.1
        >>> force[:, 100:] += 5
        >>> recordings = Recordings.from_arrays(force, rate=40, axes=["grip"], units=["N"])
        >>> y = [np.arange(200) // 100] * 4
        >>> segmenter = WrenchSegmenter(trees=10).fit(recordings.take(np.arange(3)), y[:3])
        >>> float((segmenter.predict(recordings.take(np.array([3])))[0] == y[3]).mean()) > 0.97
        True
    """

    words: Any = True
    offline: Any = False
    trees: Any = 100
    window: Any = 5
    random_state: Any = 0
    rule: Any = "paper"
    tolerance: Any = "auto"

    def fit(self, recordings: Recordings, y: Sequence[NDArray[Any]]) -> WrenchSegmenter:
        """Learn from annotated recordings.

        Args:
            recordings: one row per recording, of any axes.
            y: class of each sample of each recording; UNKNOWN = not annotated. Recordings without an annotated
                decision set the limits of the words, and train nothing else.

        Raises:
            InputError: fewer than two classes in all or at the decisions, labels whose lengths differ from the
                recordings', an unknown rule, or a tolerance that does not fit the axes or the rule.
        """
        expect("The data set", recordings, Recordings)
        if [np.shape(part) for part in y] != [(count,) for count in recordings.length.tolist()]:
            raise InputError("The labels in y have other lengths than the recordings; expected a class per sample.")
        classes = np.setdiff1d(np.concatenate(y), [UNKNOWN])
        if len(classes) < 2:
            count = plural(len(classes), "class", "classes")
            raise InputError(f"The labels of {plural(len(y), 'recording')} have {count}; two are needed.")
        fitted = clone(self)._fitted(recordings, y, classes)  # a fit that fails leaves what was fitted before
        self.__dict__.update(vars(fitted))
        return self

    def _fitted(self, recordings: Recordings, y: Sequence[NDArray[Any]], classes: NDArray[Any]) -> WrenchSegmenter:
        self.classes_ = classes
        self.axes_, self._dt = (recordings.axes, recordings.units), recordings.dt
        config = config_of(self.rule, self.window, recordings.dt)
        self.thresholds_ = auto_thresholds(recordings, self.window, self.rule)
        self._limits = limits_for(config, self.thresholds_, self.tolerance, recordings.wrench, recordings.length)
        self.tolerance_ = np.asarray(self._limits.tolerance) if isinstance(self._limits, FitLimits) else None
        rng = np.random.default_rng(self.random_state)
        every = decision_period(recordings.dt)
        decided = [np.setdiff1d(np.asarray(part)[::every], [UNKNOWN]) for part in y]
        if (count := len(np.unique(np.concatenate(decided)))) < 2:
            found = plural(count, "class", "classes")
            raise InputError(
                f"At the decisions, one in {plural(every, 'sample')}, the labels have {found}; two are needed."
            )
        trained = np.flatnonzero([len(part) > 0 for part in decided])
        completed, labels, group = _completed(recordings.take(trained), [y[row] for row in trained.tolist()], rng)
        tables = self._tables(completed)
        labels = [part[::every] for part in labels]
        self.first_ = self._learn(tables, labels)
        beliefs = self._held_out_beliefs(tables, labels, group)
        both = [np.concatenate([table, self._course(p)], 1) for table, p in zip(tables, beliefs, strict=True)]
        self.second_ = self._learn(both, labels)
        return self

    def predict_proba(self, recordings: Recordings) -> Tables:
        """Probability of each class ``[sample, class]`` of each recording.

        Raises:
            InputError: recordings whose axes, units or rate differ from those in :meth:`fit`.
        """
        check_is_fitted(self, "second_")
        expect("The data set", recordings, Recordings)
        # units that are not stated count too: norms are of the axes of one unit
        if (recordings.axes, recordings.units) != self.axes_ or not np.isclose(recordings.dt, self._dt):
            raise InputError(
                f"The recordings have {', '.join(recordings.axes)} in {', '.join(recordings.units)} at "
                f"{1 / recordings.dt:g} Hz; the segmenter learned {', '.join(self.axes_[0])} in "
                f"{', '.join(self.axes_[1])} at {1 / self._dt:g} Hz."
            )
        every = decision_period(recordings.dt)
        out = []
        for table, length in zip(self._tables(recordings), recordings.length.tolist(), strict=True):
            believed = self._believe(self.first_, table)
            second = self._believe(self.second_, np.concatenate([table, self._course(believed)], 1))
            out.append(np.repeat(second, every, axis=0)[:length])
        return out

    def predict(self, recordings: Recordings) -> list[NDArray[np.int64]]:
        """Class of each sample of each recording."""
        return [self.classes_[part.argmax(1)] for part in self.predict_proba(recordings)]

    def encoder(self) -> tuple[AnyConfig, AnyLimits]:
        """Options and limits of the encoder of the words.

        Raises:
            NotFittedError: of scikit-learn.
        """
        check_is_fitted(self, "second_")
        return config_of(self.rule, self.window, self._dt), self._limits

    def _learn(self, tables: Tables, labels: Sequence[NDArray[Any]]) -> Any:
        x, y = np.concatenate(tables), np.concatenate(labels)
        forest = ExtraTreesClassifier(self.trees, min_samples_leaf=3, random_state=self.random_state)
        return forest.fit(x[y != UNKNOWN], y[y != UNKNOWN])

    def _believe(self, forest: Any, table: Float[np.ndarray, "moment column"]) -> Float[np.ndarray, "moment class"]:
        """Probabilities in the order of ``classes_``; a fold may lack a class."""
        out = np.zeros((len(table), len(self.classes_)))
        out[:, np.searchsorted(self.classes_, forest.classes_)] = forest.predict_proba(table)
        return out

    def _held_out_beliefs(self, tables: Tables, labels: Sequence[NDArray[Any]], group: NDArray[Any]) -> Tables:
        folds = min(FOLDS, len(np.unique(group)))
        out: Tables = [np.zeros((0, 0))] * len(tables)
        for train, test in GroupKFold(folds).split(group, groups=group):
            forest = self._learn([tables[i] for i in train], [labels[i] for i in train])
            for i in test:
                out[i] = self._believe(forest, tables[i])
        return out

    def _tables(self, recordings: Recordings) -> Tables:
        """Features of each recording for the first ensemble, one row per decision."""
        dt, every = recordings.dt, decision_period(recordings.dt)
        words = self._words(recordings, every) if self.words else [np.zeros((0, 0))] * len(recordings)
        tables = []
        for values, length, word in zip(recordings.wrench, recordings.length.tolist(), words, strict=True):
            signal = with_norms(values[:length].astype(np.float64), recordings.units)
            make = partial(trailing_statistics, dt=dt, windows=WINDOWS)
            parts = [make(signal)[::every], RunningTotals().push(signal)[::every]]
            if self.offline:
                parts.append(make(signal[::-1])[::-1][::every])
            tables.append(np.concatenate([*parts, word] if self.words else parts, 1))
        return tables

    def _words(self, recordings: Recordings, every: int) -> Tables:
        config = config_of(self.rule, self.window, recordings.dt)
        tracks = encode_batch(config, self._limits, recordings.wrench, recordings.length)
        out = []
        for row, length in enumerate(recordings.length.tolist()):
            times = np.arange(1, length + 1)[::every]
            layers = [jax.tree.map(lambda values: values[row], getattr(tracks, layer)) for layer in LAYERS]  # noqa: B023
            out.append(np.concatenate([latest_words(layer, times) for layer in layers], 1))
        return out

    def _course(self, belief: Float[np.ndarray, "moment class"]) -> Float[np.ndarray, "moment column"]:
        """Beliefs of the first ensemble until each decision; with ``offline``, also of later ones."""
        sides = [Course().push(belief)]
        if self.offline:
            sides.append(Course().push(belief[::-1])[::-1])
        return np.concatenate(sides, 1)


def _completed(
    recordings: Recordings, y: Sequence[NDArray[Any]], rng: np.random.Generator
) -> tuple[Recordings, list[NDArray[Any]], NDArray[np.int64]]:
    """The recordings and copies of them, the labels of all, and the group of each in a fold.

    Copies of a single recording are groups of their own: there is nothing else to hold out.
    """
    count = len(recordings)
    rows = [*range(count), *rng.permutation(np.resize(np.arange(count), max(0, ENOUGH - count))).tolist()]
    parts, labels = [], []
    for number, row in enumerate(rows):
        values, label = recordings.wrench[row, : recordings.length[row]], np.asarray(y[row])
        if number >= count:
            values, label = _copy(values, label, recordings.units, rng)
        parts.append(values)
        labels.append(label)
    made = Recordings.from_arrays(parts, rate=1 / recordings.dt, axes=recordings.axes, units=recordings.units)
    return made, labels, np.arange(len(rows)) if count == 1 else np.array(rows)


def _copy(
    values: NDArray[Any], label: NDArray[Any], units: Sequence[str], rng: np.random.Generator
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A recording at another speed, with another factor for the axes of each unit."""
    speed = np.exp(rng.uniform(-SPREAD, SPREAD))
    factor = {unit: np.exp(rng.uniform(-SPREAD, SPREAD)) for unit in dict.fromkeys(units)}
    time = np.arange(len(values))
    at = np.minimum(np.arange(max(2, int(len(values) / speed))) * speed, len(values) - 1)
    moved = np.stack([np.interp(at, time, column) for column in values.T], 1)
    return moved * np.array([factor[unit] for unit in units]), label[np.rint(at).astype(int)]
