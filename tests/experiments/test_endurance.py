"""The endurance run in short: a minute of a faulty stream, accounted for; a slope of memory that is found."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest

from experiments._lib import faulty_stream
from experiments._lib.faulty_stream import FAULTS, HERTZ, readings
from experiments.online import endurance
from rcbht_jax.introspection.resampling import Resampler
from rcbht_jax.report.live_page import PageServer


def test_the_stream_is_the_same_for_a_seed_and_has_every_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faulty_stream, "SHARE", 0.5)
    told: list[Counter[str]] = [Counter(), Counter()]
    one, two = ([repr(block) for block in readings(100, 3, each)] for each in told)
    assert one == two
    assert told[0] == told[1]
    assert {name for name in told[0] if "readings" not in name} == set(FAULTS)


def test_every_bad_reading_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faulty_stream, "SHARE", 0.5)
    told, resampler, seen = Counter[str](), Resampler(1 / HERTZ), Counter[str]()
    for block in readings(50, 4, told):
        for reading in block:
            found = resampler.feed(reading)
            assert np.isfinite(found.samples).all()
            seen.update({report.kind: report.count for report in found.reports})
    assert seen["not-finite"] == told["bad readings"] > 0
    assert seen["repeated"] == told["stamps twice, readings"] > 0
    assert min(seen["gap"], seen["late"], seen["jitter"]) > 0


def test_a_minute_through_the_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endurance, "MINUTE", 6)  # a short one
    day = endurance.Day(6, seed=1)
    assert day.minute()
    assert not day.minute()
    result = day.result()
    assert result["readings"] > 2000
    assert result["beliefs"] > 40
    assert result["beliefs that are no probabilities"] == 0
    assert result["memory, MB"]["largest minus least, warm"] < 20
    json.dumps(result, allow_nan=False)


def test_memory_that_grows_has_a_slope() -> None:
    noise = np.random.default_rng(0).normal(0, 0.1, 24 * 60)
    for hourly in (0.0, 1.0):
        said = endurance.memory_summary((600 + noise + hourly / 60 * np.arange(24 * 60)).tolist())
        assert said["MB per simulated hour, warm"] == pytest.approx(hourly, abs=2 * said["its interval, plus or minus"])
        assert said["its interval, plus or minus"] < 0.01


def test_viewers_follow_to_the_end() -> None:
    with PageServer(port=0) as server:
        command = [sys.executable, "-m", "experiments._lib.page_clients", server.url, "18"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as viewers:
            while len(server.broadcast._viewers) < 16:
                pass
            server.broadcast.publish({"sample": 1})
            server.broadcast.close()
            server.shutdown()
            server.server_close()
            seen = json.loads(viewers.communicate(timeout=60)[0])
    assert (seen["frames"], seen["followed to the end"]) == (16, 16)
