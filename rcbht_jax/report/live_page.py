"""The live page: one self-contained HTML document and a stream of frames, over HTTP from this machine only.

The server answers GET and HEAD of ``/``, ``/frames`` and ``/description`` and nothing else; it takes no input from
viewers. All its memory is bounded: the last frames, the number of viewers, the frames a slow viewer may lag behind, and
the time a connection may idle.
"""

from __future__ import annotations

import json
import queue
import threading
from collections import deque
from collections.abc import Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Message, Sample
from rcbht_jax.labels import ALPHABETS, COLORS, LAYERS, MEANING, name

HISTORY = 400  # frames that a new viewer gets at once
FRAME = 0.05  # s of stream per frame
VIEWERS = 16
IDLE = 10.0  # s until a connection that sends no request is closed
LOOPBACK = ("127.0.0.1", "localhost", "::1")

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"


def description(session: Session) -> dict[str, Any]:
    """Constants that a viewer needs to draw the frames."""
    return {
        "axes": session.introspector.model.axes,
        "units": session.introspector.model.units,
        "layers": LAYERS,
        "names": {layer: ["-"] + [name(layer, code) for code in alphabet] for layer, alphabet in _alphabets()},
        "meanings": {layer: ["nothing yet", *MEANING[layer]] for layer in LAYERS},
        "colors": {layer: ["#ffffff", *COLORS[layer]] for layer in LAYERS},
        "dt": session.introspector.model.encoder.dt,
        "heads": {head.name: head.classes for head in session.introspector.model.heads},
    }


def _alphabets() -> Iterable[tuple[str, range]]:
    return ((layer, range(1, len(alphabet) + 1)) for layer, alphabet in zip(LAYERS, ALPHABETS, strict=True))


class Broadcast:
    """Frames to any number of viewers up to ``VIEWERS``; a slow one loses frames, never the stream."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._history: deque[str] = deque(maxlen=HISTORY)
        self._viewers: list[queue.Queue[str | None]] = []

    def publish(self, frame: dict[str, Any]) -> None:
        """Send a frame to all viewers."""
        text = json.dumps(frame, allow_nan=False)
        with self._lock:
            self._history.append(text)
            for viewer in self._viewers:
                self._put(viewer, text)

    def close(self) -> None:
        """Signal the end of the stream to all viewers."""
        with self._lock:
            for viewer in self._viewers:
                self._put(viewer, None)

    @staticmethod
    def _put(viewer: queue.Queue[str | None], text: str | None) -> None:
        if viewer.full():
            viewer.get_nowait()
        viewer.put_nowait(text)

    def join(self) -> queue.Queue[str | None] | None:
        """A queue of frames that begins with the latest ones; None if there are already ``VIEWERS``."""
        with self._lock:
            if len(self._viewers) >= VIEWERS:
                return None
            viewer: queue.Queue[str | None] = queue.Queue(2 * HISTORY)
            for text in self._history:
                viewer.put_nowait(text)
            self._viewers.append(viewer)
            return viewer

    def leave(self, viewer: queue.Queue[str | None]) -> None:
        """Remove a viewer that has disconnected."""
        with self._lock:
            self._viewers = [other for other in self._viewers if other is not viewer]


class Frames:
    """Collects ``FRAME`` seconds of a stream into one frame."""

    def __init__(self, session: Session, broadcast: Broadcast) -> None:
        self._session, self._broadcast = session, broadcast
        self._samples: list[list[float]] = []
        self._events: list[dict[str, Any]] = []
        self._beliefs: dict[str, Any] = {}
        self._due = 0

    def feed(self, message: Message) -> list[Event]:
        """Feed a message to the session and return its events."""
        events = self._session.feed(message)
        if isinstance(message, Sample) and all(abs(v) < 1e7 for v in message.wrench):
            self._samples.append([round(self._session.time, 6), *(round(v, 5) for v in message.wrench)])
        for event in events:
            if isinstance(event, Belief):
                self._beliefs[event.head] = event.to_json()
            else:
                self._events.append(event.to_json())
        received = self._session.introspector.received
        if len(self._samples) >= 200 or len(self._events) >= 50 or not 0 <= received - self._due < self._size:
            self.flush()
            self._due = received
        return events

    @property
    def _size(self) -> int:
        return max(1, round(FRAME / self._session.introspector.model.encoder.dt))

    def flush(self) -> None:
        """Publish the frame collected so far."""
        introspector = self._session.introspector
        frame = {
            "sample": introspector.received,
            "time": self._session.time,
            "wrench": self._samples,
            "labels": introspector.labels.tolist(),
            "beliefs": self._beliefs,
            "events": self._events,
        }
        self._broadcast.publish(frame)
        self._samples, self._events, self._beliefs = [], [], {}


class _Handler(BaseHTTPRequestHandler):
    """Answers for :class:`PageServer`."""

    server: PageServer
    timeout = IDLE
    protocol_version = "HTTP/1.0"
    server_version, sys_version = "rcbht", ""

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def _answer(self, body: bool) -> None:
        path = self.path.split("?", 1)[0]
        # A page elsewhere must not read this one under a name of its own (DNS rebinding).
        if self.server.local and _host(self.headers.get("Host", "")) not in LOOPBACK:
            self.send_error(403, "Only this machine may look")
        elif path == "/":
            self._send(self.server.document, "text/html; charset=utf-8", body)
        elif path == "/description":
            self._send(self.server.description, "application/json", body)
        elif path == "/frames" and body:
            self._stream()
        else:
            self.send_error(404, "There is only /")

    def _head(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", _POLICY)

    def _send(self, content: bytes, kind: str, body: bool) -> None:
        self._head(kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if body:
            self.wfile.write(content)

    def _stream(self) -> None:
        viewer = self.server.broadcast.join()
        if viewer is None:
            self.send_error(503, "Too many viewers")
            return
        try:
            self._head("text/event-stream")
            self.end_headers()
            while True:
                try:
                    text = viewer.get(timeout=1.0)
                except queue.Empty:
                    self.wfile.write(b": still here\n\n")
                    continue
                self.wfile.write(b"event: end\ndata: 0\n\n" if text is None else f"data: {text}\n\n".encode())
                if text is None:
                    return
        except OSError:
            return  # the viewer has gone
        finally:
            self.server.broadcast.leave(viewer)

    def log_message(self, format: str, *args: Any) -> None:
        """Suppress the request log: standard error is for the user."""


def _host(value: str) -> str:
    """Name in a Host header, without the port."""
    if value.startswith("["):
        return value[1:].split("]", 1)[0]
    return value.rsplit(":", 1)[0] if ":" in value else value


class PageServer(ThreadingHTTPServer):
    """Serves the page of one session in the background; a context manager.

    Args:
        session: whose frames are shown.
        host: address to bind; anything but loopback lets others look.
        port: 0 = any free one, see :attr:`url`.

    Raises:
        InputError: the address cannot be bound.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.broadcast = Broadcast()
        self.local = host in LOOPBACK
        self.document = files("rcbht_jax.report").joinpath("live_page.html").read_bytes()
        self.description = json.dumps(description(session)).encode()
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"The page cannot be served at {host}:{port}: {error}; choose another --port.") from error
        self.url = f"http://{host}:{self.server_address[1]}/"

    def __enter__(self) -> PageServer:
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.broadcast.close()
        self.shutdown()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore viewers that disconnect or send malformed requests."""
