"""Words while they run: what a stream knows of a change before its word is published, by both rules.

After every window of 25 ms the encoder is asked for its provisional words, as the live page does. A contact is a step
of Fz by more than 5 N within 25 ms after 0.2 s within 2 N; it counts as seen at the first snapshot whose newest word of
Fz began within 50 ms of the step and is not constant, or starts at another level by more than half of the step. A word
is revised if the label that it has in its second snapshot is not the one that is published. Ages are seconds from the
end of the newest published word of an axis to now, without provisional words, whose end always is now.

Run: python -m experiments.words.latency
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import REAL, of_sources, recorded, rounded
from experiments._lib.results_io import write_result
from rcbht_jax.encoding.encoder import EncoderConfig, unpack
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, rule_of
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.labels import LAYERS, Primitive
from rcbht_jax.types import LabelTracks

WINDOW, STEP, QUIET, SEEN = 5, 5.0, 2.0, 10  # samples; N; N; samples within which a contact should be seen
LONGEST = 6000  # samples of a trial that are streamed


@partial(jax.jit, static_argnums=0)
def snapshots(config: AnyConfig, limits: jax.Array, windows: jax.Array) -> tuple[LabelTracks, LabelTracks]:
    """Published and provisional labels after each window ``[window, axis, slot]``."""
    rule = rule_of(config)

    def body(state: Any, window: jax.Array) -> tuple[Any, tuple[LabelTracks, LabelTracks]]:
        state, packed = rule.step(config, limits, state, window)
        held = rule.flush(config, limits, state, jnp.zeros_like(window), jnp.zeros_like(state.time))
        return state, (unpack(packed), held)

    return jax.lax.scan(body, rule.init(config, windows.shape[2:], windows.dtype), windows)[1]


def contacts(force: NDArray[np.floating]) -> list[int]:
    """Samples at which a step of more than 5 N within 25 ms begins, after 0.2 s within 2 N."""
    found: list[int] = []
    for sample in range(40, len(force) - 2 * WINDOW):
        quiet = np.ptp(force[sample - 40 : sample]) < QUIET and (not found or sample - found[-1] > 40)
        if quiet and abs(force[sample + WINDOW] - force[sample - 1]) > STEP:
            found.append(sample)
    return found


def seen_after(step: int, force: NDArray[np.floating], held: LabelTracks, axis: int) -> int:
    """Samples from a step to the first snapshot that tells of it; a large number if none does within a second."""
    track = held.primitive
    height = abs(force[step + WINDOW] - force[step - 1])
    for index in range(step // WINDOW, min(step // WINDOW + 40, len(track.label))):
        newest = np.flatnonzero(track.label[index, axis])[-1:]
        if not len(newest) or (index + 1) * WINDOW <= step:
            continue
        slot = newest[0]
        begins, label = int(track.t0[index, axis, slot]), int(track.label[index, axis, slot])
        level = abs(float(track.avg[index, axis, slot]) - force[step - 20 : step].mean())
        if abs(begins - step) <= SEEN and (label != Primitive.CONS or level > height / 2):
            return (index + 1) * WINDOW - step
    return 10**6


def revised(published: LabelTracks, held: LabelTracks, layer: str) -> tuple[int, int]:
    """Words whose label in the second snapshot was not the published one, and words that were seen twice or more."""
    final, running = getattr(published, layer), getattr(held, layer)
    wrong = total = 0
    for axis in range(final.label.shape[1]):
        there = np.flatnonzero(final.label[:, axis])
        labels = dict(zip(final.t0[there, axis].tolist(), final.label[there, axis].tolist(), strict=True))
        seen: dict[int, list[int]] = {}
        for index in range(running.label.shape[0]):
            slots = np.flatnonzero(running.label[index, axis])[-1:]
            for begin, label in zip(running.t0[index, axis, slots], running.label[index, axis, slots], strict=True):
                seen.setdefault(int(begin), []).append(int(label))
        twice = [begin for begin in labels if len(seen.get(begin, ())) > 1]
        wrong += sum(seen[begin][1] != labels[begin] for begin in twice)
        total += len(twice)
    return wrong, total


def ages(published: LabelTracks, layer: str, dt: float) -> NDArray[np.float64]:
    """Seconds since the end of the newest published word, after each window and of each axis."""
    track = getattr(published, layer)
    newest = np.maximum.accumulate(np.where(track.label > 0, track.t1, 0), axis=0)
    now = (np.arange(len(newest))[:, None] + 1) * WINDOW
    return ((now - newest) * dt)[newest > 0]


def main(trials: int = 12) -> None:
    """Stream some trials by both rules and write the result."""
    recordings = of_sources(recorded(), (REAL,))
    chosen = recordings.take(np.linspace(0, len(recordings) - 1, trials).round().astype(int))
    thresholds = preset("hiro", chosen.axes)
    tolerance = auto_tolerance(recordings.wrench, recordings.length, FitConfig(WINDOW, recordings.dt).needed)
    rules: dict[str, tuple[AnyConfig, AnyLimits]] = {
        "paper": (EncoderConfig(WINDOW, chosen.dt), thresholds),
        "fit": (FitConfig(WINDOW, chosen.dt), FitLimits(np.asarray(thresholds.limits), tolerance)),
    }
    axis, rows = chosen.axes.index("Fz"), {}
    for name, (config, limits) in rules.items():
        table = jnp.asarray(checked_limits(config, limits), jnp.float32)
        delays: list[int] = []
        old: dict[str, list[NDArray[np.float64]]] = {layer: [] for layer in LAYERS}
        counts = {layer: np.zeros(2, int) for layer in LAYERS}
        for row, length in enumerate(chosen.length.tolist()):
            samples = min(length, LONGEST) // WINDOW * WINDOW
            wrench = np.zeros((LONGEST, len(chosen.axes)), np.float32)  # one shape, one compilation
            wrench[:samples] = chosen.wrench[row, :samples]
            out = snapshots(config, table, jnp.asarray(wrench.reshape(-1, WINDOW, wrench.shape[1])))
            published, held = jax.tree.map(lambda leaf, end=samples // WINDOW: np.asarray(leaf)[:end], out)
            force = wrench[:samples, axis]
            delays += [seen_after(step, force, held, axis) for step in contacts(force)]
            for layer in LAYERS:
                old[layer].append(ages(published, layer, chosen.dt))
                counts[layer] += revised(published, held, layer)
        late = np.asarray(delays) * chosen.dt
        rows[name] = {
            "contacts": len(delays),
            "contacts_seen_within_50_ms": float((late <= SEEN * chosen.dt).mean()),
            "seconds_to_see_median": float(np.median(late)),
            "newest_published_age": {k: np.percentile(np.concatenate(v), (50, 95)).tolist() for k, v in old.items()},
            "revised": {layer: float(wrong / max(total, 1)) for layer, (wrong, total) in counts.items()},
        }
    about = {"trials": trials, "set": "REAL, evenly chosen", "window": WINDOW, "rows": rounded(rows)}
    write_result("fit_latency", f"python -m experiments.words.latency --trials {trials}", about)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
