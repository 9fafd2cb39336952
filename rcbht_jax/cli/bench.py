"""``rcbht bench``: speed and memory of the encoders on one machine, with peers measured in the same run."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.cli.command import Command, announce
from rcbht_jax.errors import InputError

_REPEATS = 7
DT = 0.005


@dataclass(frozen=True)
class Bench(Command):
    """Measure speed and memory of the encoders on this machine: medians, with compile time listed separately.

    The extra "bench" installs other symbolic representations (tslearn, fABBA), which are measured on the same array.

    Example: rcbht bench --trials 100
    """

    trials: int = 100
    """Trials of six axes in the batch."""
    samples: int = 2000
    """Samples per trial."""

    def run(self) -> dict[str, Any]:
        import jax

        if self.trials < 1 or self.samples < 20:
            raise InputError(
                f"{self.trials} trials of {self.samples} samples are too few; expected at least 1 trial of 20."
            )
        wrench = signal(self.trials, self.samples)
        announce(1, 4, "batch encoder")
        batch = {f"W={window}": batch_encoder(wrench, window) for window in (5, 20)}
        announce(2, 4, "streaming encoder")
        streaming = streaming_step()
        announce(3, 4, "offline encoder")
        offline = offline_trial()
        announce(4, 4, "other representations")
        speeds = peers(wrench, 5)
        ours = batch["W=5"]["samples_per_second"]
        return {
            "devices": [str(device) for device in jax.devices()],
            "batch": batch,
            "streaming": streaming,
            "offline_seconds_for_33_s": offline,
            "peers_samples_per_second": speeds,
            "ratio_to_peers": {name: ours / speed for name, speed in speeds.items()},
        }

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"devices: {', '.join(result['devices'])}"]
        for name, row in result["batch"].items():
            lines.append(
                f"batch {name}, {row['lanes']} lanes: {row['samples_per_second'] / 1e6:.1f} M samples/s "
                f"(compile {row['compile_seconds']:.1f} s), working memory {row['working_memory_over_wrench']:.1f} x "
                f"the wrench, {row['label_bytes_per_slot']:.1f} bytes per label slot"
            )
        step = result["streaming"]
        lines.append(
            f"streaming step, six axes: {step['microseconds_in_scan']:.1f} us in a scan, single call "
            f"{step['microseconds_single_call_median']:.0f} us median, "
            f"{step['microseconds_single_call_p99']:.0f} us p99"
        )
        lines.append(f"offline encoder: {result['offline_seconds_for_33_s']:.3f} s for a 33 s trial")
        for name, speed in result["peers_samples_per_second"].items():
            lines.append(f"{name}: {speed / 1e6:.3f} M samples/s; ours is {result['ratio_to_peers'][name]:.1f} x")
        if not result["peers_samples_per_second"]:
            lines.append('others: none installed; pip install "rcbht-jax[bench]"')
        return "\n".join(lines)


def signal(trials: int, samples: int, seed: int = 0) -> NDArray[np.float32]:
    """Random walks ``[trials, samples, 6]`` with the slopes of a snap assembly: all labels occur."""

    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=(trials, samples, 6)) * 0.3, axis=1).astype(np.float32)


def median_seconds(run: Callable[[], Any], repeats: int = _REPEATS) -> float:
    """Median wall time of a call that has been made once before."""

    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def batch_encoder(wrench: NDArray[np.float32], window: int) -> dict[str, Any]:
    """Dense encoding of all trials at once: compile time, throughput, memory relative to the wrench."""
    import jax
    import jax.numpy as jnp

    from rcbht_jax.encoding.encoder import EncoderConfig, encode
    from rcbht_jax.encoding.thresholds import preset

    config, limits = EncoderConfig(window=window, dt=DT), jnp.asarray(preset().limits, jnp.float32)
    data, length = jnp.asarray(wrench), jnp.full(len(wrench), wrench.shape[1], jnp.int32)
    start = time.perf_counter()
    compiled = jax.jit(encode, static_argnums=0).lower(config, limits, data, length).compile()
    compile_seconds = time.perf_counter() - start
    seconds = median_seconds(lambda: jax.block_until_ready(compiled(limits, data, length)))
    memory = compiled.memory_analysis()
    tracks = compiled(limits, data, length)
    labels = sum(leaf.nbytes for leaf in jax.tree.leaves(tracks))
    slots = sum(track.label.size for track in (tracks.primitive, tracks.mc, tracks.llb))
    return {
        "lanes": len(wrench) * 6,
        "compile_seconds": compile_seconds,
        "samples_per_second": wrench.size / seconds,
        "working_memory_over_wrench": memory.temp_size_in_bytes / wrench.nbytes if memory else float("nan"),
        "label_bytes_per_slot": labels / slots,
    }


def streaming_step(window: int = 5, windows: int = 2000) -> dict[str, float]:
    """One step for six axes: inside a scan, and as a single jitted call."""
    import jax
    import jax.numpy as jnp

    from rcbht_jax.encoding.encoder import EncoderConfig, init, step
    from rcbht_jax.encoding.thresholds import preset

    config, limits = EncoderConfig(window=window, dt=DT), jnp.asarray(preset().limits, jnp.float32)
    samples = jnp.asarray(signal(1, windows * window)[0].reshape(windows, window, 6))
    scan = jax.jit(lambda s, x: jax.lax.scan(lambda c, w: step(config, limits, c, w), s, x))
    in_scan = median_seconds(lambda: jax.block_until_ready(scan(init(), samples))) / windows
    single = jax.jit(step, static_argnums=0)
    state, _ = single(config, limits, init(), samples[0])
    one = np.asarray(samples[1])
    times = []
    for _ in range(windows):
        start = time.perf_counter()
        jax.block_until_ready(single(config, limits, state, one))
        times.append(time.perf_counter() - start)
    return {
        "microseconds_in_scan": in_scan * 1e6,
        "microseconds_single_call_median": float(np.median(times)) * 1e6,
        "microseconds_single_call_p99": float(np.quantile(times, 0.99)) * 1e6,
    }


def offline_trial(seconds: float = 33.0) -> float:
    """Seconds that the offline taxonomy takes for one trial of six axes at 200 Hz."""

    from rcbht_jax import reference

    wrench = signal(1, round(seconds / DT))[0].astype(np.float64)
    times = reference.sample_times(len(wrench), DT)
    return median_seconds(lambda: reference.encode(times, wrench, [0.0, seconds / 4, seconds / 2]), repeats=3)


def peers(wrench: NDArray[np.float32], window: int) -> dict[str, float]:
    """Samples per second of the peers that are installed (extra ``bench``); slow ones get part of the array."""

    lanes = np.moveaxis(wrench, 2, 1).reshape(-1, wrench.shape[1]).astype(np.float64)
    segments = wrench.shape[1] // window
    speeds = {}
    if importlib.util.find_spec("tslearn") is not None:
        from tslearn.piecewise import OneD_SymbolicAggregateApproximation, SymbolicAggregateApproximation

        sax = SymbolicAggregateApproximation(n_segments=segments, alphabet_size_avg=9)
        speeds["tslearn SAX"] = lanes.size / median_seconds(lambda: sax.fit_transform(lanes[:, :, None]), repeats=3)
        slope = OneD_SymbolicAggregateApproximation(n_segments=segments, alphabet_size_avg=9, alphabet_size_slope=9)
        part = lanes[:60]
        speeds["tslearn 1d-SAX"] = part.size / median_seconds(lambda: slope.fit_transform(part[:, :, None]), repeats=1)
    if importlib.util.find_spec("fABBA") is not None:
        from fABBA import fABBA

        part = lanes[:6]
        speeds["fABBA"] = part.size / median_seconds(
            lambda: [fABBA(tol=0.1, alpha=0.1, verbose=0).fit_transform(lane) for lane in part], repeats=3
        )
    return speeds
