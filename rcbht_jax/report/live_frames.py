"""What the live page shows of a stream, in frames of a twentieth of a second, and how they reach its viewers."""

from __future__ import annotations

import json
import queue
import threading
from collections import deque
from collections.abc import Iterable
from typing import Any

from rcbht_jax.encoding.rules import config_fields
from rcbht_jax.events import AnomalyCleared, AnomalyRaised, AnomalyScore, Belief, Event, Word
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Message, Sample
from rcbht_jax.labels import COLORS, LAYERS, MEANING, name

HISTORY = 600  # frames that a new viewer gets at once
FRAME = 0.05  # s of stream per frame
GAP, DATE = 60.0, 1e5  # s after which a clock that goes on counts from 0 again; stamps beyond are dates
VIEWERS = 16


def alphabets(no_meaning: str, no_color: str) -> dict[str, Any]:
    """Names, meanings and colours of the labels of each layer by code, from code 0, which is no label."""
    return {
        "layers": LAYERS,
        "names": {layer: [name(layer, code) for code in range(len(MEANING[layer]) + 1)] for layer in LAYERS},
        "meanings": {layer: [no_meaning, *MEANING[layer]] for layer in LAYERS},
        "colors": {layer: [no_color, *COLORS[layer]] for layer in LAYERS},
    }


def description(session: Session) -> dict[str, Any]:
    """Constants that a viewer needs to draw the frames."""
    introspector = session.introspector
    return {
        "axes": introspector.axes,
        "rule": config_fields(introspector.config)["rule"],
        "believed": config_fields(introspector.believed)["rule"],
        "units": introspector.units,
        **alphabets("nothing yet", "#ffffff"),
        "dt": introspector.config.dt,
        "window": introspector.config.window,
        "heads": {head.name: head.classes for head in introspector.heads},
        "certainty": introspector.certainty,
        "alarms": {
            head.name: {"class": head.alarm, "level": head.alarm_level or introspector.certainty}
            for head in introspector.heads
            if head.alarm
        },
    }


def server_sent(kind: str, value: Any) -> bytes:
    """One server-sent event."""
    return f"event: {kind}\ndata: {json.dumps(value, allow_nan=False, separators=(',', ':'))}\n\n".encode()


class Broadcast:
    """Frames to any number of viewers up to ``VIEWERS``; a slow one loses frames, never the stream.

    A viewer first gets the latest ``about`` (what the frames mean) and ``status`` (what is being waited for), then the
    latest frames, each with its number, so that after a lost connection none is shown twice.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lasting: dict[str, bytes] = {}
        self._history: deque[bytes] = deque(maxlen=HISTORY)
        self._viewers: list[queue.Queue[bytes | None]] = []
        self._number = 0
        self._closed = False

    def publish(self, frame: dict[str, Any]) -> None:
        """Send a frame to all viewers."""
        with self._lock:
            self._number += 1
            packet = server_sent("frame", {"number": self._number, **frame})
            self._history.append(packet)
            self._send(packet)

    def announce(self, kind: str, value: Any) -> None:
        """Send a lasting message, in place of the former one of this kind, to present viewers and those to come."""
        packet = server_sent(kind, value)
        with self._lock:
            self._lasting[kind] = packet
            self._send(packet)

    def close(self) -> None:
        """Signal the end of the stream to all viewers; no viewer can join any more."""
        with self._lock:
            self._closed = True
            self._send(None)

    def _send(self, packet: bytes | None) -> None:
        for viewer in self._viewers:
            if viewer.full():
                viewer.get_nowait()
            viewer.put_nowait(packet)

    def join(self) -> queue.Queue[bytes | None] | None:
        """A queue of messages that begins with the latest ones; None if it is closed or there are ``VIEWERS``."""
        with self._lock:
            # A browser keeps spare connections, through which it would come back to a server that has been closed.
            if self._closed or len(self._viewers) >= VIEWERS:
                return None
            viewer: queue.Queue[bytes | None] = queue.Queue(2 * HISTORY)
            for packet in (*self._lasting.values(), *self._history):
                viewer.put_nowait(packet)
            self._viewers.append(viewer)
            return viewer

    def leave(self, viewer: queue.Queue[bytes | None]) -> None:
        """Remove a viewer that has disconnected."""
        with self._lock:
            self._viewers = [other for other in self._viewers if other is not viewer]


class Frames:
    """Collects ``FRAME`` seconds of a stream into one frame.

    Args:
        session: whose introspector reports words.
        broadcast: of the page's server.
    """

    def __init__(self, session: Session, broadcast: Broadcast) -> None:
        self._session, self._broadcast = session, broadcast
        axes = session.introspector.axes
        self._lane = {(layer, axis): (l, a) for l, layer in enumerate(LAYERS) for a, axis in enumerate(axes)}
        self._size = max(1, round(FRAME / session.introspector.config.dt))
        self._samples, self._words, self._scores = list[list[float]](), list[list[float]](), list[list[float]]()
        self._events, self._beliefs = list[dict[str, Any]](), list[dict[str, Any]]()
        self._received, self._sent, self._time = 0, 0, session.time  # samples, s
        self._trial, self._begins, self._base = 0, True, 0.0  # base: stamp shown as 0; not 0 for dates
        self._raised: set[str] = set()  # classifiers whose alarm stands

    def feed(self, message: Message) -> list[Event]:
        """Feed a message to the session and return its events."""
        before, when = self._received, self._time
        events = self._session.feed(message)
        self._received, self._time = self._session.taken, self._session.time
        ended = self._session.ended
        if ended is not None:  # the words that end the former trial
            self._take(events[:ended])
            self._publish(before, when, [])
            self._trial, self._begins = self._trial + 1, True
            self._raised.clear()
        self._take(events[ended or 0 :])
        # One reading at most for each sample of the encoder: those left out, or between samples, are not shown.
        if isinstance(message, Sample) and (ended is not None or self._received > before):
            if self._begins and not (self._trial and when < self._time < when + GAP):
                self._base = self._time if abs(self._time) > DATE else 0.0
            self._begins = False
            self._samples.append([round(self._session.time, 6), *(float(f"{value:.7g}") for value in message.wrench)])
        waiting = bool(self._events) and not isinstance(message, Sample)  # such as silence: no sample may follow
        due = self._received - self._sent >= self._size
        if waiting or due or len(self._samples) >= 200 or len(self._events) >= 50:
            self.flush()
        return events

    def _take(self, events: Iterable[Event]) -> None:
        for event in events:
            if isinstance(event, Word):
                self._words.append(self._packed(event))
            elif isinstance(event, Belief):
                self._beliefs.append(event.to_json())
            elif isinstance(event, AnomalyScore):
                self._scores.append([round(event.time, 6), round(event.score, 6), event.threshold])
            else:
                self._events.append(event.to_json())
            if isinstance(event, AnomalyRaised | AnomalyCleared):
                (self._raised.add if isinstance(event, AnomalyRaised) else self._raised.discard)(event.head)

    def _packed(self, word: Word) -> list[float]:
        return [*self._lane[word.layer, word.axis], word.code, round(word.start, 6), round(word.stop, 6)]

    def flush(self) -> None:
        """Publish the frame collected so far, with the words that are provisional now."""
        held = self._session.introspector.provisional() if self._session.introspector.received else []
        self._publish(self._received, self._time, [self._packed(word) for word in held])

    def finish(self) -> None:
        """Publish the end of the stream: what was provisional is published now."""
        self._take(self._session.finish())
        self._publish(self._received, self._time, [])

    def _publish(self, sample: int, time: float, provisional: list[list[float]]) -> None:
        frame = {
            "sample": sample, "time": round(time, 6), "trial": self._trial, "wrench": self._samples,
            "words": self._words, "provisional": provisional, "beliefs": self._beliefs, "events": self._events,
            "base": round(self._base, 6), "raised": sorted(self._raised), "scores": self._scores,
        }  # fmt: skip
        self._broadcast.publish(frame)
        self._samples, self._words, self._scores, self._events, self._beliefs = [], [], [], [], []
        self._sent = self._received
