"""Rest of other robots: the share of it that words call constant, with thresholds and tolerances from the recordings.

Screwing caps, at 40 Hz and at 1 kHz: rest is what the annotator called none or free motion, in which a hand carries the
sensor, and that part of it which the calibration takes for rest without labels. Kitting is not annotated, so that its
rest is the calibration's own. Thresholds are those of `--robot auto`; nothing was chosen on these sets.

Run: python -m experiments.words.external_rest
Reads the recordings of other robots (RCBHT_EXTERNAL).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import tyro
from jaxtyping import Bool

from experiments._lib.benchmarks import rounded
from experiments._lib.intervals import of_sums
from experiments._lib.other_robots import of_other_robot
from experiments._lib.results_io import write_result
from experiments.words.sets import annotated_samples, moving
from rcbht_jax.calibration.rest import RestCalibration, rest_thresholds
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import AUTO, config_of, limits_for
from rcbht_jax.labels import LLB, MC, Primitive
from rcbht_jax.types import LabelTracks

SETS = {  # folder, kind of file, mapping, samples of a window
    "caps, 40 Hz": ("caps/runs_40hz", "csv", "caps_40hz", 5),
    "caps, 40 Hz, W=2": ("caps/runs_40hz", "csv", "caps_40hz", 2),
    "caps, 1 kHz, W=25": ("caps/runs_1khz", "npz", "caps_1khz", 25),
    "kitting, 20 Hz": ("kitting", "csv", "kitting", 5),
}
STILL = ("none", "free_space_motion")
LAYERS = {"primitive": Primitive.CONS, "mc": MC.K, "llb": LLB.FX}


def by_sample(calibration: RestCalibration, samples: int, window: int) -> Bool[np.ndarray, "recording time axis"]:
    """The calibration's rest, of windows, as samples."""
    rest = calibration.rest.repeat(window, axis=1)
    return np.pad(rest, ((0, 0), (0, samples - rest.shape[1]), (0, 0)))


def constant(tracks: LabelTracks, rest: Bool[np.ndarray, "recording time axis"]) -> dict[str, dict[str, Any]]:
    """Share of rest that each layer calls constant or fixed ``[axis]``, and the least of these with its interval."""
    sums = {layer: moving(getattr(tracks, layer), rest, code) for layer, code in LAYERS.items()}
    shares = {layer: 1 - part.sum(0) / np.maximum(whole.sum(0), 1) for layer, (part, whole) in sums.items()}
    return {
        layer: {"axes": shares[layer].tolist(), "least": of_sums(whole[:, axis] - part[:, axis], whole[:, axis])}
        for layer, (part, whole) in sums.items()
        for axis in [int(np.argmin(shares[layer]))]
    }


def of_set(folder: str, kind: str, mapping: str, window: int) -> dict[str, Any]:
    """Both rules on the rest of one set."""
    recordings = of_other_robot(folder, mapping, kind=kind)
    calibration = rest_thresholds(recordings, window)
    own = by_sample(calibration, recordings.wrench.shape[1], window)
    rests = {"of the calibration": own}
    if track := recordings.annotations.choose():
        by_hand = annotated_samples(recordings, track, STILL)
        rests = {"annotated": by_hand, "annotated, and of the calibration": own & by_hand}
    seconds = {name: float(rest.sum((0, 1)).min() * recordings.dt) for name, rest in rests.items()}
    rows = {}
    for rule in ("paper", "fit"):
        config = config_of(rule, window, recordings.dt)
        thresholds = rest_thresholds(recordings, window, rule).thresholds
        limits = limits_for(config, thresholds, AUTO, recordings.wrench, recordings.length)
        tracks = encode_batch(config, limits, recordings.wrench, recordings.length)
        rows |= {f"{rule}: {name}": constant(tracks, rest) | {"seconds": seconds[name]} for name, rest in rests.items()}
    return {"recordings": len(recordings), "axes": list(recordings.axes), "window": window, "rows": rows}


def main() -> None:
    """Measure every set and write the result."""
    result = {name: rounded(of_set(*source)) for name, source in SETS.items()}
    write_result("external_rest", "python -m experiments.words.external_rest", {"sets": result})


if __name__ == "__main__":
    tyro.cli(main)
