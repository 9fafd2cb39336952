"""The live page: what it serves, that it takes nothing, and that nobody who looks can hurt it."""

from __future__ import annotations

import http.client
import json
import socket
import threading
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.session import Session
from rcbht_jax.report import live_page
from rcbht_jax.report.live_page import Broadcast, Frames, PageServer
from tests.io.test_stream_sources import samples_of
from tests.support.introspection_models import model, trial


def ask(server: PageServer, method: str, path: str, headers: dict[str, str] | None = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    connection.request(method, path, headers=headers or {})
    answer = connection.getresponse()
    body = b"" if path == "/frames" and answer.status == 200 else answer.read()
    connection.close()
    return answer.status, body


@pytest.fixture(scope="module")
def server():
    with PageServer(Session(Introspector(model())), port=0) as running:
        yield running


def test_page_and_description(server):
    status, body = ask(server, "GET", "/")
    assert status == 200

    class Links(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.found: list[str] = []

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            self.found += [v or "" for k, v in attrs if k in ("src", "href")]

    links = Links()
    links.feed(body.decode())
    assert links.found == ["data:,"]  # nothing is fetched from anywhere
    assert b"http" not in body
    status, body = ask(server, "GET", "/description")
    said = json.loads(body)
    assert said["heads"]["states"] == ["calm", "push", "shake"]
    assert [len(said["names"][layer]) for layer in said["layers"]] == [10, 9, 9]
    assert ask(server, "HEAD", "/")[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
def test_nothing_but_reading(server, method):
    assert ask(server, method, "/")[0] == 501


def test_other_paths_and_names(server):
    for path in ("/etc/passwd", "/../../etc/passwd", "/..", "/page.html", "/%2e%2e/"):
        assert ask(server, "GET", path)[0] == 404
    assert ask(server, "GET", "/", {"Host": "evil.example:80"})[0] == 403
    assert ask(server, "GET", "/", {"Host": f"localhost:{server.server_address[1]}"})[0] == 200
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(InputError, match="cannot be served"):
        PageServer(Session(Introspector(model())), port=server.server_address[1])


def test_frames_hold_the_stream():
    session = Session(Introspector(model()))
    wrench = trial(1, 40, 400)
    with PageServer(session, port=0) as server:
        frames = Frames(session, server.broadcast)
        for message in samples_of(wrench[:200], (100,)):
            frames.feed(message)
        connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
        connection.request("GET", "/frames")
        answer = connection.getresponse()
        for message in samples_of(wrench)[200:]:
            frames.feed(message)
        frames.flush()
        server.broadcast.close()
        said = [json.loads(line[6:]) for line in answer.read().decode().splitlines() if line.startswith("data: {")]
    assert answer.getheader("Content-Type") == "text/event-stream"
    values = np.array([row for frame in said for row in frame["wrench"]])
    np.testing.assert_allclose(values[:, 1:], wrench, atol=1e-5)
    assert [e["begin"] for frame in said for e in frame["events"] if e["event"] == "SubtaskStarted"] == [100]
    assert sum("states" in frame["beliefs"] for frame in said) == 20
    assert said[-1]["labels"] == session.introspector.labels.tolist()


def test_a_slow_viewer_costs_nothing(monkeypatch):
    broadcast = Broadcast()
    viewer = broadcast.join()
    assert viewer is not None
    for k in range(5 * live_page.HISTORY):
        broadcast.publish({"k": k})
    assert viewer.qsize() == 2 * live_page.HISTORY
    assert json.loads(viewer.get_nowait())["k"] == 3 * live_page.HISTORY
    joined = [broadcast.join() for _ in range(live_page.VIEWERS)]
    assert joined[-1] is None
    broadcast.leave(viewer)
    assert broadcast.join() is not None


@settings(max_examples=40)
@given(st.binary(max_size=400))
def test_any_bytes_leave_the_server_well(data):
    server = well()
    with socket.create_connection(server.server_address[:2], timeout=5) as client:
        client.sendall(data)
        client.shutdown(socket.SHUT_WR)
        while client.recv(4096):
            pass
    assert ask(server, "GET", "/description")[0] == 200


_kept: list[PageServer] = []


def well() -> PageServer:
    """One server for all examples."""
    if not _kept:
        _kept.append(PageServer(Session(Introspector(model())), port=0).__enter__())
    return _kept[0]


def test_idle_connections_end(monkeypatch):
    monkeypatch.setattr(live_page._Handler, "timeout", 0.2)
    before = threading.active_count()
    with PageServer(Session(Introspector(model())), port=0) as server:
        clients = [socket.create_connection(server.server_address[:2]) for _ in range(20)]
        for client in clients:
            client.settimeout(5)
            assert client.recv(10) == b""
            client.close()
    assert threading.active_count() <= before + 2
