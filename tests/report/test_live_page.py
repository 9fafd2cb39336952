"""The live page: what it serves, that it takes nothing, and that nobody who looks can hurt it."""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import socket
import threading
import time
from html.parser import HTMLParser
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.nominal_file import MonitorFile
from rcbht_jax.introspection.nominal_watch import NominalWatch
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Malformed, Message, Reset, Sample, Silence
from rcbht_jax.labels import AXES, LAYERS
from rcbht_jax.report import live_frames, live_page
from rcbht_jax.report.live_frames import Broadcast, Frames
from rcbht_jax.report.live_page import PageServer
from tests.io.test_stream_sources import samples_of
from tests.support.introspection_models import CONFIG, model, trial

ONE = ("grip",)


def words_only(axes: tuple[str, ...] = ONE) -> Session:
    return Session(WordIntrospector(CONFIG, rj.preset("hiro", axes), axes))


def ask(server: PageServer, method: str, path: str, headers: dict[str, str] | None = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    connection.request(method, path, headers=headers or {})
    answer = connection.getresponse()
    body = b"" if path == "/frames" and answer.status == 200 else answer.read()
    connection.close()
    return answer.status, body


def packets(text: str) -> list[tuple[str, Any]]:
    """Kind and content of the server-sent events of a text."""
    blocks = [block.split("\n") for block in text.strip().split("\n\n") if not block.startswith(":")]
    return [(kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))) for kind, data in blocks]


class Kept(Broadcast):
    """A broadcast that remembers its frames."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[dict[str, Any]] = []

    def publish(self, frame: dict[str, Any]) -> None:
        super().publish(frame)
        self.frames.append(frame)


def frames_of(session: Session, messages: list[Message], end: bool = True) -> tuple[list[dict[str, Any]], list[Event]]:
    kept = Kept()
    frames = Frames(session, kept)
    events = [event for message in messages for event in frames.feed(message)]
    if end:
        frames.finish()
    return kept.frames, events


@pytest.fixture(scope="module")
def server():
    with PageServer(Session(Introspector(model())), port=0) as running:
        yield running


def test_the_page_fetches_nothing_from_anywhere(server):
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
    assert b"@@" not in body


def test_the_description_has_classes_alarms_and_names():
    said = live_frames.description(Session(Introspector(model())))
    assert said["heads"]["states"] == ("calm", "push", "shake")
    assert said["alarms"] == {"outcome": {"class": "failure", "level": 0.7}}
    assert [len(said["names"][layer]) for layer in said["layers"]] == [10, 9, 9]


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
def test_nothing_but_reading(server, method):
    assert ask(server, method, "/")[0] == 501


def test_other_paths_and_names(server):
    for path in ("/etc/passwd", "/../../etc/passwd", "/..", "/page.html", "/%2e%2e/"):
        assert ask(server, "GET", path)[0] == 404
    for name in ("evil.example:80", "[localhost]evil", "[127.0.0.1]:80.evil", "[::1]x"):
        assert ask(server, "GET", "/", {"Host": name})[0] == 403
    assert ask(server, "GET", "/", {"Host": "[::1]:80"})[0] == 200
    assert ask(server, "GET", "/", {"Host": f"localhost:{server.server_address[1]}"})[0] == 200
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(InputError, match="cannot be served"):
        PageServer(Session(Introspector(model())), port=server.server_address[1])


def test_addresses_of_ip_6():
    try:
        with socket.socket(socket.AF_INET6) as other:
            other.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no IPv6")
    with PageServer(words_only(), host="::1", port=0) as server:
        assert server.url == f"http://[::1]:{server.server_address[1]}/"
        assert urlopen(server.url, timeout=10).status == 200


def test_pages_of_others_neither_look_nor_frame_nor_take_a_place(server):
    """A browser says which page asks; a link from elsewhere to the page itself is followed."""
    for site in ("cross-site", "same-site"):
        assert ask(server, "GET", "/", {"Sec-Fetch-Site": site})[0] == 200
        assert ask(server, "GET", "/frames", {"Sec-Fetch-Site": site})[0] == 403
    for site in ("same-origin", "none"):
        assert ask(server, "GET", "/frames", {"Sec-Fetch-Site": site})[0] == 200
    with urlopen(server.url) as answer:
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]


def test_the_page_gets_every_belief() -> None:
    session = Session(Introspector(model(), rate=None), tare=0.5)  # ten in a frame, and those of the tare at once
    frames, events = frames_of(session, list(samples_of(trial(1, 40, 400))))
    found = [belief for frame in frames for belief in frame["beliefs"]]
    assert found == [event.to_json() for event in events if isinstance(event, Belief)] != []


def test_frames_hold_the_stream():
    session = Session(Introspector(model(), words=True))
    wrench = trial(1, 40, 400)
    with PageServer(port=0) as server:
        server.status("compiling")
        server.show(session)
        frames = Frames(session, server.broadcast)
        for message in samples_of(wrench[:200], (100,)):
            frames.feed(message)
        connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
        connection.request("GET", "/frames")
        answer = connection.getresponse()
        for message in samples_of(wrench)[200:]:
            frames.feed(message)
        frames.finish()
        server.broadcast.close()
        heard = packets(answer.read().decode())
    assert answer.getheader("Content-Type") == "text/event-stream"
    about = json.loads(json.dumps(live_frames.description(session)))
    assert heard[:2] == [("status", "compiling"), ("about", {"stream": heard[1][1]["stream"], **about})]
    assert heard[-1] == ("end", 0)
    said = [value for kind, value in heard if kind == "frame"]
    assert [frame["number"] for frame in said] == list(range(1, len(said) + 1))
    values = np.array([row for frame in said for row in frame["wrench"]])
    np.testing.assert_allclose(values[:, 1:], wrench, atol=1e-5)
    assert [e["begin"] for frame in said for e in frame["events"] if e["event"] == "SubtaskStarted"] == [100]
    assert sum(belief["head"] == "states" for frame in said for belief in frame["beliefs"]) == 20
    tracks = rj.encode(wrench, rate=200)
    expected = {  # layer, axis, code, first sample, end: what the batch encoder says of the whole
        (l, a, int(track.label[a, k]), int(track.t0[a, k]), int(track.t1[a, k]))
        for l, track in enumerate(getattr(tracks, layer) for layer in LAYERS)
        for a, k in zip(*np.nonzero(track.label), strict=True)
    }
    words = [word for frame in said for word in frame["words"]]
    got = {(l, a, code, round(t0 * 200), round(t1 * 200)) for l, a, code, t0, t1 in words}
    assert got == expected
    assert len(words) == len(expected)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_no_band_is_ever_empty(kind):
    """After two windows, words and provisional words of every layer and axis cover the stream without a hole."""
    frames, _ = frames_of(words_only(rj.labels.AXES), list(samples_of(trial(kind, 5, 203))))
    published: dict[tuple[int, int], list[tuple[float, float]]] = {}
    provisional = 0
    for frame in frames:
        for l, a, _, t0, t1 in frame["words"]:
            published.setdefault((l, a), []).append((t0, t1))
        shown = {lane: list(spans) for lane, spans in published.items()}
        for l, a, _, t0, t1 in frame["provisional"]:
            shown.setdefault((l, a), []).append((t0, t1))
        provisional += len(frame["provisional"])
        end = frame["sample"] - (frame["sample"] % CONFIG.window == 1)  # a single sample has no line
        assert frame["sample"] >= 2 * CONFIG.window
        assert len(shown) == 18
        for spans in shown.values():
            edges = np.array(spans)
            assert edges[0, 0] == 0
            np.testing.assert_allclose(edges[1:, 0], edges[:-1, 1])
            assert edges[-1, 1] == pytest.approx(end * CONFIG.dt)
    assert provisional
    assert not frames[-1]["provisional"]


@pytest.mark.parametrize("count", [1, 12])
def test_any_number_of_axes(count):
    axes = tuple(f"axis{number}" for number in range(count))
    session = words_only(axes)
    about = live_frames.description(session)
    assert (about["axes"], about["heads"], about["alarms"]) == (axes, {}, {})
    wrench = np.tile(trial(1, 3, 100), (1, 2))[:, :count]
    frames, _ = frames_of(session, [Sample(tuple(row), 0.005 * k) for k, row in enumerate(wrench.tolist())])
    assert {word[1] for frame in frames for word in frame["words"]} == set(range(count))
    assert {len(row) for frame in frames for row in frame["wrench"]} == {count + 1}


def test_hostile_readings_are_not_shown():
    bad: list[Message] = [
        Sample((math.nan,), 0.5), Sample((math.inf,), 0.5), Sample((1e30,), 0.5), Sample((1.0,), math.inf),
        Sample((1.0,), 0.2), Sample((1.0, 2.0), 0.5), Sample((), 0.5), Malformed("</script>"),
    ]  # fmt: skip
    good: list[Message] = [Sample((float(k),), 0.005 * k) for k in range(100)]
    frames, events = frames_of(words_only(), [*good, *bad, Sample((100.0,), 0.5)])
    assert [row[1] for frame in frames for row in frame["wrench"]] == [*range(101)]
    assert len(events) >= len(bad)
    assert json.dumps(frames, allow_nan=False)


def test_silence_is_told_at_once():
    messages: list[Message] = [*(Sample((0.0,), 0.005 * k) for k in range(13)), Silence(1.0)]
    frames, _ = frames_of(words_only(), messages, end=False)
    assert [event["kind"] for event in frames[-1]["events"]] == ["silent"]
    assert frames[-1]["sample"] == 13  # with the readings that had not filled a frame


def test_scores_of_a_monitor_are_shown():
    monitor = NominalMonitor(rate=200).fit([trial(1, seed, 300) for seed in range(6)])
    watch = NominalWatch(MonitorFile(monitor, AXES, ()), 0.2)
    session = Session(Together(Introspector(model()), readers=[watch]))
    wrench = trial(1, 8, 300) + 50.0 * (np.arange(300) > 200)[:, None]
    said, _ = frames_of(session, samples_of(wrench))
    shown = np.array([row for frame in said for row in frame["scores"]])
    np.testing.assert_allclose(shown[:, 0], 0.005 * np.arange(9, 300, 10), atol=1e-6)
    np.testing.assert_allclose(shown[:, 1], monitor.scores(wrench.astype(np.float32))[9::10], atol=1e-5)
    assert set(shown[:, 2]) == {monitor.threshold(0.2)}
    assert "monitor" in said[-1]["raised"]


def test_whoever_looks_later_sees_the_alarm_that_stands_and_the_same_clock():
    """A page that was opened, or read again, after half a minute showed no alarm, and counted from another second."""
    frames, _ = frames_of(
        Session(Introspector(model())),
        [Sample(tuple(r), 1.7e9 + 0.005 * k) for k, r in enumerate(trial(1, 40, 400).tolist())],
    )
    assert (frames[0]["raised"], frames[-1]["raised"]) == ([], ["outcome"])
    assert {frame["base"] for frame in frames} == {1.7e9}
    raised = [event for frame in frames for event in frame["events"] if event["event"] == "AnomalyRaised"]
    assert len(raised) == 1
    gap = [Sample((0.0,), start + 0.005 * k) for start in (1.7e9, 1.7e9 + 5, 1.7e9 + 100) for k in range(20)]
    frames, _ = frames_of(words_only(), gap)
    assert sorted({(frame["trial"], frame["base"]) for frame in frames}) == [(0, 1.7e9), (1, 1.7e9), (2, 1.7e9 + 100)]


def test_readings_are_shown_while_they_are_tared():
    session = Session(WordIntrospector(CONFIG, rj.preset("hiro", ["axis0"]), ["axis0"]), tare=0.5)
    frames, _ = frames_of(session, [Sample((float(k),), 0.005 * k) for k in range(150)])
    assert [row[1] for frame in frames for row in frame["wrench"]] == [*range(150)]
    assert frames[0]["sample"] == 10


def test_a_new_trial_ends_the_words_of_the_former():
    one: list[Message] = [Sample((float(k % 7),), 0.005 * k) for k in range(103)]
    gap: list[Message] = [Sample((float(k % 7),), 9 + 0.005 * k) for k in range(50)]
    frames, _ = frames_of(words_only(), [Reset(), *one, Reset(), *one, *gap])
    assert [frame["trial"] for frame in frames] == sorted(frame["trial"] for frame in frames)
    for number, (begin, samples) in enumerate(((0.0, 103), (0.0, 103), (9.0, 50))):
        mine = [frame for frame in frames if frame["trial"] == number]
        assert mine[-1]["sample"] == samples
        assert not mine[-1]["provisional"]
        assert sum(len(frame["wrench"]) for frame in mine) == samples
        spans = [word[3:] for frame in mine for word in frame["words"] if word[0] == 2]
        assert (spans[0][0], spans[-1][1]) == (begin, pytest.approx(begin + 0.005 * samples))


def test_a_slow_viewer_costs_nothing(monkeypatch):
    broadcast = Broadcast()
    viewer = broadcast.join()
    assert viewer is not None
    for k in range(5 * live_frames.HISTORY):
        broadcast.publish({"k": k})
    assert viewer.qsize() == 2 * live_frames.HISTORY
    [(kind, value)] = packets((viewer.get_nowait() or b"").decode())
    assert (kind, value) == ("frame", {"k": 3 * live_frames.HISTORY, "number": 3 * live_frames.HISTORY + 1})
    joined = [broadcast.join() for _ in range(live_frames.VIEWERS)]
    assert joined[-1] is None
    broadcast.leave(viewer)
    last = broadcast.join()
    assert last is not None
    broadcast.close()
    assert [last.get_nowait() for _ in range(last.qsize())][-1] is None
    broadcast.leave(last)
    assert broadcast.join() is None  # a browser with a spare connection must look for the next server


@settings(max_examples=40)
@given(st.binary(max_size=400))
def test_any_bytes_leave_the_server_well(data):
    server = well()
    with socket.create_connection(server.server_address[:2], timeout=5) as client:
        client.sendall(data)
        client.shutdown(socket.SHUT_WR)
        while client.recv(4096):
            pass
    assert ask(server, "GET", "/")[0] == 200


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


def test_connections_that_drip_their_request_end(monkeypatch):
    """The time of a whole request is bounded, not that of each of its bytes alone."""
    monkeypatch.setattr(live_page, "IDLE", 0.5)
    with PageServer(Session(Introspector(model())), port=0) as server:
        with socket.create_connection(server.server_address[:2]) as client:
            begun = time.monotonic()
            with contextlib.suppress(ConnectionError):
                while time.monotonic() < begun + 5:
                    client.sendall(b"G")
                    time.sleep(0.05)
            assert 0.4 < time.monotonic() - begun < 4
        assert ask(server, "GET", "/")[0] == 200


def test_connections_are_bounded(monkeypatch):
    """Beyond the bound the connections that hold back their request for the longest time make room."""
    monkeypatch.setattr(live_page, "CONNECTIONS", 3)
    with PageServer(Session(Introspector(model())), port=0) as server:
        address, before = server.server_address[:2], threading.active_count()
        clients = [socket.create_connection(address) for _ in range(6)]
        for client in clients[:3]:
            client.settimeout(5)
            assert client.recv(1) == b""
        assert threading.active_count() <= before + 4  # three, and one that is ending
        assert ask(server, "GET", "/")[0] == 200  # while three others still hold back their requests
        assert ask(server, "GET", "/")[0] == 200
        for client in clients:
            client.close()
        for _ in range(200):
            with contextlib.suppress(ConnectionError):
                if ask(server, "GET", "/")[0] == 200:
                    return
            time.sleep(0.02)
        pytest.fail("the server is still full")


def test_as_many_as_may_connect_wait_at_once():
    """Of a queue of five each seventh connection waited 1 s for the system to try again."""
    server = PageServer(port=0)  # which accepts nobody yet
    with contextlib.ExitStack() as stack:
        stack.callback(server.server_close)
        for _ in range(live_page.CONNECTIONS):
            stack.enter_context(socket.create_connection(server.server_address[:2], timeout=0.5))
