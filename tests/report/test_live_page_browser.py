"""The live page in a real browser: charts, controls and connection, without a network, on screens of any density."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Malformed, Message, Reset, Sample
from rcbht_jax.report.live_frames import Frames
from rcbht_jax.report.live_page import PageServer
from tests.io.test_stream_sources import samples_of
from tests.support.browser import browser
from tests.support.introspection_models import CONFIG, FIT, FIT_LIMITS, model, trial

# Rows of a canvas that hold anything but the background, as shares of its height, and how many colours it shows.
SEEN = """
const c = document.getElementById(arguments[0]), data = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
const rows = new Set(), colours = new Set();
for (let i = 0; i < data.length; i += 4) if (data[i] + data[i + 1] + data[i + 2] < 3 * 250) {
  rows.add(Math.floor(i / 4 / c.width)); colours.add(`${data[i]},${data[i + 1]},${data[i + 2]}`);
}
return {last: Math.max(...rows) / c.height, colours: colours.size, picture: c.toDataURL(), width: c.width};
"""
CANVASES = ("signal-0", "signal-1", "words", "belief-states", "alarm-outcome", "axis", "overview")


def wait_for(driver: Any, script: str, seconds: float = 60.0) -> None:
    """Until the script says true; the page draws when the browser finds time."""
    end = time.monotonic() + seconds
    while not driver.execute_script(f"return {script}"):
        assert time.monotonic() < end, f"not so after {seconds} s: {script}; {driver.get_log('browser')[-3:]}"
        time.sleep(0.05)


def feed(frames: Frames, messages: list[Message]) -> None:
    for message in messages:
        frames.feed(message)
    frames.flush()


def session_of(axes: tuple[str, ...], units: tuple[str, ...]) -> Session:
    return Session(WordIntrospector(CONFIG, rj.preset("hiro", axes), axes, units))


def readings(axes: int, count: int, start: float = 0.0) -> list[Message]:
    wrench = np.tile(trial(1, 3, count), (1, 2))[:, :axes]
    return [Sample(tuple(row), start + 0.005 * k) for k, row in enumerate(wrench.tolist())]


def state(driver: Any) -> str:
    return str(driver.find_element("id", "state").text)


@pytest.mark.parametrize(("width", "ratio"), [(1280, 1), (400, 2)])
def test_everything_moves(width, ratio, tmp_path):
    session = Session(Introspector(model(), words=True))
    wrench = np.concatenate([trial(0, 60, 400), trial(1, 61, 400), trial(2, 62, 400)])
    messages = list(samples_of(wrench, (400, 800)))
    with PageServer(session, port=0) as server, browser(width, 900) as driver:
        size = {"width": width, "height": 900, "deviceScaleFactor": ratio, "mobile": width < 600}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        wait_for(driver, "about !== null")
        views = []
        for part, sample in enumerate((400, 800, 1200)):
            while session.introspector.received < sample:
                frames.feed(messages.pop(0))
            frames.flush()
            wait_for(driver, f"byId('clock').textContent.includes('{sample} samples') && !dirty")
            wait_for(driver, f"byId('head-states').querySelector('.best')?.textContent.startsWith('{'cps'[part]}')")
            views.append({name: driver.execute_script(SEEN, name) for name in CANVASES})
            bars = driver.execute_script(
                "return [...document.querySelectorAll('#head-states .bar i')].map(b => parseFloat(b.style.width))"
            )
            assert sum(bars) == pytest.approx(100, abs=0.1)
            assert int(np.argmax(bars)) == part
        for name in CANVASES:
            assert len({view[name]["picture"] for view in views}) == 3, f"{name} stands still"
            assert views[-1][name]["last"] > 0.6, f"{name} is cut off"
            shown = driver.find_element("id", name).size["width"]
            assert views[-1][name]["width"] == pytest.approx(ratio * shown, abs=1)
        assert views[-1]["words"]["colours"] > 5
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        assert "SubtaskStarted" in driver.find_element("id", "events").get_attribute("textContent")
        now = driver.find_element("id", "now").get_attribute("textContent")
        assert all(axis in now for axis in rj.labels.AXES)
        fetched = driver.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
        assert all(name.startswith(server.url) for name in fetched)
        driver.save_screenshot(str(tmp_path / f"page-{width}.png"))
        server.broadcast.close()
        wait_for(driver, "byId('state').textContent.includes('ended')")
        assert [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []


def press(driver: Any, key: str) -> None:
    driver.execute_script(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")


def test_pause_scrub_and_zoom():
    session = session_of(("grip",), ("N",))
    with PageServer(session, port=0) as server, browser(1000, 700) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, readings(1, 400))  # 2 s
        wait_for(driver, "view.to > 1.9 && !dirty")
        press(driver, " ")
        assert driver.find_element("id", "pause").text == "Resume"
        shown = driver.execute_script(SEEN, "words")["picture"]
        feed(frames, readings(1, 3600, 2.0))  # up to 20 s; nothing moves, nothing is lost
        wait_for(driver, "kept.t.length === 4000 && !dirty")
        assert driver.execute_script(SEEN, "words")["picture"] == shown
        wait_for(driver, "byId('state').textContent.startsWith('paused, 18.0 s')")
        press(driver, "End")
        wait_for(driver, "view.live && view.to > 19.9 && !dirty")
        driver.execute_script("byId('span').value = '5'; byId('span').onchange()")
        press(driver, "ArrowLeft")
        assert driver.execute_script("return [view.to, view.span]") == pytest.approx([19.995 - 1.25, 5])
        press(driver, "Home")
        assert driver.execute_script("return view.to - view.span") == pytest.approx(0)
        press(driver, "+")  # about the middle of what is shown
        assert driver.execute_script("return [view.to - view.span / 2, view.span]") == pytest.approx([2.5, 5 / 1.5])
        ticks = driver.execute_script("return ticks(1000).map(tick => [tick[0], +tick[1]])")
        assert len(ticks) >= 3
        assert all(place == pytest.approx(said) for place, said in ticks)
        driver.execute_script(
            "const c = byId('signal-0'), r = c.getBoundingClientRect();"
            "c.onpointermove({clientX: r.left + LEFT + (r.width - LEFT - RIGHT) / 2})"
        )
        wait_for(driver, "byId('moment').textContent === 'At 2.500 s'")
        value = float(driver.find_element("css selector", "#now td").text.split()[0])
        assert value == pytest.approx(readings(1, 3600, 2.0)[100].wrench[0], abs=1e-3)
        assert int(driver.find_element("id", "overview").get_attribute("aria-valuemax").split(".")[0]) == 20


def test_provisional_words_are_pale_and_no_band_is_empty():
    session = session_of(rj.labels.AXES, rj.labels.UNITS)
    middle = """
      const c = byId('words'), y = Math.round(arguments[0] * c.height);
      const data = c.getContext('2d').getImageData(0, y, c.width, 1).data;
      const from = Math.ceil(LEFT) + 1, to = c.width - RIGHT - 1, white = [];
      for (let i = from; i < to; i++) if (data[4 * i] + data[4 * i + 1] + data[4 * i + 2] === 765) white.push(i);
      return {white, last: [...data.slice(4 * (to - 2), 4 * (to - 2) + 3)]};
    """
    with PageServer(session, port=0) as server, browser(1000, 700) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, [Sample((0.0,) * 6, 0.005 * k) for k in range(1000)])  # one word, which is never published
        driver.execute_script("view.span = 4; dirty = true")
        wait_for(driver, "about && view.to > 4.9 && !dirty")
        for row in range(6):
            seen = driver.execute_script(middle, (row + 0.1) / 6)
            assert seen["white"] == []
            pale = [round(0.4 * 0xBD + 0.6 * 255)] * 3  # FX on white
            assert seen["last"] == pytest.approx(pale, abs=1)
        frames.finish()
        wait_for(driver, f"link.number === {server.broadcast._number} && !dirty")
        assert driver.execute_script(middle, 0.1 / 6)["last"] == [0xBD] * 3


@pytest.mark.parametrize("fits", [False, True])
def test_the_key_says_whose_words_the_beliefs_read(fits):
    """A model of the published words: beside words by the fit rule one sentence says so, beside its own nothing."""
    introspector: Introspector | Together = Introspector(model(), words=not fits)
    if fits:
        introspector = Together(introspector, WordIntrospector(replace(FIT, window=5), FIT_LIMITS))
    session = Session(introspector)
    with PageServer(session, port=0) as server, browser(1000, 900) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, readings(6, 60))
        wait_for(driver, "about && byId('key').children.length > 0")
        said = driver.execute_script("return byId('key').textContent")
    assert ("words by the fit rule;" in said) == fits
    assert said.endswith("The beliefs read other words, those by the published rules.") == fits


def test_what_happens_to_a_stream():
    """Compiling, other numbers of axes after a restart, a new trial, silence, and a server that comes back."""
    with browser(1000, 900) as driver:
        with PageServer(port=0) as server:
            port = server.server_address[1]
            server.status("compiling the encoder")
            driver.get(server.url)
            wait_for(driver, "byId('wait').textContent === 'Compiling the encoder.' && !byId('wait').hidden")
            one = session_of(("grip",), ("N",))
            server.show(one)
            server.status("")
            frames = Frames(one, server.broadcast)
            bad: list[Message] = [Malformed("<b>not a message</b>")]
            feed(frames, [*bad, *readings(1, 200, 1.7e9), *bad * 9])
            wait_for(
                driver, "byId('wait').hidden && byId('clock').textContent === '0.99 s, 200 samples'"
            )  # from a date
            wait_for(driver, "byId('events').textContent.includes('10 times')")
            log = driver.find_element("id", "events").text
            assert "<b>" in log
            assert len(log.splitlines()) == 1
            feed(frames, [Reset(), *readings(1, 100)])
            wait_for(driver, "/^0.(49|50) s, 100 samples/.test(byId('clock').textContent) && !dirty")
            assert driver.execute_script("return kept.trials.length") == 2
            starts = driver.execute_script("return ticks(1000).map(tick => tick[1])")
            assert sum(float(start) == 0 for start in starts) == 2  # the ticks of each trial begin anew
            wait_for(driver, "byId('state').textContent.startsWith('silent for')")
        wait_for(driver, "['lost', 'ended'].includes(byId('state').dataset.kind)")
        axes = tuple(f"{arm}.{axis}" for arm in "LR" for axis in rj.labels.AXES)
        twelve = session_of(axes, rj.labels.UNITS * 2)
        with PageServer(twelve, port=port) as server:
            feed(Frames(twelve, server.broadcast), readings(12, 300))
            wait_for(driver, "about.axes.length === 12 && kept.t.length === 300 && !dirty")
            assert "1.50 s" in driver.find_element("id", "clock").text.replace("1.49", "1.50")
            assert driver.find_elements("id", "signal-2") == []
            assert len(driver.find_elements("css selector", "#now tbody tr")) == 12
            driver.execute_script("byId('layer').value = 'all'; byId('layer').onchange()")
            wait_for(driver, "!dirty")
            assert driver.execute_script(SEEN, "words")["last"] > 0.9
        errors = [entry["message"] for entry in driver.get_log("browser") if entry["source"] == "javascript"]
        assert errors == []


def test_slow_streams_of_small_values_and_long_pauses():
    """A reading a second, of micrometres: digits are kept, and what is looked at stays."""
    session = Session(WordIntrospector(replace(CONFIG, dt=1.0), rj.preset("hiro", ["depth"]), ["depth"], ["m"]))
    slow: list[Message] = [Sample((1e-6 * (k % 13),), float(k)) for k in range(900)]
    with PageServer(session, port=0) as server, browser(1000, 700) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, slow[:51])
        wait_for(driver, "kept.t.length === 51 && !dirty")
        driver.execute_script(
            "pause(false); const c = byId('signal-0'), r = c.getBoundingClientRect();"
            "c.onpointermove({clientX: r.left + LEFT + (r.width - LEFT - RIGHT) * (15 - 2.5) / 15})"
        )
        wait_for(driver, "byId('moment').textContent === 'At 47.500 s'")
        shown = driver.find_element("css selector", "#now td").text
        assert shown.endswith(" m")
        assert float(shown.split()[0]) == pytest.approx(1e-6 * (47 % 13), rel=1e-3)
        feed(frames, slow[51:])
        wait_for(driver, "kept.latest === 899")
        assert driver.execute_script("return [kept.t[0] <= 35, oldest(), view.to]") == [True, 35, 50]
        assert driver.execute_script("pause(true); return oldest()") == 299


def test_a_gap_is_a_gap_in_a_window_of_minutes():
    """Where a half pixel holds many readings, no line joins what is before a gap and after it."""
    session = session_of(("grip",), ("N",))
    blank = """
      const c = byId('signal-0'), pen = c.getContext('2d'), at = LEFT + (c.clientWidth - LEFT - RIGHT) / 2, seen = [];
      const data = pen.getImageData(Math.round(at) - 20, 24, 41, c.height - 30).data, line = parts(lineColor(0));
      for (let i = 0; i < data.length; i += 4) if (line.every((v, k) => Math.abs(v - data[i + k]) < 40)) seen.push(i);
      return seen.length;
    """
    with PageServer(session, port=0) as server, browser(600, 700) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, [*readings(1, 4000), *readings(1, 4000, 40.0)])  # 20 s each, with 20 s between them
        wait_for(driver, "kept.t.length === 8000")
        driver.execute_script("view.span = 60; dirty = true")
        wait_for(driver, "!dirty")
        assert driver.execute_script(blank) == 0


def test_close_names_of_sub_tasks_stand_in_two_rows():
    named = """
      const pen = byId('signal-0').getContext('2d'), seen = [];
      pen.fillText = (text, x, y) => seen.push([text, y]);
      for (const label of ["insertion", "mating", ""]) note({event: "SubtaskStarted", detected: false, label}, 1);
      Object.assign(view, {to: 2, span: 2, live: false});
      marks(pen, 800, 100, t => 400 * t, true);
      return seen.concat(kept.marks.at(-1).text);
    """
    session = session_of(("grip",), ("N",))
    with PageServer(session, port=0) as server, browser(600, 700) as driver:
        driver.get(server.url)
        feed(Frames(session, server.broadcast), readings(1, 200))
        wait_for(driver, "kept.t.length === 200 && !dirty")
        assert driver.execute_script(named) == [["insertion", 95], ["mating", 83], "sub-task"]


def test_beliefs_seconds_apart_and_frames_that_were_lost():
    session = Session(Introspector(model(), rate=0.25))
    with PageServer(session, port=0) as server, browser(1000, 700) as driver:
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        feed(frames, list(samples_of(trial(0, 60, 2500))))
        wait_for(driver, "kept.t.length === 2500 && !dirty")
        assert driver.execute_script("return answers(kept.beliefs.states, t => t, 1000).map(one => one.length)") == [3]
        server.broadcast._number += 7  # as if a viewer had been too slow
        feed(frames, [Sample((0.0,) * 6, 12.5 + 0.005 * k) for k in range(5)])
        wait_for(driver, "byId('events').textContent.includes('lost: 7 frames did not reach this page')")


def test_a_page_that_was_paused_is_live_when_the_server_comes_back():
    port, former = 0, ""
    with browser(1000, 700) as driver:
        for _ in range(2):
            session = session_of(("grip",), ("N",))
            with PageServer(session, port=port) as server:
                if not port:
                    driver.get(server.url)
                port = server.server_address[1]
                feed(Frames(session, server.broadcast), readings(1, 100))
                wait_for(driver, f"kept.t.length === 100 && about.stream !== '{former}'")
                former = driver.execute_script("return about.stream")
                assert driver.execute_script("return [view.live, byId('pause').textContent]") == [True, "Pause"]
                driver.execute_script("pause(false)")
