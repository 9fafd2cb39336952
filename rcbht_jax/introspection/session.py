"""A stream of messages through the resampler and the introspector, as events."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural
from rcbht_jax._util.values import Copyable
from rcbht_jax.encoding.stream import MOST_SAMPLES
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event, Notice, TrialStarted
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.resampling import Resampler
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Begin, Malformed, Message, Reset, Sample
from rcbht_jax.io.tare import bias_of

Floats = NDArray[np.floating[Any]]
LONGEST_TARE = 600.0  # s, which are held in memory
LONGEST_PAUSE = 10.0  # s of waiting: beyond it the source's clock has jumped


class Tare(Copyable):
    """The tare of one trial: holds its first samples until their mean is known, and subtracts that from all.

    Args:
        samples: to average; 0 = nothing is held or subtracted.

    Example:
        >>> tare = Tare(2)
        >>> tare.tared(np.array([[1.0]])), tare.tared(np.array([[3.0], [5.0]]))[0].tolist()
        ([], [[-1.0], [1.0], [3.0]])
    """

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self._held: list[list[Floats]] = [[]]  # [part][piece][time, axis]; a sub-task begins with each later part
        self.labels = [""]  # of the sub-task that begins with each part
        self.count = 0  # samples that are held
        self._mean: Floats | None = None if samples else np.zeros(1, np.float32)

    def begins(self, label: str = "") -> bool:
        """Note that a sub-task begins with the next sample, if there are samples held before it."""
        if self._mean is not None or not self.count:
            return False
        self._held.append([])
        self.labels.append(label)
        return True

    def tared(self, samples: Floats) -> list[Floats]:
        """The samples ``[time, axis]``, after those that were held, in parts; nothing as long as they are held."""
        if self._mean is not None:
            return [samples - self._mean] if self.samples else [samples]
        self._held[-1].append(samples)
        self.count += len(samples)
        return self.release() if self.count >= self.samples else []

    def release(self) -> list[Floats]:
        """All samples that are held, in parts, by the mean of as many as there are."""
        if self._mean is not None or not self.count:
            return []
        none = self._held[0][0][:0]
        parts = [np.concatenate([none, *pieces]) for pieces in self._held]
        self._mean, self._held, self.count = bias_of(np.concatenate(parts)[: self.samples]), [[]], 0
        return [part - self._mean for part in parts]


class Session(Copyable):
    """Feeds one source into one introspector; irregularities of the source become a :class:`Notice`.

    Args:
        introspector: with a model, or a :class:`rcbht_jax.introspection.words.WordIntrospector` for words alone, or
            several as a :class:`rcbht_jax.introspection.together.Together`.
        bridge: see :class:`rcbht_jax.introspection.resampling.Resampler`.
        tare: s at the beginning of each trial, whose mean is subtracted from all its samples; what is received
            meanwhile is processed at their end. 0 = nothing is subtracted.

    Raises:
        InputError: a tare out of range.

    Example:
        >>> from rcbht_jax.encoding.encoder import EncoderConfig
        >>> from rcbht_jax.encoding.thresholds import preset
        >>> session = Session(WordIntrospector(EncoderConfig(dt=0.01), preset("hiro", ["grip"]), ["grip"], ["N"]))
        >>> events = list(session.run(Sample((5.0 * (k > 101),), 0.01 * k) for k in range(200)))
        >>> [word.label for word in events + session.finish() if word.layer == "llb"]
        ['CT', 'FX']
    """

    def __init__(
        self,
        introspector: Introspector | WordIntrospector | Together,
        bridge: float | None = None,
        tare: float = 0.0,
    ) -> None:
        if not 0 <= tare <= LONGEST_TARE:
            raise InputError(f"The tare is {tare} s; expected 0 to {LONGEST_TARE:g}.")
        self.introspector = introspector
        self._tare = Tare(max(1, round(tare / introspector.config.dt)) if tare else 0)
        self._axes = len(introspector.axes)
        self._grid = introspector.config.dt, bridge, self._axes
        self._resampler = Resampler(*self._grid)
        self.time = 0.0  # s, stamp of the latest sample
        # Events of the latest message that end what was received before it; None = it goes on.
        self.ended: int | None = None
        self._silent = False
        self._end = math.inf  # s, stamp of the last sample before the latest gap of the trial
        self._begun = False  # the trial has a sample; until then:
        self._reset: Reset | None = None  # what began the trial
        self._begin: Begin | None = None  # what begins its first sub-task
        self.counts: Counter[str] = Counter()  # messages by kind, readings left out or bridged by what was wrong

    @property
    def taken(self) -> int:
        """Samples of this trial so far: those that the introspector has received, or that the tare holds."""
        return self.introspector.received + self._tare.count

    def feed(self, message: Message) -> list[Event]:
        """The events that one message causes, in order."""
        self.ended = None
        if isinstance(message, Sample) and len(message.wrench) != self._axes:
            text = f"a reading has {plural(len(message.wrench), 'value')}; expected {self._axes}, one for each axis"
            message = Malformed(text)
        if not isinstance(message, Malformed):  # its notice counts it
            self.counts[type(message).__name__.lower()] += 1
        if isinstance(message, Sample):
            return self._sample(message)
        if isinstance(message, Begin):
            if not self._begun:
                self._begin = message
                return []
            return [] if self._tare.begins(message.label) else self.introspector.begin(message.label)
        if isinstance(message, Reset):
            events = self.finish() + self.introspector.reset()
            self.ended = len(events) if self._begun else None
            self._resampler, self._tare = Resampler(*self._grid), Tare(self._tare.samples)
            self._reset, self._begin, self._begun, self._end = message, None, False, math.inf
            return events
        if isinstance(message, Malformed):
            return [self._notice("malformed", message.text)]
        if self._silent:
            return []
        self._silent = True
        return [self._notice("silent", f"no reading for {message.seconds:g} s of wall time")]

    def _sample(self, sample: Sample) -> list[Event]:
        resampled, before = self._resampler.feed(sample), self.time
        self.time = resampled.time
        events: list[Event] = []
        if not self._begun and len(resampled.samples):
            events += self._started()
        if self._silent and len(resampled.samples):
            self._silent = False
            events.append(self._notice("resumed", "readings arrive again"))
        events += [self._notice(report.kind, report.text, report.count) for report in resampled.reports]
        count = self.introspector.received + len(resampled.samples)
        if count > MOST_SAMPLES:
            events.append(self._notice("gap", f"{MOST_SAMPLES} samples were counted; everything starts anew"))
        if resampled.anew or count > MOST_SAMPLES:
            self._end = before if self.taken > 1 else self._end  # a single sample had a stray stamp
            events += self._push(self._tare.release(), before) + self.introspector.finish()
            events += self.introspector.reset()  # not of the tare: after a gap the arm may be in contact
            self.ended = len(events)
            if isinstance(self.introspector, Together) and self.time > self._end:  # else the source began anew
                self.introspector.wait()
        if len(resampled.samples):
            events += self._push(self._tare.tared(resampled.samples), resampled.time)
        return events

    def _started(self) -> list[Event]:
        """What begins with the first sample of a trial, with the stamp of that."""
        events: list[Event] = [] if self._reset is None else [TrialStarted(0, self.time, self._reset.trial)]
        if self._begin is not None:
            events += [replace(event, time=self.time) for event in self.introspector.begin(self._begin.label)]
        self._begun, self._reset, self._begin = True, None, None
        return events

    def _push(self, parts: list[Floats], time: float) -> list[Event]:
        """Push samples whose last one has this stamp; a sub-task begins between two parts."""
        events: list[Event] = []
        later = sum(map(len, parts))
        for number, part in enumerate(parts):
            events += self.introspector.begin(self._tare.labels[number]) if number else []
            later -= len(part)
            if len(part):
                events += self.introspector.push(part, time - later * self.introspector.config.dt)
        return events

    def _notice(self, kind: Any, text: str, count: int = 1) -> Notice:
        self.counts[kind] += count
        return Notice(self.introspector.received, self.time, kind, text, count)

    def finish(self) -> list[Event]:
        """Events at the end of the stream: remaining notices, and the words still held, if words are reported."""
        reports = [self._notice(report.kind, report.text, report.count) for report in self._resampler.finish()]
        return reports + self._push(self._tare.release(), self.time) + self.introspector.finish()

    def run(self, messages: Iterable[Message]) -> Iterator[Event]:
        """Events of all messages."""
        for message in messages:
            yield from self.feed(message)


def paced(
    messages: Iterable[Message],
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Message]:
    """The messages of a recording at ``speed`` times the pace of their time stamps; 0 = as fast as possible.

    Each trial has a pace of its own. A clock that jumps ahead or back is not waited for.
    """
    began, first = clock(), None
    for message in messages:
        if isinstance(message, Reset):
            first = None
        if speed > 0 and isinstance(message, Sample) and message.time is not None and math.isfinite(message.time):
            wait = 0.0 if first is None else (message.time - first) / speed - (clock() - began)
            if first is None or not -LONGEST_PAUSE < wait < LONGEST_PAUSE:
                began, first = clock(), message.time
            elif wait > 0:
                sleep(wait)
        yield message
