"""A segmenter as a reader of a stream: the class of the newest sample, about 40 times per second, as beliefs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rcbht_jax._util.signals import in_precision, numbers_of
from rcbht_jax._util.values import usable
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, stamp_of
from rcbht_jax.features.trailing import (
    WINDOWS,
    Course,
    LatestWords,
    RunningTotals,
    TrailingStatistics,
    decision_period,
    with_norms,
)
from rcbht_jax.introspection.alarms import Confidence
from rcbht_jax.introspection.reader import Reader
from rcbht_jax.introspection.segmenter_file import SegmenterFile

MARGIN = 0.05  # below the certainty, until which a belief stays certain


@dataclass(frozen=True)
class SegmenterHead:
    """What a viewer needs to know of a segmenter's answers."""

    name: str  # track of annotations
    classes: tuple[str, ...]
    alarm: str = ""
    alarm_level: float = 0.0


class SegmenterStream(Reader[Belief]):
    """Beliefs of a segmenter over a stream.

    They equal :meth:`rcbht_jax.introspection.segmenter.WrenchSegmenter.predict_proba`, but for words that a
    recording publishes only because it ends. :meth:`reset` begins the next recording.

    Args:
        file: a fitted segmenter.
        certainty: probability above which a belief counts as certain.

    Raises:
        InputError: the certainty is out of range.

    Example:
        >>> from rcbht_jax import Recordings
        >>> from rcbht_jax.introspection.segmenter import WrenchSegmenter
        >>> force = np.random.default_rng(0).normal(size=(4, 200, 1)) * 0.1
        >>> force[:, 100:] += 5
        >>> recordings = Recordings.from_arrays(force, rate=40, axes=["grip"], units=["N"])
        >>> segmenter = WrenchSegmenter(trees=10).fit(recordings, [np.arange(200) // 100] * 4)
        >>> stream = SegmenterStream(SegmenterFile.of(segmenter, "phase", ("free", "contact")))
        >>> [stream.push(part)[-1].label for part in np.array_split(force[0], 4)]
        ['free', 'free', 'contact', 'contact']
    """

    _fixed, _called = ("_file",), "The segmenter"

    def __init__(self, file: SegmenterFile, certainty: float = 0.7) -> None:
        self._file, self.axes, self.units, self.dt = file, file.axes, file.units, file.encoder.dt
        self.head = SegmenterHead(file.track, file.classes)
        self._every = decision_period(self.dt)
        self._encoder = Encoder(file.encoder, file.limits) if file.words else None
        self._confidence = Confidence(certainty, MARGIN)
        self.reset()

    def warm_up(self) -> None:
        """Compile the encoder now, instead of in the first :meth:`push`."""
        if self._encoder is not None:
            Encoder(self._file.encoder, self._file.limits).push(np.zeros((self._file.encoder.window, len(self.axes))))

    def reset(self) -> None:
        """Start a new recording."""
        self._received = 0
        self._statistics, self._totals = TrailingStatistics(self.dt, WINDOWS), RunningTotals()
        self._course = Course()
        self._words = LatestWords(len(self.axes))
        self._confidence.reset()
        if self._encoder is not None:
            self._encoder.restart()

    def _push(self, samples: Any, time: float | None) -> list[Belief]:
        """The beliefs."""
        chunk = in_precision(numbers_of(samples), np.float32)
        if chunk.ndim != 2 or chunk.shape[1] != len(self.axes) or not usable(chunk):
            raise InputError(f"Samples have shape {chunk.shape}; expected finite [time, {len(self.axes)}].")
        end = self._received + len(chunk)
        events = []
        while len(chunk):
            count = -self._received % self._every + 1  # until the next decision
            piece, chunk = chunk[:count], chunk[count:]
            row = self._row(piece)
            self._received += len(piece)
            if len(piece) == count:
                events.append(self._belief(row, stamp_of(self._received, end, time, self.dt)))
        return events

    def _row(self, piece: Float[np.ndarray, "time axis"]) -> Float[np.ndarray, "1 column"]:
        """What the first ensemble reads after these samples."""
        signal = with_norms(piece.astype(np.float64), self._file.units)
        parts = [self._statistics.push(signal)[-1:], self._totals.push(signal)[-1:]]
        if self._encoder is not None:
            for tracks in self._encoder.push(piece):
                self._words.take(tracks)
            parts.append(self._words.row(self._received + len(piece)))
        return np.concatenate(parts, 1)

    def _belief(self, row: Float[np.ndarray, "1 column"], time: float) -> Belief:
        first = self._file.first.probabilities(row)
        second = self._file.second.probabilities(np.concatenate([row, self._course.push(first)], 1))[0]
        best = int(second.argmax())
        label, probability = self.head.classes[best], float(second[best])
        level, since = self._confidence.update(label, probability, self._received * self.dt)
        return Belief(
            self._received, time, self.head.name, label, probability, level, since, self.head.classes,
            tuple(second.tolist()),
        )  # fmt: skip
