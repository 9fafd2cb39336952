"""A stream of messages through the resampler and the introspector, as events."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from rcbht_jax.encoding.stream import MOST_SAMPLES
from rcbht_jax.events import Event, Notice
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.resampling import Resampler
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Begin, Malformed, Message, Reset, Sample, Silence

LONGEST_PAUSE = 10.0  # s of waiting: beyond it the source's clock has jumped


class Session:
    """Feeds one source into one introspector; irregularities of the source become a :class:`Notice`.

    Args:
        introspector: with a model, or a :class:`rcbht_jax.introspection.words.WordIntrospector` for words alone, or
            several as a :class:`rcbht_jax.introspection.together.Together`.
        bridge: see :class:`rcbht_jax.introspection.resampling.Resampler`.

    Example:
        >>> from rcbht_jax.encoding.encoder import EncoderConfig
        >>> from rcbht_jax.encoding.thresholds import preset
        >>> session = Session(WordIntrospector(EncoderConfig(dt=0.01), preset("hiro", ["grip"]), ["grip"], ["N"]))
        >>> events = list(session.run(Sample((5.0 * (k > 101),), 0.01 * k) for k in range(200)))
        >>> [word.label for word in events + session.finish() if word.layer == "llb"]
        ['CT', 'FX']
    """

    def __init__(self, introspector: Introspector | WordIntrospector | Together, bridge: float | None = None) -> None:
        self.introspector = introspector
        self._axes = len(introspector.axes)
        self._grid = introspector.config.dt, bridge, self._axes
        self._resampler = Resampler(*self._grid)
        self.time = 0.0  # s, stamp of the latest sample
        self._silent = False
        self.counts: Counter[str] = Counter()  # messages by kind, readings left out or bridged by what was wrong

    def feed(self, message: Message) -> list[Event]:
        """The events that one message causes, in order."""
        if isinstance(message, Sample) and len(message.wrench) != self._axes:
            text = f"a reading has {len(message.wrench)} values; there are {self._axes} axes"
            message = Malformed(text)
        if not isinstance(message, Malformed):  # its notice counts it
            self.counts[type(message).__name__.lower()] += 1
        if isinstance(message, Sample):
            return self._sample(message)
        if isinstance(message, Begin):
            return self.introspector.begin()
        if isinstance(message, Reset):
            events = self.finish()
            self.introspector.reset()
            self._resampler = Resampler(*self._grid)
            return events
        if isinstance(message, Malformed):
            return [self._notice("malformed", message.text)]
        return self._silence(message)

    def _sample(self, sample: Sample) -> list[Event]:
        resampled = self._resampler.feed(sample)
        self.time = resampled.time
        events: list[Event] = []
        if self._silent and len(resampled.samples):
            self._silent = False
            events.append(self._notice("resumed", "readings arrive again"))
        events += [self._notice(report.kind, report.text, report.count) for report in resampled.reports]
        count = self.introspector.received + len(resampled.samples)
        if count > MOST_SAMPLES:
            events.append(self._notice("gap", f"{MOST_SAMPLES} samples were counted; everything starts anew"))
        if resampled.anew or count > MOST_SAMPLES:
            events += self.introspector.finish()
            self.introspector.reset()
        if len(resampled.samples):
            events += self.introspector.push(resampled.samples, resampled.time)
        return events

    def _silence(self, silence: Silence) -> list[Event]:
        if self._silent:
            return []
        self._silent = True
        return [self._notice("silent", f"no reading for {silence.seconds:g} s of wall time")]

    def _notice(self, kind: Any, text: str, count: int = 1) -> Notice:
        self.counts[kind] += count
        return Notice(self.introspector.received, self.time, kind, text, count)

    def finish(self) -> list[Event]:
        """Events of the end of the stream: what is left to report, and the words still held, if words are reported."""
        reports = [self._notice(report.kind, report.text, report.count) for report in self._resampler.finish()]
        return reports + self.introspector.finish()

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
