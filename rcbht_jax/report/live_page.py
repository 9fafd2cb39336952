"""The live page: one self-contained HTML document and a stream of frames, over HTTP from this machine only.

The server answers GET of ``/`` and ``/frames`` and nothing else; it takes no input from viewers. All its memory is
bounded: the last frames, the number of viewers, the frames a slow viewer may lag behind, and the time a connection may
idle. It may be opened before anything is known about the stream; then the page says what is being waited for.
"""

from __future__ import annotations

import queue
import re
import secrets
import socket
import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from time import monotonic
from typing import Any

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.session import Session
from rcbht_jax.report.live_frames import Broadcast, description, server_sent

CONNECTIONS = 64  # at once; a further one takes the place of the one that has sent half a request for the longest time
BUFFER = 2**16  # bytes that the system keeps for a viewer: one that does not read is noticed, and left after IDLE
IDLE = 10.0  # s until a connection that has not sent a whole request is closed, though it may send bytes now and then
LOOPBACK = ("127.0.0.1", "localhost", "::1")

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
_POLICY += "; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


class _Handler(BaseHTTPRequestHandler):
    """Answers for :class:`PageServer`."""

    server: PageServer
    timeout = IDLE
    protocol_version = "HTTP/1.0"
    server_version, sys_version = "rcbht", ""

    def do_GET(self) -> None:
        self.server.asked(self.request)
        path = self.path.split("?", 1)[0]
        # A page elsewhere must not read this one under a name of its own (DNS rebinding).
        if self.server.local and _host(self.headers.get("Host", "")) not in self.server.names:
            self.send_error(403, "Only viewers on this machine are admitted")
        elif path != "/" and self.headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            self.send_error(403, "Requests from other pages are refused")  # nor take the places of viewers
        elif path == "/":
            self._head("text/html; charset=utf-8")
            self.wfile.write(self.server.document)
        elif path == "/frames":
            self._stream()
        else:
            self.send_error(404, "There is only /")

    def _head(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", _POLICY)
        self.end_headers()

    def _stream(self) -> None:
        viewer = self.server.broadcast.join()
        if viewer is None:
            self.send_error(503, "Too many viewers, or closed")
            return
        try:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
            self._head("text/event-stream")
            while True:
                try:
                    packet = viewer.get(timeout=1.0)
                except queue.Empty:
                    self.wfile.write(b": still here\n\n")
                    continue
                self.wfile.write(server_sent("end", 0) if packet is None else packet)
                if packet is None:
                    return
        except OSError:
            return  # the viewer has gone
        finally:
            self.server.broadcast.leave(viewer)

    def log_message(self, format: str, *args: Any) -> None:
        """Suppress the request log: standard error is for the user."""


def filled(template: str, parts: dict[str, str]) -> str:
    """A page of this folder with texts in place of its marks ``@@NAME@@``."""
    pieces = asset(template).split("@@")  # text, NAME, text, NAME, ..., text
    return "".join(parts[piece] if number % 2 else piece for number, piece in enumerate(pieces))


def asset(*names: str) -> str:
    """The text of files of this folder, one after the other."""
    folder = files("rcbht_jax.report")
    return "".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)


def _host(value: str) -> str:
    """Name in a Host header, without the port."""
    if found := re.fullmatch(r"\[([0-9a-fA-F:.]+)\](:\d*)?", value):
        return found[1]
    return value.rsplit(":", 1)[0] if ":" in value else value


class PageServer(ThreadingHTTPServer):
    """Serves the page of one session in the background; a context manager.

    Args:
        session: whose frames are shown; None = set later by :meth:`show`.
        host: address to bind; anything but loopback admits viewers on other machines.
        port: 0 = any free one, see :attr:`url`.

    Raises:
        InputError: the address cannot be bound.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = CONNECTIONS  # that wait to be accepted: a further one comes again after 1 s

    def __init__(self, session: Session | None = None, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.broadcast = Broadcast()
        self._free, self._lock = threading.BoundedSemaphore(CONNECTIONS), threading.Lock()
        self._unasked: dict[socket.socket, float] = {}  # when those without a whole request came, the oldest first
        self.local = host in LOOPBACK or host.startswith("127.")
        self.names = {*LOOPBACK, host}  # that a Host header may have: another site's page has another name
        script = asset("live_page.js", "live_controls.js", "live_draw.js")
        self.document = filled("live_page.html", {"STYLE": asset("live_page.css"), "SCRIPT": script}).encode()
        if session is not None:
            self.show(session)
        self.address_family = socket.AF_INET6 if (six := ":" in host) else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"The page cannot be served at {host}:{port}: {error}; try another --host or --port."
            ) from error
        self.url = f"http://{f'[{host}]' if six else host}:{self.server_address[1]}/"

    def show(self, session: Session) -> None:
        """Announce what the frames of a session mean."""
        # By the name a viewer that reconnects recognises whether it is still the same stream.
        self.broadcast.announce("about", {"stream": secrets.token_hex(8), **description(session)})

    def status(self, text: str) -> None:
        """Announce what is being waited for; "" = nothing any more."""
        self.broadcast.announce("status", text)

    def __enter__(self) -> PageServer:
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.broadcast.close()
        self.shutdown()
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread; of too many connections, the oldest that has sent no whole request is closed."""
        if not (self._free.acquire(blocking=False) or (self._dropped() and self._free.acquire(timeout=1.0))):
            self.shutdown_request(request)
            return
        with self._lock:
            self._unasked[request] = monotonic()
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread can be started
            self.asked(request)
            self._free.release()
            raise

    def asked(self, request: Any) -> None:
        """Note that a connection has sent its whole request, or ended."""
        with self._lock:
            self._unasked.pop(request, None)

    def service_actions(self) -> None:
        """Close connections whose request takes too long: the serving thread checks every tenth of a second."""
        while self._dropped(IDLE):
            pass

    def _dropped(self, age: float = 0.0) -> bool:
        """Close the oldest connection without a whole request, if it has lasted ``age`` s; whether one was closed."""
        with self._lock:
            oldest, since = next(iter(self._unasked.items()), (None, 0.0))
            if oldest is None or monotonic() - since < age:
                return False
            del self._unasked[oldest]
        with suppress(OSError):
            oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end
        return True

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, then let another one in."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.asked(request)
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore viewers that disconnect or send malformed requests."""
