"""All devices of a machine against one: simulation with labels and storage, search for thresholds, labels.

Simulation is the command with its programs in the cache. Its work lasts from the first claim of a shard to the end of
the command; before that the command starts and loads. Search and labels are medians of calls that take turns and
have compiled, and their results must be the same bits. Run where there are GPUs:
python -m experiments.simulation.scaling FOLDER
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.experimental.layout import Format, Layout
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from experiments._lib.results_io import machine, record_of, write_result
from experiments._lib.timing import SAMPLES, recordings
from experiments.simulation.simulate_gpu import COMMAND, PRESET
from rcbht_jax._util.ratios import interleaved
from rcbht_jax.calibration.dataset import CalibrationData, device_calibration_data
from rcbht_jax.calibration.search import SearchOptions, score_candidates
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.io import store
from rcbht_jax.types import Array, LabelTracks
from sim_mjx.synthesis import claims, launch, shards

SEED = 0
TRIALS = 6_144  # of a device
SEARCHED = (65_536, 64, SAMPLES)  # candidates, trials and their samples
LOOK, QUANTILES = 0.2, (0.1, 0.5, 0.9, 1.0)  # s between two checks of a running command
SIZES = ((32_768, 5), (32_768, 20))  # recordings of a device, and the window
CALLS = (1, 16)  # one after another, none waited for
Section = Literal["simulation", "search", "labels"]
SECTIONS: tuple[Section, ...] = ("simulation", "search", "labels")


def watched(command: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    """Wait for the command; when each worker held its first and its last shard, and others, in s from now."""
    begun, held, shard_times = time.perf_counter(), dict[int, list[float]](), list[float]()
    while command.poll() is None:
        now = round(time.perf_counter() - begun, 1)
        if (folder / claims.FOLDER).is_dir() and shards.has_plan(folder):
            tries = [one for task, tries in claims.board(folder).items() if task.isdecimal() for one in tries]
            for pid in {one.pid for one in tries if one.state == "held" and one.pid}:
                held.setdefault(pid, [now, now])[1] = now
            shard_times += [now] * (len(shards.finished(folder)) - len(shard_times))
        time.sleep(LOOK)
    if command.returncode:
        raise SystemExit(f"the command ended with status {command.returncode}")
    return {
        "workers held shards from, to": sorted(held.values()),
        "a tenth, half, nine tenths, all shards there": np.quantile(shard_times, QUANTILES, method="higher").tolist(),
        "ended": round(time.perf_counter() - begun, 1),
    }


def simulated(folder: Path, trials: int, gpus: list[str]) -> dict[str, Any]:
    """Seconds of the command on some GPUs, and counts of its trials."""
    target = folder / f"{trials}-on-{len(gpus)}.zarr"
    made = [sys.executable, "-m", "rcbht_jax", *COMMAND, str(target), "--trials", str(trials)]
    made += ["--compile-cache", str(folder / "cache"), "--devices", str(len(gpus)), "--json"]
    env = {**os.environ, launch.DEVICES: ",".join(gpus)}
    with subprocess.Popen(made, env=env, stdout=subprocess.DEVNULL) as command:
        times = watched(command, shards.folder_of(target))
    table = store.read_table(target)
    shutil.rmtree(target)
    first = times["workers held shards from, to"][0][0]
    return {
        "trials": trials, "gpus": len(gpus), "seconds": times["ended"], "of_work": round(times["ended"] - first, 1),
        "times": times, "stored": len(table.length), "samples": int(table.length.sum()),
    }  # fmt: skip


def of_linear(one: dict[str, Any], all_of_them: dict[str, Any], key: str) -> float:
    """Rate of all devices over that of one, a device."""
    rate, base = (row["trials"] / row[key] for row in (all_of_them, one))
    return round(rate / base / (all_of_them["gpus"] / one["gpus"]), 3)


def simulation(folder: Path, each: int, gpus: list[str]) -> dict[str, Any]:
    """The same number of trials a device, on one and on all."""
    command = partial(simulated, folder)
    command(each, gpus[:1])  # compiles
    one, shared = command(each, gpus[:1]), command(each * len(gpus), gpus)
    return {
        "preset": PRESET, "one": one, "all": shared, "of linear": of_linear(one, shared, "of_work"),
        "of linear, start included": of_linear(one, shared, "seconds"),
    }  # fmt: skip


def equal_bits(alone: Callable[[], Any], shared: Callable[[], Any]) -> bool:
    """Whether two calls give the same."""
    both = zip(*(jax.tree.leaves(made()) for made in (alone, shared)), strict=True)
    return all(bool(jnp.array_equal(one, other)) for one, other in both)


def compared(
    alone: Callable[[], Any], shared: Callable[[], Any], work: float, same: bool, **about: Any
) -> dict[str, Any]:
    """A row: seconds of both.

    Args:
        alone, shared: the work on one device, and on all.
        work: how much of it a device does when they share it; 1 = as much as one alone.
        same: whether their results are the same bits.
        about: facts of the row.
    """
    found = interleaved(lambda: jax.block_until_ready(shared()), lambda: jax.block_until_ready(alone()))
    seconds = {"seconds_one": round(found.reference_seconds, 5), "seconds_all": round(found.seconds, 5)}
    return {**about, **seconds, "of linear": round(found.ratio * work, 3), "same bits": same}


def walks(trials: int, samples: int, config: EncoderConfig) -> CalibrationData:
    """Random walks with four sentences each."""
    edges = np.tile(np.linspace(0, samples, 5).astype(np.int32), (trials, 1))
    y = np.tile(np.arange(4, dtype=np.int32), (trials, 1))
    wrench = recordings(trials)[:, :samples]
    return device_calibration_data(config, wrench, jax.device_put(edges), jax.device_put(y), ("a", "b", "c", "d"))


def search(candidates: int, trials: int, samples: int) -> dict[str, Any]:
    """Scores of Sobol points."""
    config, options, devices = EncoderConfig(5), SearchOptions(candidates=candidates, seed=SEED), jax.devices()
    data, limits = walks(trials, samples, config), options.space.thresholds(options.points())
    scored = partial(score_candidates, data, config, limits)
    shared, about = partial(scored, devices=devices), {"candidates": candidates, "trials": trials, "samples": samples}
    return compared(scored, shared, 1 / len(devices), equal_bits(scored, shared), **about)


def labels(count: int, window: int) -> list[dict[str, Any]]:
    """Dense labels of recordings that are on the devices already, as many on each as on one alone.

    One row waits for every call, the other one has several in flight, as a program does that goes through a data set.
    """
    config, devices = EncoderConfig(window), jax.devices()
    mesh = Mesh(np.array(devices), ("recording",))
    rows, everywhere = PartitionSpec("recording"), PartitionSpec()
    shared = jax.shard_map(
        partial(encode, config), mesh=mesh, in_specs=(everywhere, rows, rows), out_specs=rows, check_vma=False
    )
    limits, wrench = jnp.asarray(preset().limits, jnp.float32), recordings(count * len(devices))
    length = jnp.full(len(wrench), SAMPLES, jnp.int32)
    places = (NamedSharding(mesh, everywhere), NamedSharding(mesh, rows), NamedSharding(mesh, rows))
    parts, first = jax.device_put((limits, wrench, length), places), (limits, wrench[:count], length[:count])

    def compiled(layout: Format | None) -> tuple[Callable[..., Any], Callable[..., Any]]:
        alone = jax.jit(partial(encode, config), out_shardings=layout)
        return alone.lower(*first).compile(), jax.jit(shared, out_shardings=layout).lower(*parts).compile()

    # in the usual layout: JAX 0.11 reads back wrongly what several devices hold in one of the compiler's choice
    plain, plain_shared = compiled(None)
    same, together = True, plain_shared(*parts)
    for number in range(len(devices)):  # one device's part at a time: the memory of one would not hold all
        at = slice(number * count, (number + 1) * count)
        alone = jax.tree.leaves(plain(limits, wrench[at], length[at]))
        same &= all(same_bits(one, number, other) for one, other in zip(alone, jax.tree.leaves(together), strict=True))
    del alone, together, wrench
    one, several = compiled(Format(Layout.AUTO))
    about = {"recordings": count, "together": count * len(devices), "window": window, "samples": SAMPLES}

    made = [
        compared(partial(repeated, n, one, *first), partial(repeated, n, several, *parts), 1.0, same, calls=n, **about)
        for n in CALLS
    ]
    return [row | {"samples_per_s_one": rate(count * SAMPLES * parts[1].shape[-1], row)} for row in made]


def rate(samples: int, row: dict[str, Any]) -> float:
    """Samples a second of one device, each axis counted."""
    return float(f"{samples * row['calls'] / row['seconds_one']:.4g}")


def repeated(times: int, function: Callable[..., Any], *given: Any) -> Any:
    """The last of several calls, none of which is waited for: a program that goes through a data set."""
    made = None
    for _ in range(times):
        made = function(*given)
    return made


def same_bits(alone: Array, number: int, shared: Array) -> bool:
    """Whether a device's part of what several hold is this; compared on a device, since a copy to the host is slow."""
    (device,) = alone.devices()
    parts = sorted(shared.addressable_shards, key=lambda part: part.index[0].start or 0)
    return bool(jnp.array_equal(alone, jax.device_put(parts[number].data, device)))


def compact_labels(count: int, window: int) -> list[dict[str, Any]]:
    """Labels in the compact form: each device has as many recordings of its own, a thread, and keeps their labels."""
    config, devices = EncoderConfig(window), jax.devices()
    given = recordings(count), jnp.full(count, SAMPLES, jnp.int32)
    tasks = [partial(encode_on_device, config, preset(), *jax.device_put(given, device)) for device in devices]
    about = {"recordings": count, "together": count * len(devices), "window": window, "samples": SAMPLES}
    with ExitStack() as stack:
        threads = [stack.enter_context(ThreadPoolExecutor(1)) for _ in devices]

        def shared(times: int = 1) -> list[LabelTracks]:
            begun = [thread.submit(repeated, times, task) for thread, task in zip(threads, tasks, strict=True)]
            return [one.result() for one in begun]

        same = all(equal_bits(tasks[0], lambda one=one: jax.device_put(one, devices[0])) for one in shared())
        return [
            compared(partial(repeated, n, tasks[0]), partial(shared, n), 1.0, same, calls=n, **about, compact=True)
            for n in CALLS
        ]


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    only: tuple[Section, ...] = SECTIONS,
) -> None:
    """Measure and store.

    Args:
        folder: for stores, which are deleted, and compiled programs.
        only: what is measured; the rest of the result stays.
    """
    gpus = launch.visible_devices()
    result: dict[str, Any] = record_of("scaling").get("result", {}) | {"devices": max(1, len(gpus))}
    if "simulation" in only:
        result["simulation"] = simulation(folder, TRIALS, gpus)
        print(json.dumps(result), flush=True)
    if "search" in only:
        result["search"] = search(*SEARCHED)
        print(json.dumps(result["search"]), flush=True)
    if "labels" in only:
        result["labels"] = []
        for made, size in product((labels, compact_labels), SIZES):
            result["labels"] += made(*size)
            print(json.dumps(result["labels"]), flush=True)
    print(machine())
    write_result("scaling", "python -m experiments.simulation.scaling FOLDER", result, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
