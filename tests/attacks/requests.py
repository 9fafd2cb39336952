"""Hostile requests to the live page: it answers the next one, and nobody under a foreign name."""

from __future__ import annotations

import random
import socket
import sys
from typing import Any

from rcbht_jax.report.live_page import PageServer

PATHS = (
    "/",
    "/frames",
    "/../etc/passwd",
    "/%2e%2e/x",
    "//x",
    "*",
    "/" + "a" * 5000,
    "/\x00",
    "/?x=<a>",
)
METHODS = ("GET", "HEAD", "POST", "PUT", "OPTIONS", "TRACE", "get", "G" * 3000, "")
HOSTS = (
    "localhost", "127.0.0.1", "evil.example", "[localhost]evil", "localhost.evil.example", "", "127.0.0.1:80:evil",
    "[::1]evil", "\xff", "a" * 3000,
)  # fmt: skip
OWN = {"localhost", "127.0.0.1"}


class _Server(PageServer):
    """The page, which keeps what it would have printed."""

    failed = ""

    def handle_error(self, request: Any, client_address: Any) -> None:
        error = sys.exception()
        if not isinstance(error, OSError):  # the other side has gone
            self.failed = repr(error)


def attack(seed: str) -> str:
    """Send one to eight hostile requests, then a good one; "" or what is wrong."""
    rng = random.Random(seed)
    with _Server(port=0) as server:
        for _ in range(rng.randrange(1, 9)):
            host, said = _hostile(rng, server.server_address[1])
            if b" 200 " in said[:20] and host is not None and host not in OWN:
                return f"it answers {host!r}"
            if b"Access-Control" in said or b"root:" in said:
                return "it tells too much"
        good = _send(server.server_address[1], b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        server.broadcast.close()
        if not good.startswith(b"HTTP/1.0 200"):
            return f"the next one is answered {good[:30]!r}"
        return server.failed


def _hostile(rng: random.Random, port: int) -> tuple[str | None, bytes]:
    """The name under which it was asked, None = none that counts, and the answer."""
    if rng.random() < 0.4:
        raw = rng.choice((rng.randbytes(rng.randrange(2000)), b"G" * 70_000, b"\r\n" * 500, b"GET /", b"\0" * 100))
        return None, _send(port, raw)
    host = rng.choice(HOSTS)
    more = rng.choice(
        ("", "Content-Length: 99999999\r\n", "X: y\r\n" * 150, "Transfer-Encoding: chunked\r\n", "X" * 70_000)
    )
    first = f"{rng.choice(METHODS)} {rng.choice(PATHS)} HTTP/{rng.choice(('1.1', '1.0', '9', ''))}"
    return host, _send(port, f"{first}\r\nHost: {host}\r\n{more}\r\n".encode("latin-1"))


def _send(port: int, raw: bytes) -> bytes:
    """The beginning of the answer; the connection is broken off."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
            client.sendall(raw)
            client.shutdown(socket.SHUT_WR)
            return client.recv(2000)
    except OSError as error:
        return repr(error).encode()
