"""Speed of the encoder on the default device, for many recordings, compared with the scan that it replaces on a GPU.

A sample is one number of one axis. Recordings are in the device's memory before the clock starts; compilation apart;
medians. Dense labels in the layout "time first", in which the kernel writes, and "row by row", JAX's default, which
costs a transposition; and the compact form, whose width the host learns from the device. Run on a GPU:
python -m experiments.words.encoder_speed
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import tyro
from jax.experimental.layout import Format, Layout

from experiments._lib.results_io import write_result
from experiments._lib.timing import AXES, SAMPLES, recordings, seconds_of, timed
from rcbht_jax.encoding import encoder, gpu
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.types import Array, LabelTracks

SEED = 0
WINDOWS, COUNTS, REPEATS = (5, 20), (1024, 8192, 32768), 15  # samples per linear fit; recordings
SCANNED = 1024  # recordings of the comparison with the scan


def calls(work: Callable[[], Any], repeats: int) -> dict[str, Any]:
    """Seconds of compilation, by the first call, and of the others."""
    first, others = timed(work, repeats)
    median = statistics.median(others)
    return {"compile_s": round(first - median, 2), "seconds": [round(value, 6) for value in others]}


def speed(function: Callable[..., LabelTracks], wrench: Array, layout: bool, repeats: int) -> dict[str, Any]:
    """Samples per second, each axis counted, of a function of (thresholds, wrench, lengths)."""
    limits = jnp.asarray(preset().limits, jnp.float32)
    length = jnp.full(len(wrench), SAMPLES, jnp.int32)
    compiled = jax.jit(function, out_shardings=Format(Layout.AUTO) if layout else None)
    run, compiling = seconds_of(lambda: compiled.lower(limits, wrench, length).compile())
    row = calls(lambda: run(limits, wrench, length), repeats)
    row["compile_s"] = round(compiling, 2)
    return row | _rate(wrench, row)


def compact(config: EncoderConfig, wrench: Array, repeats: int) -> dict[str, Any]:
    """Samples per second of the compact form."""
    limits, length = jnp.asarray(preset().limits, jnp.float32), jnp.full(len(wrench), SAMPLES, jnp.int32)
    row = calls(lambda: encode_on_device(config, limits, wrench, length), repeats)
    return row | _rate(wrench, row)


def _rate(wrench: Array, row: dict[str, Any]) -> dict[str, Any]:
    return {"samples_per_s": round(wrench.size / statistics.median(row["seconds"]))}


def scan(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> LabelTracks:
    """The encoder as it is without the kernel."""
    kept, gpu.fits = gpu.fits, lambda *_: False
    try:
        return encoder.encode(config, limits, wrench, length)
    finally:
        gpu.fits = kept


def main() -> None:
    """Measure and store."""
    rows: dict[str, dict[str, Any]] = {}
    for window in WINDOWS:
        config = EncoderConfig(window=window)
        mine = rows.setdefault(f"W{window}", {})
        for count in COUNTS:
            wrench = jax.block_until_ready(recordings(count))
            mine[str(count)] = {
                "time first": speed(partial(encoder.encode, config), wrench, True, REPEATS),
                "row by row": speed(partial(encoder.encode, config), wrench, False, REPEATS),
                "compact": compact(config, wrench, REPEATS),
            }
            if count == SCANNED:
                mine[str(count)]["scan"] = speed(partial(scan, config), wrench, False, 3)
    result = {"samples": SAMPLES, "axes": AXES, "repeats": REPEATS, "windows": rows}
    write_result("encoder_speed", "python -m experiments.words.encoder_speed", result, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main)
