"""Words that fit: the variance of the wrench that lines explain, the number of words, and their latency.

Both rules label the same trials with windows of 5 samples (the fit rule also with 2) and the preset's limits; the fit
rule takes its tolerances from the set. R2 is pooled over the trials of a set: one minus the squared distances of the
samples to the primitives' lines (their published mean and slope) over those to the mean of the trial. Intervals are of
the axis with the lowest value, from trials drawn with replacement. Latencies are
seconds from the last sample of a word to its publication, without those that the end of a trial publishes. Before
contact, that is in the annotated approach, a primitive should be constant. The simulated payload settles when a trial
begins, and the annotation ends after the first touch; so the share is also given without a quarter of a second at
either end.

Run: python -m experiments.words.fit_quality (reads RCBHT_DATA)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import REAL, REAL_FAILURES, SIM1, SIM2, of_sources, recorded, rounded
from experiments._lib.intervals import of_sums
from experiments._lib.results_io import write_result
from experiments.words.sets import annotated_samples, moving
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.labels import LAYERS, LLB, Primitive
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WINDOW = 5
EDGE = 0.25  # seconds at either end of the approach
SETS = {"REAL": REAL, "REAL failures": REAL_FAILURES, "SIM1": SIM1, "two-arm": SIM2}
# Factor on the default tolerance, and window.
FITS = {"fit x0.5": (0.5, 5), "fit x1": (1.0, 5), "fit x2": (2.0, 5), "fit x1, W=2": (1.0, 2)}


def residuals(track: LabelTrack, recordings: Recordings) -> NDArray[np.float64]:
    """Squared distances ``[2, recording, axis]`` to the lines of primitives, and to the mean; where there is a word."""
    missed, total = squares = np.zeros((2, len(recordings), len(recordings.axes)))
    for row, samples in enumerate(recordings.length):
        y = recordings.wrench[row, :samples].astype(np.float64)
        for axis in range(y.shape[1]):
            used = track.label[row, axis] > 0
            fields = (track.t0, track.t1, track.avg, track.grad)
            t0, t1, mean, slope = (np.asarray(values[row, axis])[used] for values in fields)
            word = np.repeat(np.arange(len(t0)), t1 - t0)  # words follow each other without gaps
            time = np.arange(len(word))
            line = mean[word] + slope[word] * recordings.dt * (time - (t0 + t1 - 1)[word] / 2)
            covered = y[: len(word), axis]
            missed[row, axis] = ((covered - line) ** 2).sum()
            total[row, axis] = ((covered - covered.mean()) ** 2).sum()
    return squares


def pooled(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """One minus the first over the second ``[axis]`` of sums ``[2, recording, axis]``."""
    part, whole = sums.sum(1)
    return np.asarray(1 - part / whole)


def lowest(shares: NDArray[np.float64]) -> dict[str, Any]:
    """The least of the :func:`pooled` values, with its interval from recordings drawn with replacement."""
    part, whole = shares[:, :, int(np.argmin(pooled(shares)))]
    return of_sums(whole - part, whole)


def latency(track: LabelTrack, recordings: Recordings) -> dict[str, float]:
    """Seconds from the end of a word to its publication, of those published while the trial ran."""
    online = (track.label > 0) & (track.emit < recordings.length[:, None, None] - WINDOW)
    seconds = (track.emit - track.t1)[online] * recordings.dt
    median, late = np.percentile(seconds, (50, 95)).tolist()
    return {"median": median, "p95": late, "max": float(seconds.max())}


def inside(approach: NDArray[np.bool_], dt: float) -> NDArray[np.bool_]:
    """The samples of the approach that are further than EDGE from its ends."""
    count, found = round(EDGE / dt), np.zeros_like(approach)
    found[:, count:-count] = approach[:, : -2 * count] & approach[:, 2 * count :]
    return found


def measured(tracks: LabelTracks, recordings: Recordings, approach: NDArray[np.bool_]) -> dict[str, Any]:
    inner = inside(approach, recordings.dt)
    r2 = residuals(tracks.primitive, recordings)
    shares = {
        "approach_constant": moving(tracks.primitive, approach, Primitive.CONS),
        "approach_constant_inside": moving(tracks.primitive, inner, Primitive.CONS),
        "approach_fixed_inside": moving(tracks.llb, inner, LLB.FX),
    }
    words = {layer: (getattr(tracks, layer).label > 0).sum(-1).mean(0) for layer in LAYERS}
    return {
        "r2": pooled(r2).tolist(),
        "lowest": {"r2": lowest(r2), **{name: lowest(share) for name, share in shares.items()}},
        "words": words["primitive"].tolist(),
        "all_words": {layer: float(count.sum()) for layer, count in words.items()},
        "latency": {layer: latency(getattr(tracks, layer), recordings) for layer in LAYERS},
        **{name: pooled(share).tolist() for name, share in shares.items()},
    }


def of_set(recordings: Recordings) -> dict[str, Any]:
    """Both rules on one set; the fit rule with several tolerances."""
    thresholds = preset("hiro", recordings.axes)
    approach = annotated_samples(recordings, "states", ("approach",))
    wrench, length = recordings.wrench, recordings.length
    tolerance = auto_tolerance(wrench, length, FitConfig(WINDOW, recordings.dt).needed)
    paper = encode_batch(EncoderConfig(WINDOW, recordings.dt), thresholds, wrench, length)
    rows = {"paper": measured(paper, recordings, approach)}
    for name, (factor, window) in FITS.items():
        limits = FitLimits(np.asarray(thresholds.limits), tolerance * factor)
        tracks = encode_batch(FitConfig(window, recordings.dt), limits, wrench, length)
        rows[name] = measured(tracks, recordings, approach)
    about = {"recordings": len(recordings), "axes": list(recordings.axes), "tolerance": tolerance.tolist()}
    return about | {"rows": rows}


def main() -> None:
    """Measure every set and write the result."""
    recordings = recorded()
    result = {name: rounded(of_set(of_sources(recordings, (source,)))) for name, source in SETS.items()}
    about = "tolerance: 1.5 % of an axis's usual range was given by the design, not chosen on these sets"
    write_result("fit_quality", "python -m experiments.words.fit_quality", {"about": about, "sets": result})


if __name__ == "__main__":
    tyro.cli(main)
