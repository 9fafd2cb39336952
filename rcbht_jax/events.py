"""Events of an introspector: frozen, typed, each a plain JSON object as well."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rcbht_jax.errors import InputError

Level = Literal["inadmissible", "uncertain", "certain"]
LEVELS: tuple[Level, ...] = ("inadmissible", "uncertain", "certain")


def stamp_before(stamp: float, samples: int, dt: float) -> float:
    """Time stamp of the sample so many before the one with this stamp, s.

    Rounded to what stamps hold, a nanosecond or of dates a microsecond, so that it does not depend on which later
    sample brought the stamp, nor on whether it is its own. Doubles resolve dates to a quarter of a microsecond: where
    samples are not whole microseconds apart, the last digit may differ.

    >>> stamp_before(0.12, 20, 0.005), stamp_before(1.7e9, -1, 0.005), stamp_before(1 / 240, 0, 1 / 240)
    (0.02, 1700000000.005, 0.004166667)
    """
    return round(stamp - samples * dt, 9 if abs(stamp) < 1e6 else 6) + 0.0


def stamp_of(sample: int, received: int, stamp: float | None, dt: float) -> float:
    """Time stamp of the latest of ``sample`` samples, s, where that of the latest of ``received`` is ``stamp``.

    None = there are no stamps: samples x period, which does not depend on ``received``.

    >>> stamp_of(1, 50, None, 1 / 240), stamp_of(480, 500, 7.0, 0.005)
    (0.004166667, 6.9)
    """
    return round(sample * dt, 9) if stamp is None else stamp_before(stamp, received - sample, dt)


@dataclass(frozen=True)
class Event:
    """An event that is known after ``sample`` samples."""

    sample: int  # samples received when it was known
    time: float  # s, the time stamp of the latest of them (samples x period where the source has none)

    def to_json(self) -> dict[str, Any]:
        """The event as JSON values; ``event`` is the name of its class."""
        return {"event": type(self).__name__, **asdict(self)}


@dataclass(frozen=True)
class TrialStarted(Event):
    """A trial began with the next sample, whose stamp is ``time``; what was before it is forgotten."""

    trial: str  # its name; "" = it has none


@dataclass(frozen=True)
class SubtaskStarted(Event):
    """A sub-task began at ``begin``: announced by the controller, or detected."""

    begin: int  # sample
    detected: bool
    label: str = ""  # its name; "" = not known


@dataclass(frozen=True)
class Belief(Event):
    """The answer of one classifier of the model."""

    head: str
    label: str  # the likeliest class
    probability: float  # of it
    level: Level  # inadmissible below 0.5, certain above the threshold, with hysteresis
    certain_for: float  # s since the level has been certain with the same label; 0 while it is not
    classes: tuple[str, ...]
    probabilities: tuple[float, ...]  # [class]


@dataclass(frozen=True)
class AnomalyScore(Event):
    """How the last moments differ from nominal recordings, by a nominal monitor."""

    score: float
    threshold: float  # of the alarm
    p_value: float  # conformal: about the share of nominal recordings whose highest score is at least as high


@dataclass(frozen=True)
class Word(Event):
    """A label of one axis that the encoder has published; it will not change any more."""

    layer: str  # primitive, mc or llb
    axis: str
    label: str
    code: int  # of the label in its layer's alphabet, see rcbht_jax.labels
    begin: int  # first sample
    end: int  # sample after the last
    start: float  # s, the time stamp of the first sample
    stop: float  # s, that of the sample after the last


@dataclass(frozen=True)
class ProvisionalWord(Event):
    """A label of one axis that still runs: reported from its second window on, and again whenever it changes."""

    layer: str  # primitive, mc or llb
    axis: str
    label: str
    code: int
    begin: int  # first sample
    start: float  # s, the time stamp of the first sample
    revision: int  # how often the label has changed since it was first reported


@dataclass(frozen=True)
class Snap(Event):
    """A force that was released within a fraction of a second; reported when seen, and again when published."""

    axis: str
    begin: int  # first sample of the fall
    start: float  # s, its time stamp
    release: float  # N or Nm, value from which it falls
    fall: float  # N or Nm, how far it is known to have fallen, > 0
    seen: float  # s, time stamp of the latest sample when it was first seen
    published: float | None  # s, the same when it was published; None = it still runs, and may be withdrawn in silence


@dataclass(frozen=True)
class AnomalyRaised(Event):
    """The abnormal class has been certain for the hold time, or the score of a monitor exceeds its threshold."""

    head: str  # of the model; "monitor" = a nominal monitor
    probability: float  # of the class; of a monitor 1 - p-value, which is not the probability of an anomaly


@dataclass(frozen=True)
class AnomalyCleared(Event):
    """The abnormal class has fallen below the clearing threshold, or the score below its own, for the hold time."""

    head: str
    probability: float


@dataclass(frozen=True)
class FailureType(Event):
    """The likeliest type of failure while an anomaly lasts; repeated whenever the type or its level changes."""

    label: str
    probability: float
    level: Level


@dataclass(frozen=True)
class Notice(Event):
    """An irregularity of the stream itself."""

    kind: Literal["gap", "late", "repeated", "not-finite", "malformed", "jitter", "faster", "silent", "resumed"]
    text: str
    count: int = 1  # samples or messages concerned


Callback = Callable[[Event], None]


class EventHub:
    """Hands events on to callbacks and to asyncio iterators.

    Example:
        hub = EventHub()
        hub.subscribe(print, AnomalyRaised)
        async for event in hub.events(Belief): ...
    """

    def __init__(self, backlog: int = 10_000) -> None:
        self._callbacks: list[tuple[Callback, tuple[type[Event], ...]]] = []
        self._queues: list[tuple[asyncio.Queue[Event | None], tuple[type[Event], ...]]] = []
        self._backlog = backlog
        self._closed = False
        self.dropped = 0  # events that a slow iterator lost, oldest first

    def subscribe(self, callback: Callback, *kinds: type[Event]) -> Callable[[], None]:
        """Call ``callback`` with every event of these types (none = all); returns a function that unsubscribes."""
        entry = (callback, kinds or (Event,))
        self._callbacks.append(entry)

        def end() -> None:
            if entry in self._callbacks:
                self._callbacks.remove(entry)

        return end

    def publish(self, events: Iterable[Event]) -> None:
        """Hand events on, in order; from the thread of the event loop if iterators are used."""
        for event in events:
            for callback, kinds in tuple(self._callbacks):
                if isinstance(event, kinds):
                    callback(event)
            for queue, kinds in self._queues:
                if isinstance(event, kinds):
                    if queue.qsize() >= self._backlog:  # a reader that sleeps must not make the robot's memory grow
                        queue.get_nowait()
                        self.dropped += 1
                    queue.put_nowait(event)

    def close(self) -> None:
        """End all iterators once they have read what is left, and later ones at once; callbacks are still called."""
        self._closed = True
        for queue, _ in self._queues:
            queue.put_nowait(None)
        self._queues = []  # nothing comes after the end

    def events(self, *kinds: type[Event]) -> AsyncIterator[Event]:
        """Events of these types (none = all) from now on; ends with :meth:`close`."""
        if self._backlog < 1:
            raise InputError(f"a backlog of {self._backlog} events cannot be iterated; at least one is needed.")
        queue: asyncio.Queue[Event | None] = asyncio.Queue()  # of backlog events at most, and the end
        entry = (queue, kinds or (Event,))
        if self._closed:
            queue.put_nowait(None)
        else:
            self._queues.append(entry)
        return self._iterate(entry)

    async def _iterate(
        self, entry: tuple[asyncio.Queue[Event | None], tuple[type[Event], ...]]
    ) -> AsyncIterator[Event]:
        try:
            while (event := await entry[0].get()) is not None:
                yield event
        finally:
            if entry in self._queues:
                self._queues.remove(entry)
