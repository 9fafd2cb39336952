"""Where the time of a physics step goes on a GPU: its length by the number of lanes, and its kernels.

Trials of session B, first moving freely, then in contact, most of them mating. A step includes its share of controller,
sensor and state machine; nothing is stored. Run on a GPU: python -m experiments.simulation.step_profile --engine fused
"""

from __future__ import annotations

import gzip
import json
import re
import statistics
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, Literal

import jax
import tyro

from experiments._lib.results_io import write_result
from experiments.simulation.engines import PRESET, SEED, trials_of
from sim_mjx import engines
from sim_mjx.assembly.rollout import as_float32
from sim_mjx.engines import device, lanes
from sim_mjx.registry import get_scenario

COUNTS = (1024, 8192, 32768)
TRACED = 8192  # lanes
FREE = slice(1, 15)  # stretches of 100 control periods, until shortly before contact; the first one compiles
CONTACT = slice(36, 44)  # likewise, long after it
LONGEST = 25.0  # s
SHOWN = 70  # kernels, the longest; the others are summed up
OTHERS = "others"
KINDS = {  # of kernels, by what their names contain; the first that fits
    "solver": "gradient|linesearch|update_constraint|solve|cholesky|mul_m|jaref|conditional",
    "contacts and constraint rows": "narrowphase|broadphase|efc|limit|friction_dof|cfrc_ext_contact",
    "controller, sensor and copies": "^loop_|^input_|memset|memcpy|copy",
    "kinematics, dynamics and integration": "",
}


def begun(count: int, engine: str) -> tuple[Any, ...]:
    """Compiled programs and the state of lanes in which trials begin."""
    scene, params = get_scenario(PRESET).scene(), trials_of(count, LONGEST)
    model, empty = device.put_scene(scene, count, engines.ON_DEVICE[engine])
    fields, params = jax.device_put((device.fields_of(scene, params), as_float32(params)))
    fixed = device.Fixed(model, fields, params, empty)
    layout, programs = device.layout_of(scene), lanes._programs(jax.default_backend())
    return programs.stretch, layout, fixed, programs.start(layout, fixed)


def speed(count: int, engine: str, traced: bool) -> tuple[dict[str, float], dict[str, Any]]:
    """Milliseconds of a step, medians over stretches, and the kernels of a stretch of each kind if they are traced."""
    stretch, layout, fixed, state = begun(count, engine)
    steps, seconds, profiles = device.STRETCH * layout.substeps, list[float](), dict[str, Any]()
    for number in range(CONTACT.stop):
        start = time.perf_counter()
        state, log = stretch(layout, fixed, state)
        jax.block_until_ready(log)
        seconds.append((time.perf_counter() - start) / steps)
        if traced and number + 1 in (FREE.stop, CONTACT.stop):
            events, state = trace(stretch, layout, fixed, state)
            profiles["free" if number < CONTACT.start else "contact"] = kernels(events, steps)
    row = {}
    for name, which in (("free", FREE), ("contact", CONTACT)):
        step = statistics.median(seconds[which])
        row |= {f"{name}_ms": round(1e3 * step, 4), f"{name}_steps_per_s": round(count / step)}
    return row, profiles


def trace(
    stretch: Any, layout: device.Layout, fixed: device.Fixed, state: Any
) -> tuple[list[dict[str, Any]], device.State]:
    """Events of the profiler's trace of one stretch, and the state after it."""
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            state, log = stretch(layout, fixed, state)
            jax.block_until_ready(log)
        (file,) = Path(folder).rglob("*.trace.json.gz")
        events: list[dict[str, Any]] = json.loads(gzip.decompress(file.read_bytes()))["traceEvents"]
        return events, state


def kernels(events: list[dict[str, Any]], steps: int) -> dict[str, dict[str, float]]:
    """Microseconds and launches of a step by kernel, the longest first; events of the host are left out."""
    named = [one for one in events if one.get("ph") == "M" and "name" in one["args"]]
    places = {one["pid"]: one["args"]["name"] for one in named if one["name"] == "process_name"}
    streams = {(one["pid"], one["tid"]): one["args"]["name"] for one in named if one["name"] == "thread_name"}
    found = defaultdict[str, list[float]](list)
    for one in (one for one in events if one.get("ph") == "X" and "GPU" in places[one["pid"]]):
        if streams.get((one["pid"], one["tid"]), "").startswith("Stream"):
            found[_name(one["name"])].append(one["dur"])
    rows = {
        name: {"us": round(sum(took) / steps, 2), "launches": round(len(took) / steps, 2)}
        for name, took in found.items()
    }
    return dict(sorted(rows.items(), key=lambda row: -row[1]["us"]))


def _name(kernel: str) -> str:
    """A kernel without the digest of its source."""
    return re.sub(r"(__locals__\w+?)?_[0-9a-f]{8}_cuda_kernel_forward$|^_(?=[a-zA-Z])", "", kernel).lstrip("_")


def by_kind(rows: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Sums over kernels of a kind; of the longest ones only, since the short ones have names of many kinds."""
    sums = {kind: {"us": 0.0, "launches": 0.0} for kind in (*KINDS, OTHERS)}
    for place, (name, row) in enumerate(rows.items()):
        kind = next(kind for kind, pattern in KINDS.items() if re.search(pattern, name))
        kind = kind if place < SHOWN else OTHERS
        for key, value in row.items():
            sums[kind][key] = round(sums[kind][key] + value, 2)
    total = sum(row["us"] for row in sums.values())
    return {kind: row | {"share": round(row["us"] / total, 3)} for kind, row in sums.items()}


def main(engine: Literal["warp", "fused"]) -> None:
    """Measure and store."""
    out: dict[str, Any] = {"engine": engine, "preset": PRESET, "lanes": {}}
    for count in COUNTS:
        out["lanes"][str(count)], profiles = speed(count, engine, count == TRACED)
        for name, rows in profiles.items():
            longest = dict(list(rows.items())[:SHOWN])
            out[f"traced_{name}"] = {"lanes": TRACED, "kinds": by_kind(rows), "kernels": longest}
    command = f"python -m experiments.simulation.step_profile --engine {engine}"
    write_result("step_profile" if engine == "warp" else "step_profile_fused", command, out, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main)
