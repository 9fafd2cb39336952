"""Segmentation: a label for every sample of recordings, by models that were not trained on them, and its scores."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import plural
from rcbht_jax._util.selection import group_numbers
from rcbht_jax.errors import InputError
from rcbht_jax.features.trailing import decision_period
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.learning.class_groups import column_groups
from rcbht_jax.learning.segment_metrics import (
    UNKNOWN,
    SegmentationScore,
    Segments,
    score_and_interval,
)
from rcbht_jax.types import Recordings

with needs_extra("learn"):
    from sklearn.base import clone
    from sklearn.model_selection import GroupKFold


@dataclass(frozen=True)
class Protocol:
    """Which recordings are used for training and which are labelled.

    Attributes:
        track: of the annotations; "" = the usual one, see :meth:`rcbht_jax.annotations.Annotations.choose`.
        group: column whose groups stay together; trials of two sources are different ones.
        folds: of the groups; 0 = each group is held out by itself.
        one_shot: train on one recording and test on all of other groups, for every annotated recording in turn.
    """

    track: str = ""
    group: str = "trial"
    folds: int = 5
    one_shot: bool = False

    def folds_of(self, groups: NDArray[Any]) -> tuple[int, int]:
        """Number of folds of these groups, and number of groups."""
        count = len(np.unique(groups))
        return min(self.folds or count, count), count


@dataclass(frozen=True)
class Segmentation:
    """Labels of every sample, made by models that were not trained on the recording.

    Attributes:
        recordings: the labelled recordings.
        protocol: the protocol, with the name of the track that was used.
        classes: by code.
        predicted: class of each sample ``[sample]`` of each recording; with one shot, those of the last turn, and none
            of a recording of the only group that can be trained on.
        truth: the same from the annotations, UNKNOWN = not annotated.
        score: of the annotated recordings.
        interval: 95 % interval of every score, from groups drawn with replacement.
        model: trained on all annotated recordings; None = it was not needed.
    """

    recordings: Recordings
    protocol: Protocol
    classes: tuple[str, ...]
    predicted: list[NDArray[np.int64]]
    truth: list[NDArray[np.int64]]
    score: SegmentationScore
    interval: dict[str, tuple[float, float]]
    model: WrenchSegmenter | None = None

    @property
    def annotated(self) -> NDArray[np.bool_]:
        """Recordings with at least one annotated sample."""
        return np.array([(part != UNKNOWN).any() for part in self.truth], bool)

    def rows(self) -> list[tuple[int, str, str, str, str, float, float, bool]]:
        """A row per predicted interval: recording, source, trial, arm, label, start and end in s, annotated."""
        data, known = self.recordings, self.annotated.tolist()
        return [
            (row, str(data.source[row]), str(data.trial[row]), str(data.arm[row]), self.classes[code],
             round(start * data.dt, 6), round(end * data.dt, 6), known[row])
            for row, part in enumerate(map(Segments.of, self.predicted))
            for code, start, end in zip(part.label.tolist(), part.start.tolist(), part.end.tolist(), strict=True)
        ]  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Scores and a description of what was scored; None for a delay, or an interval, that there is not."""
        y = np.concatenate(self.truth)
        count, groups = self.protocol.folds_of(column_groups(self.protocol.group, self.recordings)[self.annotated])
        folds = f"{count} folds" if count < groups else "one group held out at a time"
        single = int((self.annotated & ~_trainable(_decided(self.truth, self.recordings.dt))).sum())
        besides = f", but not on {single} of a single class," if single else ","
        how = f"trained on one recording at a time{besides} tested on all others" if self.protocol.one_shot else folds
        return {
            "track": self.protocol.track,
            "classes": list(self.classes),
            "recordings": len(self.truth),
            "annotated": int(self.annotated.sum()),
            "protocol": f"{how}, grouped by {self.protocol.group}",
            "score": {name: _known(value) for name, value in self.score.to_json().items()},
            "interval": {name: [_known(end) for end in ends] for name, ends in self.interval.items()},
            "majority": float(np.bincount(y[y != UNKNOWN]).max() / (y != UNKNOWN).sum()),
        }


def segment(
    recordings: Recordings,
    segmenter: WrenchSegmenter,
    protocol: Protocol = Protocol(),
    progress: Callable[[int], Any] | None = None,
    keep: bool = False,
) -> Segmentation:
    """Label every recording by a model that was not trained on it, and score the annotated ones.

    Args:
        recordings: the data set; some or all recordings are annotated.
        segmenter: a copy is fitted for each part.
        protocol: how they are divided.
        progress: called with 1 after each model.
        keep: also train on all annotated recordings where none is left to label.

    Raises:
        InputError: no such track or column, fewer than two annotated groups, one fold, or a fold without which the
            others have a single class.
    """
    track, truth = _annotated(recordings, protocol)
    known = np.array([(part != UNKNOWN).any() for part in truth], bool)
    named = column_groups(protocol.group, recordings)
    groups = group_numbers(named)  # missing values, which are not equal, become one
    if len(np.unique(groups[known])) < 2:
        raise InputError(f"Only one {protocol.group} is annotated with {track}; another one is needed to test on.")

    def trained(rows: NDArray[np.int64]) -> WrenchSegmenter:
        return clone(segmenter).fit(recordings.take(rows), [truth[row] for row in rows])

    decided = _decided(truth, recordings.dt)
    trainable = _trainable(decided)
    if protocol.one_shot and not trainable.any():
        raise InputError(f"No recording has two classes of {track} at decisions, so none can be trained on alone.")
    turns: list[tuple[int, int, NDArray[np.int64]]] = []  # a training recording, the labelled recording, its labels
    splits = list(_splits(np.flatnonzero(known), groups, protocol))
    if not protocol.one_shot:
        for train, test in splits:  # before the first model: training takes long
            _check_classes([decided[row] for row in train], protocol.group, named[test])
    for train, test in splits:
        if protocol.one_shot and not trainable[train].any():
            continue
        labels = trained(train).predict(recordings.take(test))
        turns += [(int(train[0]), row, part) for row, part in zip(test.tolist(), labels, strict=True)]
        if progress:
            progress(1)
    new = np.flatnonzero(~known)
    whole = trained(np.flatnonzero(known)) if len(new) or keep else None
    found = {row: part for _, row, part in turns}
    if whole is not None and len(new):
        found |= dict(zip(new.tolist(), whole.predict(recordings.take(new)), strict=True))
    of_train, of_test, guesses = zip(*turns, strict=True)
    true = [truth[row] for row in of_test]
    # With several folds no group trains alone, so only the tested ones are drawn.
    drawn = groups[np.array([of_train, of_test] if protocol.one_shot else [of_test])].T
    return Segmentation(
        recordings,
        replace(protocol, track=track),
        recordings.annotations.labels[track],
        [found.get(row, np.zeros(0, np.int64)) for row in range(len(truth))],
        truth,
        *score_and_interval(true, guesses, recordings.dt, drawn),
        whole,
    )


def _known(value: float) -> float | None:
    """A number for JSON, which has no NaN."""
    return None if np.isnan(value) else value


def _annotated(recordings: Recordings, protocol: Protocol) -> tuple[str, list[NDArray[np.int64]]]:
    """The track, and the class of each sample of each recording by it."""
    if protocol.folds < 0 or protocol.folds == 1:
        raise InputError(f"The number of folds is {protocol.folds}; expected 2 or more, or 0 for one for each group.")
    track = recordings.annotations.choose(protocol.track)
    if not track:
        raise InputError("The store has no annotations; import it with annotations to learn from.")
    lengths = enumerate(recordings.length.tolist())
    return track, [recordings.annotations.of_samples(row, track, length, recordings.dt) for row, length in lengths]


def _decided(truth: Sequence[NDArray[np.int64]], dt: float) -> list[NDArray[np.int64]]:
    """The classes at the decisions, from which a segmenter learns."""
    return [part[:: decision_period(dt)] for part in truth]


def _trainable(decided: Sequence[NDArray[np.int64]]) -> NDArray[np.bool_]:
    """Recordings with two classes or more at the decisions."""
    return np.array([len(np.setdiff1d(part, [UNKNOWN])) > 1 for part in decided], bool)


def _check_classes(decided: Sequence[NDArray[np.int64]], group: str, held: NDArray[Any]) -> None:
    """Raise an error if the recordings that train in one turn, while others are held out, have a single class."""
    if (count := len(np.setdiff1d(np.concatenate(decided), [UNKNOWN]))) > 1:
        return
    names = list(dict.fromkeys(map(str, held.tolist())))
    listed = ", ".join(names[:5]) + ", ..." * (len(names) > 5)
    raise InputError(
        f"While {group} {listed} is held out, the labels of the others, {plural(len(decided), 'recording')}, have "
        f"{plural(count, 'class', 'classes')} at the decisions, one about every 25 ms; two are needed: choose another "
        "number of folds or another column of groups, or annotate more recordings."
    )


def _splits(rows: NDArray[np.int64], groups: NDArray[Any], protocol: Protocol) -> Iterator[tuple[Any, Any]]:
    """Training rows and rows to label, of each fold."""
    if protocol.one_shot:
        yield from ((np.array([row]), rows[groups[rows] != groups[row]]) for row in rows)
        return
    folds = GroupKFold(protocol.folds_of(groups[rows])[0], shuffle=True, random_state=0)
    yield from ((rows[train], rows[test]) for train, test in folds.split(rows, groups=groups[rows]))
