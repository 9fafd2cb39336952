"""The live page in a real browser: wrench, bands and bars move, without a network, on screens of any density."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.session import Session
from rcbht_jax.report.live_page import Frames, PageServer
from tests.io.test_stream_sources import samples_of
from tests.support.browser import browser
from tests.support.introspection_models import model, trial

# Rows of a canvas that hold anything, as shares of its height, and how many colours it shows.
SEEN = """
const c = document.getElementById(arguments[0]), data = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
const rows = new Set(), colours = new Set();
for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 0) {
  rows.add(Math.floor(i / 4 / c.width)); colours.add(`${data[i]},${data[i + 1]},${data[i + 2]}`);
}
return {last: Math.max(...rows) / c.height, colours: colours.size, picture: c.toDataURL(), width: c.width};
"""


def wait_for(driver: Any, script: str, seconds: float = 20.0) -> None:
    """Until the script says true; the page draws when the browser finds time."""
    end = time.monotonic() + seconds
    while not driver.execute_script(f"return {script}"):
        assert time.monotonic() < end, f"not so after {seconds} s: {script}"
        time.sleep(0.05)


@pytest.mark.parametrize(("width", "ratio"), [(1280, 1), (400, 2)])
def test_everything_moves(width, ratio, tmp_path):
    session = Session(Introspector(model()))
    wrench = np.concatenate([trial(0, 60, 400), trial(1, 61, 400), trial(2, 62, 400)])
    messages = list(samples_of(wrench, (400, 800)))
    with PageServer(session, port=0) as server, browser(width, 900) as driver:
        size = {"width": width, "height": 900, "deviceScaleFactor": ratio, "mobile": width < 600}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        frames = Frames(session, server.broadcast)
        driver.get(server.url)
        wait_for(driver, "about !== undefined")
        views = []
        for part, sample in enumerate((400, 800, 1200)):
            while session.introspector.received < sample:
                frames.feed(messages.pop(0))
            frames.flush()
            wait_for(driver, f"document.getElementById('state').textContent.includes('{sample} samples') && !dirty")
            views.append({name: driver.execute_script(SEEN, name) for name in ("upper", "lower", "labels")})
            best = driver.find_element("css selector", "#head-states .best")
            assert best.text.startswith(("calm", "push", "shake")[part])
            bars = driver.execute_script(
                "return [...document.querySelectorAll('#head-states .bar i')].map(b => parseFloat(b.style.width))"
            )
            assert sum(bars) == pytest.approx(100, abs=0.1)
            assert int(np.argmax(bars)) == part
        for name in ("upper", "lower", "labels"):
            assert len({view[name]["picture"] for view in views}) == 3, f"{name} stands still"
            assert views[-1][name]["last"] > 0.8, f"{name} is cut off"
            shown = driver.find_element("id", name).size["width"] - 2  # without its border
            assert views[-1][name]["width"] == pytest.approx(ratio * shown, abs=1)
        assert views[-1]["labels"]["colours"] > 5
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        assert "SubtaskStarted" in driver.find_element("id", "events").text
        fetched = driver.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
        assert fetched
        assert all(name.startswith(server.url) for name in fetched)
        driver.save_screenshot(str(tmp_path / f"page-{width}.png"))
        server.broadcast.close()
        wait_for(driver, "document.getElementById('state').textContent.includes('ended')")
        assert [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []
