"""``rcbht bench``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from rcbht_jax.cli import benchmark
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError


@dataclass(frozen=True)
class Bench(Command):
    """Measure the encoders on this machine; compile time apart, medians, peers where they are installed.

    Peers come with the extra "bench" (tslearn, fABBA); their speed is measured on the same array.

    Example: rcbht bench --trials 100
    """

    trials: int = 100
    """Trials of six axes in the batch."""
    samples: int = 2000
    """Samples per trial."""

    def run(self) -> dict[str, Any]:
        if self.trials < 1 or self.samples < 20:
            raise InputError(f"{self.trials} trials of {self.samples} samples measure nothing; use 1 of 20 or more.")
        wrench = benchmark.signal(self.trials, self.samples)
        batch = {f"W={window}": benchmark.batch_encoder(wrench, window) for window in (5, 20)}
        peers = benchmark.peers(wrench, 5)
        ours = batch["W=5"]["samples_per_second"]
        return {
            "devices": [str(device) for device in jax.devices()],
            "batch": batch,
            "streaming": benchmark.streaming_step(),
            "offline_seconds_for_33_s": benchmark.offline_trial(),
            "peers_samples_per_second": peers,
            "ratio_to_peers": {name: ours / speed for name, speed in peers.items()},
        }

    def text(self, result: dict[str, Any]) -> str:
        lines = [f"devices: {', '.join(result['devices'])}"]
        for name, row in result["batch"].items():
            lines.append(
                f"batch {name}, {row['lanes']} lanes: {row['samples_per_second'] / 1e6:.1f} M samples/s "
                f"(compile {row['compile_seconds']:.1f} s), working memory {row['working_memory_over_wrench']:.1f} x "
                f"the wrench, {row['label_bytes_per_slot']:.1f} bytes a label slot"
            )
        step = result["streaming"]
        lines.append(
            f"streaming step, six axes: {step['microseconds_in_scan']:.1f} us in a scan, single call "
            f"{step['microseconds_single_call_median']:.0f} us median, "
            f"{step['microseconds_single_call_p99']:.0f} us p99"
        )
        lines.append(f"offline taxonomy: {result['offline_seconds_for_33_s']:.3f} s for a 33 s trial")
        for name, speed in result["peers_samples_per_second"].items():
            lines.append(f"{name}: {speed / 1e6:.3f} M samples/s; ours is {result['ratio_to_peers'][name]:.1f} x")
        if not result["peers_samples_per_second"]:
            lines.append("no peers installed; they come with the extra 'bench'")
        return "\n".join(lines)
