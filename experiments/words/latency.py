"""Words while they run: what a stream shows of a change before its word is published, by both rules.

After every window of 25 ms the encoder gives its provisional words, as for the live page. A contact is a step
of Fz by more than 5 N within 25 ms after 0.2 s within 2 N; it counts as seen at the first snapshot whose newest word of
Fz began within 50 ms of the step and is not constant, or starts at another level by more than half of the step. Ages
are seconds from the end of the newest published word of an axis to now, without provisional words, whose end always is
now.

A word is revised if the label that it has in its second snapshot is not the one that is published. As that alone would
reward words that are not shown, or shown under a label that is usual, each row also says how many published words were
shown twice, and for how much of the time the newest label shown is that of the word which the newest sample turns out
to be in. Two labels that do not depend on the run are compared with them: always the constant one, and that of the
word published last. How provisional labels look ahead was chosen on the even trials of session A of REAL alone.
Intervals come from trials drawn with replacement.

Run: python -m experiments.words.latency (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import REAL, SIM1, SIM2, of_sources, recorded, rounded
from experiments._lib.intervals import of_sums
from experiments._lib.results_io import write_result
from experiments.words.sets import spread
from rcbht_jax.encoding.encoder import EncoderConfig, unpack
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, rule_of
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.labels import LAYERS, LLB, MC, Primitive
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WINDOW, STEP, QUIET, SEEN = 5, 5.0, 2.0, 10  # samples; N; N; samples within which a contact should be seen
LONGEST = 6000  # samples of a trial that are streamed
SIMULATED = 12  # trials of each simulated set, evenly chosen
STILL = dict(zip(LAYERS, (Primitive.CONS, MC.K, LLB.FX), strict=True))
COUNTS = ("revised", "twice", "published", "right", "windows", "right where it moves", "windows where it moves")


class Trial(NamedTuple):
    """The labels of a stream of one recording after each of its windows ``[window, axis, ...]``."""

    published: LabelTracks
    held: LabelTracks  # provisional words
    ended: LabelTracks  # what would be published if the stream ended then
    wrench: NDArray[np.float32]  # [time, axis]


class Shown(NamedTuple):
    """The newest word of a layer after each window ``[window, axis]``; label 0 = none."""

    label: NDArray[np.integer]
    begin: NDArray[np.integer]


@partial(jax.jit, static_argnums=0)
def snapshots(config: AnyConfig, limits: jax.Array, windows: jax.Array) -> tuple[LabelTracks, LabelTracks, LabelTracks]:
    """Published and provisional labels after each window, and those if it ended then ``[window, axis, slot]``."""
    rule = rule_of(config)

    def body(state: Any, window: jax.Array) -> tuple[Any, tuple[LabelTracks, ...]]:
        state, packed = rule.step(config, limits, state, window)
        none = jnp.zeros_like(window), jnp.zeros_like(state.time)
        return state, (unpack(packed), *(f(config, limits, state, *none) for f in (rule.provisional, rule.flush)))

    return jax.lax.scan(body, rule.init(config, windows.shape[2:], windows.dtype), windows)[1]


def streamed(config: AnyConfig, limits: AnyLimits, recordings: Recordings) -> list[Trial]:
    """The trials one after another, each up to its last whole window."""
    table, found = jnp.asarray(checked_limits(config, limits), jnp.float32), []
    for row, length in enumerate(recordings.length.tolist()):
        samples = min(length, LONGEST) // WINDOW * WINDOW
        wrench = np.zeros((LONGEST, len(recordings.axes)), np.float32)  # one shape, one compilation
        wrench[:samples] = recordings.wrench[row, :samples]
        out = snapshots(config, table, jnp.asarray(wrench.reshape(-1, WINDOW, wrench.shape[1])))
        published, held, ended = jax.tree.map(lambda leaf, end=samples // WINDOW: np.asarray(leaf)[:end], out)
        found.append(Trial(published, held, ended, wrench[:samples]))
    return found


def contacts(force: NDArray[np.floating]) -> list[int]:
    """Samples at which a step of more than 5 N within 25 ms begins, after 0.2 s within 2 N."""
    found: list[int] = []
    for sample in range(40, len(force) - 2 * WINDOW):
        quiet = np.ptp(force[sample - 40 : sample]) < QUIET and (not found or sample - found[-1] > 40)
        if quiet and abs(force[sample + WINDOW] - force[sample - 1]) > STEP:
            found.append(sample)
    return found


def seen_after(step: int, force: NDArray[np.floating], held: LabelTracks, axis: int) -> int:
    """Samples from a step to the first snapshot that shows it; a large number if none does within a second."""
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


def newest(track: LabelTrack) -> Shown:
    """The newest word of each window and axis, of ``[window, axis, slot]``."""
    there = track.label > 0
    slot = (there * (np.arange(there.shape[-1]) + 1)).argmax(-1)[..., None]
    return Shown(*(np.take_along_axis(values, slot, -1)[..., 0] for values in (track.label, track.t0)))


def finals(published: LabelTrack, ended: LabelTrack) -> NDArray[np.int64]:
    """Label ``[window, axis]`` of the word that has the newest sample of each window in the end."""
    windows, axes = published.label.shape
    found = np.zeros((windows * WINDOW, axes), np.int64)
    for axis in range(axes):
        last = jax.tree.map(lambda leaf, axis=axis: leaf[-1, axis], ended)
        for track in (jax.tree.map(lambda leaf, axis=axis: leaf[:, axis], published), last):
            for slot in np.flatnonzero(track.label):
                found[track.t0[slot] : track.t1[slot], axis] = track.label[slot]
    return found[WINDOW - 1 :: WINDOW]


def shown_twice(published: LabelTrack, shown: Shown) -> NDArray[np.int64]:
    """Published words that were shown after two windows: window of the second, axis, label then, label published."""
    found: list[tuple[int, ...]] = []
    for axis in range(published.label.shape[1]):
        there = np.flatnonzero(published.label[:, axis])
        labels = dict(zip(published.t0[there, axis].tolist(), published.label[there, axis].tolist(), strict=True))
        seen: dict[int, list[tuple[int, int]]] = {}
        both = zip(shown.begin[:, axis].tolist(), shown.label[:, axis].tolist(), strict=True)
        for window, (begin, label) in enumerate(both):
            if label:
                seen.setdefault(begin, []).append((window, label))
        found += [
            (seen[begin][1][0], axis, seen[begin][1][1], label)
            for begin, label in labels.items()
            if len(seen.get(begin, ())) > 1
        ]
    return np.array(found, np.int64).reshape(-1, 4)


def counted(published: LabelTrack, shown: Shown, final: NDArray[np.int64], still: int) -> NDArray[np.int64]:
    """COUNTS of one trial and layer."""
    _, _, then, label = shown_twice(published, shown).T
    right, moves = shown.label == final, final != still
    words = (published.label > 0).sum()
    return np.array([
        (then != label).sum(), len(label), words, right.sum(), right.size, (right & moves).sum(), moves.sum()
    ])  # fmt: skip


def ways(trial: Trial, layer: str) -> dict[str, Shown]:
    """Labels to show of a layer: provisional ones, those published if the stream ended, and two baselines."""
    held = newest(getattr(trial.held, layer))
    return {
        "shown": held,
        "if it ended now": newest(getattr(trial.ended, layer)),
        "always constant": Shown(np.full_like(held.label, STILL[layer]), held.begin),
        "the word published last": Shown(published_last(getattr(trial.published, layer)), held.begin),
    }


def published_last(published: LabelTrack) -> NDArray[np.integer]:
    """Label ``[window, axis]`` of the word that was published last; 0 = none was."""
    latest = np.maximum.accumulate(np.where(published.label > 0, np.arange(len(published.label))[:, None], 0), axis=0)
    return np.take_along_axis(published.label, latest, 0)


def labels_shown(trials: list[Trial]) -> dict[str, dict[str, dict[str, Any]]]:
    """For each way and layer: share of revised words, number of shown words, and share of time with the right label."""
    each: dict[str, dict[str, list[NDArray[np.int64]]]] = {}
    for trial in trials:
        for layer in LAYERS:
            published = getattr(trial.published, layer)
            final = finals(published, getattr(trial.ended, layer))
            for way, shown in ways(trial, layer).items():
                counts = each.setdefault(way, {}).setdefault(layer, [])
                counts.append(counted(published, shown, final, STILL[layer]))
    return {way: {layer: _shares(np.stack(counts)) for layer, counts in layers.items()} for way, layers in each.items()}


def _shares(counts: NDArray[np.int64]) -> dict[str, Any]:
    """Of COUNTS ``[trial, count]``."""
    wrong, total, words, right, windows, moving, moves = counts.T.astype(np.float64)
    return {
        "revised": of_sums(wrong, total), "words": int(total.sum()), "shown": float(total.sum() / words.sum()),
        "right": of_sums(right, windows), "right_where_it_moves": of_sums(moving, moves),
    }  # fmt: skip


def ages(track: LabelTrack, dt: float) -> NDArray[np.float64]:
    """Seconds since the end of the newest published word, after each window and of each axis."""
    latest = np.maximum.accumulate(np.where(track.label > 0, track.t1, 0), axis=0)
    now = (np.arange(len(latest))[:, None] + 1) * WINDOW
    return ((now - latest) * dt)[latest > 0]


def of_rule(trials: list[Trial], axis: int, dt: float) -> dict[str, Any]:
    """Contacts, ages of published words, and the words that are revised."""
    each = [
        [seen_after(step, force, trial.held, axis) * dt for step in contacts(force)]
        for trial in trials
        for force in [trial.wrench[:, axis]]
    ]
    late = [seconds for trial in each for seconds in trial]
    seen = [sum(seconds <= SEEN * dt for seconds in trial) for trial in each]
    old = {layer: np.concatenate([ages(getattr(trial.published, layer), dt) for trial in trials]) for layer in LAYERS}
    return {
        "contacts": len(late),
        "contacts_seen_within_50_ms": of_sums(np.array(seen, float), np.array(list(map(len, each)), float)),
        "seconds_to_see_median": float(np.median(late)),
        "newest_published_age": {layer: np.percentile(values, (50, 95)).tolist() for layer, values in old.items()},
        "revised": {layer: shares["revised"] for layer, shares in labels_shown(trials)["shown"].items()},
    }


def limits_of_set(recordings: Recordings) -> dict[str, tuple[AnyConfig, AnyLimits]]:
    """Both rules with the preset and the tolerance of the set."""
    thresholds = preset("hiro", recordings.axes)
    tolerance = auto_tolerance(recordings.wrench, recordings.length, FitConfig(WINDOW, recordings.dt).needed)
    return {
        "paper": (EncoderConfig(WINDOW, recordings.dt), thresholds),
        "fit": (FitConfig(WINDOW, recordings.dt), FitLimits(np.asarray(thresholds.limits), tolerance)),
    }


def main() -> None:
    """Stream the recorded trials by both rules, some simulated ones by the fit rule, and write the result."""
    recordings = recorded()
    real = of_sources(recordings, (REAL,))
    rows, labels = {}, {}
    for name, (config, limits) in limits_of_set(real).items():
        trials = streamed(config, limits, real)
        rows[name] = of_rule(trials, real.axes.index("Fz"), real.dt)
    of_a = np.flatnonzero(real.session == "A").tolist()  # the trials of the fit rule are those streamed last
    labels["REAL, session A, even"] = labels_shown([trials[row] for row in of_a[::2]])
    labels["REAL, others"] = labels_shown([trial for row, trial in enumerate(trials) if row not in of_a[::2]])
    for name, source in (("SIM1", SIM1), ("two-arm", SIM2)):
        found = of_sources(recordings, (source,))
        labels[name] = labels_shown(streamed(*limits_of_set(found)["fit"], spread(found, SIMULATED)))
    about = {"trials": len(real), "simulated": SIMULATED, "window": WINDOW}
    write_result(
        "fit_latency", "python -m experiments.words.latency", about | {"rows": rounded(rows), "labels": rounded(labels)}
    )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
