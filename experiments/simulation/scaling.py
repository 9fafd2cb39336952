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
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.experimental.layout import Format, Layout
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from experiments._lib.random_walks import SAMPLES, recordings
from experiments._lib.results_io import machine, write_result
from experiments.simulation.simulate_gpu import COMMAND
from rcbht_jax._util.ratios import interleaved
from rcbht_jax.calibration.dataset import CalibrationData, device_calibration_data
from rcbht_jax.calibration.search import SearchOptions, score_candidates
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.io import store
from rcbht_jax.types import Array
from sim_mjx.synthesis import claims, launch, shards

SEED = 0
Section = Literal["simulation", "search", "labels"]
SECTIONS: tuple[Section, ...] = ("simulation", "search", "labels")


def simulated(folder: Path, trials: int, gpus: list[str]) -> dict[str, Any]:
    """Seconds of the command on some GPUs, and what became of the trials."""
    target = folder / f"{trials}-on-{len(gpus)}.zarr"
    made = [sys.executable, "-m", "rcbht_jax.cli", *COMMAND, str(target), "--trials", str(trials)]
    made += ["--compile-cache", str(folder / "cache"), "--devices", str(len(gpus)), "--json"]
    waiting, begun = shards.folder_of(target) / claims.FOLDER, time.perf_counter()
    with subprocess.Popen(
        made, env={**os.environ, launch.DEVICES: ",".join(gpus)}, stdout=subprocess.DEVNULL
    ) as command:
        while command.poll() is None and not (waiting.is_dir() and any(waiting.iterdir())):
            time.sleep(0.02)
        work = time.perf_counter()
        if command.wait():
            raise SystemExit(f"the command with {trials} trials on {len(gpus)} GPUs failed")
    ended = time.perf_counter()
    table = store.read_table(target)
    shutil.rmtree(target)
    return {
        "trials": trials, "gpus": len(gpus), "seconds": round(ended - begun, 1), "of_work": round(ended - work, 1),
        "stored": len(table.length), "samples": int(table.length.sum()),
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
        "one": one, "all": shared, "of linear": of_linear(one, shared, "of_work"),
        "of linear, start included": of_linear(one, shared, "seconds"),
    }  # fmt: skip


def same_bits(alone: Array, shared: Array) -> bool:
    """Compared on the devices, part by part: a copy to the host would turn the layout of gigabytes."""
    parts = [(jax.device_put(alone[part.index], part.device), part.data) for part in shared.addressable_shards]
    return all(bool(jnp.array_equal(one, other)) for one, other in parts)


def compared(alone: Callable[[], Any], shared: Callable[[], Any], devices: int, **about: Any) -> dict[str, Any]:
    """Seconds of both, and whether their results are the same bits."""
    leaves = [jax.tree.leaves(jax.tree.map(jnp.asarray, work())) for work in (alone, shared)]
    equal = all(same_bits(one, other) for one, other in zip(*leaves, strict=True))
    del leaves
    found = interleaved(lambda: jax.block_until_ready(shared()), lambda: jax.block_until_ready(alone()))
    seconds = {"seconds_one": round(found.reference_seconds, 5), "seconds_all": round(found.seconds, 5)}
    return {**about, **seconds, "of linear": round(found.ratio / devices, 3), "same bits": equal}


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
    return compared(
        scored, partial(scored, devices=devices), len(devices), candidates=candidates, trials=trials, samples=samples
    )


def labels(count: int, window: int) -> dict[str, Any]:
    """Dense labels of recordings that are on the devices already, one part on each."""
    config, devices = EncoderConfig(window), jax.devices()
    mesh = Mesh(np.array(devices), ("recording",))
    rows, everywhere = PartitionSpec("recording"), PartitionSpec()
    shared = jax.shard_map(
        partial(encode, config), mesh=mesh, in_specs=(everywhere, rows, rows), out_specs=rows, check_vma=False
    )
    given = jnp.asarray(preset().limits, jnp.float32), recordings(count), jnp.full(count, SAMPLES, jnp.int32)
    places = (NamedSharding(mesh, everywhere), NamedSharding(mesh, rows), NamedSharding(mesh, rows))
    parts = jax.device_put(given, places)
    one = jax.jit(partial(encode, config), out_shardings=Format(Layout.AUTO)).lower(*given).compile()
    several = jax.jit(shared, out_shardings=Format(Layout.AUTO)).lower(*parts).compile()
    return compared(
        partial(one, *given), partial(several, *parts), len(devices), recordings=count, window=window, samples=SAMPLES
    )


def compact_labels(count: int, window: int) -> dict[str, Any]:
    """Labels in the compact form, of recordings on the first device that go to the others and come back."""
    config, devices = EncoderConfig(window), jax.devices()
    work = partial(
        encode_on_device, config, preset(), recordings(count), jnp.full(count, SAMPLES, jnp.int32), batch=2048
    )
    return compared(
        work,
        partial(work, devices=devices),
        len(devices),
        recordings=count,
        window=window,
        samples=SAMPLES,
        compact=True,
    )


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    each: int = 20_480,
    candidates: int = 16_384,
    trials: int = 64,
    samples: int = SAMPLES,
    count: int = 32_768,
    only: tuple[Section, ...] = SECTIONS,
) -> None:
    """Measure and store.

    Args:
        folder: for stores, which are deleted, and compiled programs.
        each: trials a device.
        candidates: of the search.
        trials: of the search.
        samples: of a trial of the search.
        count: recordings to label.
        only: what is measured.
    """
    gpus = launch.visible_devices()
    result: dict[str, Any] = {"devices": max(1, len(gpus))}
    if "simulation" in only:
        result["simulation"] = simulation(folder, each, gpus)
        print(json.dumps(result), flush=True)
    if "search" in only:
        result["search"] = search(candidates, trials, samples)
        print(json.dumps(result["search"]), flush=True)
    if "labels" in only:
        result["labels"] = [labels(count, window) for window in (5, 20)] + [compact_labels(count, 5)]
        print(json.dumps(result["labels"]), flush=True)
    print(machine())
    write_result("scaling", "python -m experiments.simulation.scaling FOLDER", result, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
