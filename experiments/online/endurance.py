"""A day of stream at 500 Hz from a sensor that fails, in compressed time: memory and time per reading stay the same.

* stream: readings of :mod:`experiments._lib.faulty_stream` through resampler, encoder and classifier, one by one, as
  "rcbht stream" feeds them; memory each simulated minute, time by quarter, and whether every reading that must be left
  out was reported. The result is written each simulated hour, so that an interrupted run keeps it;
* messages: hostile lines through the reader of streams and the chain;
* page: an hour of the same stream on the live page, as fast as it goes, before viewers in another process.

Run: python -m experiments.online.endurance
Memory is the result. Times are those of this machine, and mean little if other programs run.
"""

from __future__ import annotations

import io
import json
import math
import os
import random
import resource
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.stats import linregress

from experiments._lib.faulty_stream import HERTZ, readings
from experiments._lib.results_io import parts_of, write_result
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.events import Belief
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import Head, IntrospectionModel
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Begin, Malformed, Message, Reset, Sample, read_lines
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.report.live_frames import Frames
from rcbht_jax.report.live_page import PageServer

WINDOW = 50  # samples, 100 ms
RATE = 10.0  # beliefs per second of stream
HOUR, MINUTE = 3600, 60
QUARTERS = 4
QUANTILES = {"median": 0.5, "p99": 0.99}
WARM = 60  # minutes of stream after which memory must not grow


def megabytes() -> float:
    """Memory that this process holds now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def model() -> IntrospectionModel:
    """A classifier of two classes, trained on random features: its beliefs are not used."""
    spec, rng = FeatureSpec(families=("histogram",)), np.random.default_rng(0)
    x, y = rng.normal(size=(200, len(names(spec, 6)))), np.arange(200) % 2
    machine = ProbabilisticSvm(fit(x + y[:, None], y, ("a", "b"), SvmSpec("rbf", 1.0, True)), np.array([[-1.0, 0.0]]))
    head = Head("states", "subtask", FeatureView(spec), machine)
    config = EncoderConfig(window=WINDOW, dt=1 / HERTZ)
    return IntrospectionModel(config, np.asarray(preset().limits), (head,), "endurance")


class Day:
    """A stream through the chain, and what is measured of it."""

    def __init__(self, seconds: int, seed: int) -> None:
        self._faults: Counter[str] = Counter()
        self._stream = readings(seconds, seed, self._faults)
        self.session = Session(Introspector(model(), rate=RATE))
        self.session.introspector.warm_up()
        self.memory = [megabytes()]  # after each minute
        self.processor: list[float] = []  # s of each minute
        # s of single readings, of a second each minute; all there from the start, so that it is no growth
        self.latency = np.full((math.ceil(seconds / MINUTE), 2 * HERTZ), np.nan)
        self.readings = self.beliefs = self.wrong = self.done = 0

    def minute(self) -> bool:
        """Feed one minute; returns whether there was one."""
        start = time.process_time()
        for second in range(MINUTE):
            block = next(self._stream, None)
            if block is None:
                return False
            self.readings += len(block)
            self.done += 1
            times = self.latency[self.done // MINUTE] if second == 0 else None
            for k, reading in enumerate(block):
                began = time.perf_counter()
                events = self.session.feed(reading)
                if times is not None:
                    times[k] = time.perf_counter() - began
                for event in events:
                    if isinstance(event, Belief):
                        self.beliefs += 1
                        self.wrong += not abs(sum(event.probabilities) - 1) < 1e-3  # NaN is wrong, too
        self.processor.append(time.process_time() - start)
        self.memory.append(megabytes())
        return True

    def result(self) -> dict[str, Any]:
        """Everything measured so far."""
        counts, faults = self.session.counts, self._faults
        return {
            "simulated hours": round(self.done / HOUR, 3),
            "readings": self.readings,
            "faults": {name: faults[name] for name in sorted(faults) if "readings" not in name},
            "beliefs": self.beliefs,
            "beliefs that are no probabilities": self.wrong,
            "readings left out as not finite, and those that were": [counts["not-finite"], faults["bad readings"]],
            "readings left out as repeated, and those that were": [
                counts["repeated"],
                faults["stamps twice, readings"],
            ],
            "notices": {name: counts[name] for name in ("gap", "late", "jitter", "malformed")},
            "memory, MB": memory_summary(self.memory),
            "processor seconds per simulated minute, median by quarter": _quarters(self.processor),
            "one reading, ms": [_latency(part) for part in np.array_split(self.latency, QUARTERS)],
        }


def memory_summary(memory: list[float]) -> dict[str, Any]:
    """Memory by quarter, and its slope once the stream is warm, with the interval of 95 % of a straight line."""
    warm = np.array(memory[min(WARM, len(memory) // 4) :])
    line = linregress(np.arange(len(warm)) / 60, warm) if len(warm) > 2 else None
    return {
        "at the start": round(memory[0], 1),
        "median by quarter": _quarters(memory[1:]),
        "largest minus least, warm": round(float(warm.max() - warm.min()), 1) if len(warm) else None,
        "MB per simulated hour, warm": line and round(float(line.slope), 4),
        "its interval, plus or minus": line and round(1.96 * float(line.stderr), 4),
    }


def _quarters(values: list[float]) -> list[float]:
    return [round(float(np.median(part)), 3) for part in np.array_split(values, QUARTERS) if len(part)]


def _latency(times: NDArray[np.float64]) -> dict[str, float]:
    """Quantiles, empty where nothing has been timed."""
    known = times[np.isfinite(times)]
    return {name: round(float(np.quantile(known, q)) * 1e3, 3) for name, q in QUANTILES.items() if len(known)}


def hostile_line(rng: random.Random) -> bytes:
    """A line that a broken or malicious source might send."""
    good = {"wrench": [rng.gauss(0, 10) for _ in range(6)], "time": rng.uniform(0, 100)}
    kind = rng.randrange(8)
    if kind == 0:
        return rng.randbytes(rng.randrange(200)).replace(b"\n", b" ")
    if kind == 1:
        return b"[" * rng.randrange(1, 5000)
    if kind == 2:
        good["time"] = rng.choice([1e308, -1e308, 0.0, 1e-300, float(2**63), rng.uniform(-1e9, 1e9)])
    elif kind == 3:
        good["wrench"][rng.randrange(6)] = rng.choice([1e308, -1e38, None, "1", True, [], {}])  # type: ignore[call-overload]
    elif kind == 4:
        return json.dumps(good).encode()[: rng.randrange(60)]
    elif kind == 5:
        return rng.choice([b'{"begin": true}', b'{"reset": true}', b"NaN", b'{"wrench": 1}', b'{"time": 1}'])
    return json.dumps(good).encode()


def messages_of(count: int, seed: int) -> dict[str, Any]:
    """Hostile lines through the reader and the chain."""
    rng, session = random.Random(seed), Session(Introspector(model(), rate=2.0))
    session.introspector.warm_up()
    memory, kinds, longest = [megabytes()], dict.fromkeys((Sample, Begin, Reset, Malformed), 0), 0.0
    for _ in range(10):
        for _ in range(max(1, count // 10_000)):
            block = io.BytesIO(b"\n".join(hostile_line(rng) for _ in range(1000)) + b"\n")
            for message in read_lines(block):
                kinds[type(message)] = kinds.get(type(message), 0) + 1
                longest = max(longest, _seconds(session, message))
        memory.append(megabytes())
    return {
        "messages": sum(kinds.values()),
        "by kind": {kind.__name__: number for kind, number in kinds.items()},
        "longest message, ms": round(longest * 1e3, 1),
        "memory before and after each tenth, MB": [round(m, 1) for m in memory],
    }


def _seconds(session: Session, message: Message) -> float:
    start = time.perf_counter()
    session.feed(message)
    return time.perf_counter() - start


def page(seconds: int, clients: int, seed: int) -> dict[str, Any]:
    """A stream on the live page before viewers, as fast as it goes."""
    session = Session(Introspector(model(), rate=RATE))
    session.introspector.warm_up()
    memory, start = [], time.perf_counter()
    with PageServer(session, port=0) as server:
        frames = Frames(session, server.broadcast)
        command = [sys.executable, "-m", "experiments._lib.page_clients", server.url, str(clients)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as viewers:
            time.sleep(2)  # until they have connected
            for second, block in enumerate(readings(seconds, seed, Counter())):
                for reading in block:
                    frames.feed(reading)
                if second % MINUTE == 0:
                    memory.append(megabytes())
            frames.finish()
            server.broadcast.close()
            took = time.perf_counter() - start
            time.sleep(2)  # until they have read the end
            server.shutdown()
            server.server_close()
            printed, _ = viewers.communicate(timeout=120)
    return {
        "simulated seconds": seconds,
        "took, s": round(took),
        "clients": clients,
        "of them all": json.loads(printed),
        "memory, MB": memory_summary(memory),
    }


PARTS = ("page", "messages", "stream")


def main(
    hours: float = 24.0,
    messages: int = 1_000_000,
    page_hours: float = 1.0,
    clients: int = 20,
    seed: int = 0,
    parts: tuple[Literal["page", "messages", "stream"], ...] = PARTS,
) -> None:
    """Measure; every option has the size of the committed result.

    Args:
        hours: of the stream, simulated.
        messages: hostile lines.
        page_hours: of the stream on the page, simulated.
        clients: viewers of the page.
        seed: of noise, faults and lines.
        parts: what to measure, beside what is there already of a run with these options.
    """
    command = (
        f"python -m experiments.online.endurance --hours {hours:g} --messages {messages} --page-hours {page_hours:g} "
        f"--clients {clients} --seed {seed}"
    )

    def keep(part: str, value: dict[str, Any], show: bool = False) -> None:
        done = parts_of("endurance", command, PARTS)
        done[part] = {"load of the machine, processes": round(os.getloadavg()[0], 1), **value}
        about = {"window, samples": WINDOW, "readings per second": HERTZ, "hours asked for": hours}
        write_result("endurance", command, {**about, **done}, seed, show)

    if "page" in parts:
        keep("page", page(round(page_hours * HOUR), clients, seed))
    if "messages" in parts:
        keep("messages", messages_of(messages, seed))
    if "stream" in parts:
        day = Day(round(hours * HOUR), seed)
        while day.minute():
            if day.done % HOUR == 0:
                keep("stream", day.result())
        keep("stream", day.result(), show=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
