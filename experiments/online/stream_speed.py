"""Latency, start-up, memory and robustness of the streaming chain, six axes, window to belief.

* latency: wall time of single pushes of one window, each of which gives a belief, on real trials;
* start: from the model file to the first belief in a fresh process, compilation included, with and without a warm
  compilation cache;
* length: memory and time per push over a long stream;
* fuzz: hostile messages to the reader of JSON lines and to the resampler, and hostile requests to the page.

Run on an otherwise idle machine: python -m experiments.online.stream_speed MODEL --pushes 100000 --samples 10000000
MODEL is made by "rcbht train-online". Every part measured is kept; --parts measures some of them (again).
Reads the recorded trials (RCBHT_DATA) for the signal.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.catalogue import DATA
from experiments._lib.results_io import parts_of, write_result
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Begin, Malformed, Message, Reset, Sample, read_lines
from rcbht_jax.io.playback import read_folder
from rcbht_jax.report.live_page import PageServer

TRIAL = "REAL_HIRO_ONE_SA_SUCCESS/20121127-HIROSA-S-13"
START = """
import resource, sys, time
start = time.perf_counter()
from pathlib import Path
from rcbht_jax._util import compile_cache
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
if sys.argv[2]:
    compile_cache.use(Path(sys.argv[2]))
introspector = Introspector(load(Path(sys.argv[1])), rate=None)
assert introspector.push([[0.0] * 6] * introspector.model.encoder.window)
used = resource.getrusage(resource.RUSAGE_SELF)
print(time.perf_counter() - start, used.ru_utime + used.ru_stime)
"""
Part = Literal["start", "latency", "long stream", "fuzzed messages", "fuzzed page"]
PARTS: tuple[Part, ...] = get_args(Part)
QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "largest": 1.0}


def signal(data: Path) -> NDArray[np.float32]:
    return np.array([m.wrench for m in read_folder(data / TRIAL) if isinstance(m, Sample)], np.float32)


def megabytes() -> float:
    """Memory that this process holds now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def latency(model: Path, wrench: NDArray[np.float32], pushes: int) -> dict[str, float]:
    """Wall and processor time of single pushes; the latter is the same on a busy machine."""
    introspector = Introspector(load(model), rate=None)
    introspector.warm_up()
    window = introspector.model.encoder.window
    windows = wrench[: len(wrench) // window * window].reshape(-1, window, 6)
    wall, processor = np.empty(pushes), np.empty(pushes)
    for k in range(pushes):
        piece = windows[k % len(windows)]
        start, used = time.perf_counter(), time.process_time()
        introspector.push(piece)
        wall[k], processor[k] = time.perf_counter() - start, time.process_time() - used
    return {
        f"{name}, {what}ms": round(float(np.quantile(seconds, q)) * 1e3, 3)
        for what, seconds in (("", wall), ("processor ", processor))
        for name, q in QUANTILES.items()
    }


def start_up(model: Path) -> dict[str, dict[str, float]]:
    """Wall and processor seconds of a fresh process from the first import to the first belief."""

    def once(cache: str) -> dict[str, float]:
        command = [sys.executable, "-c", START, str(model), cache]
        output = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        return {"wall, s": round(float(output[0]), 2), "processor, s": round(float(output[1]), 2)}

    with tempfile.TemporaryDirectory() as folder:
        return {"cold": once(""), "filling the cache": once(folder), "warm cache": once(folder)}


def long_stream(model: Path, wrench: NDArray[np.float32], samples: int) -> dict[str, Any]:
    introspector = Introspector(load(model), rate=2.0)
    introspector.push(wrench)
    introspector.reset()
    memory, seconds, tenth = [megabytes()], [], samples // 10
    for _ in range(10):
        start = time.perf_counter()
        for _ in range(max(1, tenth // len(wrench))):
            introspector.push(wrench)
        seconds.append(round(time.perf_counter() - start, 1))
        memory.append(megabytes())
    probabilities = introspector.latest[introspector.model.heads[0].name].probabilities
    return {
        "samples": introspector.received,
        "seconds per tenth": seconds,
        "memory before and after each tenth, MB": [round(m, 1) for m in memory],
        "beliefs finite at the end": bool(np.isfinite(probabilities).all()),
    }


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


def fuzz_stream(model: Path, count: int, seed: int) -> dict[str, Any]:
    rng, session = random.Random(seed), Session(Introspector(load(model), rate=2.0))
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


def fuzz_page(model: Path, count: int, seed: int) -> dict[str, Any]:
    rng, answers, memory = random.Random(seed), {}, [megabytes()]
    with PageServer(Session(Introspector(load(model))), port=0) as server:
        address = server.server_address[:2]
        for number in range(count):
            request = rng.choice(
                [rng.randbytes(rng.randrange(300)), b"GET /" + rng.randbytes(20) + b" HTTP/1.1\r\n\r\n"]
            )
            request = rng.choice(
                [
                    request,
                    b"POST / HTTP/1.1\r\nContent-Length: 99\r\n\r\n",
                    b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
                ]
            )
            with socket.create_connection(address, timeout=20) as client:  # type: ignore[arg-type]
                client.sendall(request)
                client.shutdown(socket.SHUT_WR)
                try:
                    reply = client.recv(12)
                except ConnectionResetError:
                    reply = b"reset"
            code = reply[9:12].decode("ascii", "replace") if reply.startswith(b"HTTP/") else "other"
            answers[code] = answers.get(code, 0) + 1
            if number % max(1, count // 10) == 0:
                memory.append(megabytes())
    return {"requests": count, "answers": answers, "memory along the way, MB": [round(m, 1) for m in memory]}


def main(
    model: tyro.conf.Positional[Path], pushes: int = 100_000, samples: int = 10_000_000, messages: int = 1_000_000,
    requests: int = 20_000, parts: tuple[Part, ...] = PARTS, seed: int = 0,
) -> None:  # fmt: skip
    wrench = signal(DATA)
    head = load(model).heads[0].machine.svm
    work: dict[str, Callable[[], Any]] = {
        "start": lambda: start_up(model),
        "latency": lambda: latency(model, wrench, pushes),
        "long stream": lambda: long_stream(model, wrench, samples),
        "fuzzed messages": lambda: fuzz_stream(model, messages, seed),
        "fuzzed page": lambda: fuzz_page(model, requests, seed),
    }
    about = {"kernel": head.spec.kernel, "features": head.center.size, "support vectors": len(head.support)}
    sizes = f"--pushes {pushes} --samples {samples} --messages {messages} --requests {requests}"
    command = f"python -m experiments.online.stream_speed MODEL {sizes} --seed {seed}"
    done = parts_of("stream_speed", command, ("model", *PARTS))
    if done.pop("model", None) != about:
        done = {}
    for part in parts:
        busy = round(os.getloadavg()[0], 1)
        done[part] = {"load of the machine before, processes": busy, **work[part]()}
        result = {"model": about, "complete": set(done) == set(PARTS), **done}
        write_result("stream_speed", command, result, seed, show=part == parts[-1])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
