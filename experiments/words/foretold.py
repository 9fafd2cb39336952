"""How seldom could provisional labels be revised? The published label, learned from other trials.

A word is revised if the label of its second snapshot is not the one that is published (experiments.words.latency). Here
a forest of extremely randomised trees names the published label from what is known at that snapshot: the two newest
words of each layer that are not published, their spans and values, how many there are, the label published last, the
newest labels of the other axes, and the last 0.2 s of the axis; levels are in tolerances, slopes in small gradient
limits. Each trial is judged by a forest of other trials of its set, so the forest knows how the words of this task go
on, which the fit rule does not. Its settings are the library's but for the size of a leaf. A first try lacked the two
features that count words and name the last published one.

Run: python -m experiments.words.foretold [--sets REAL SIM1 two-arm] (reads RCBHT_DATA)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import GroupKFold, cross_val_predict

from experiments._lib.arrays import Floats
from experiments._lib.benchmarks import REAL, SIM1, SIM2, of_sources, recorded, rounded
from experiments._lib.intervals import of_sums, sums
from experiments._lib.results_io import defaults_of, given, write_result
from experiments.words.latency import (
    SIMULATED,
    WINDOW,
    Trial,
    limits_of_set,
    newest,
    published_last,
    shown_twice,
    streamed,
)
from experiments.words.sets import spread
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, Recordings

RECENT = 40  # samples of the axis
TREES, LEAF, FOLDS, SEED = 400, 3, 7, 0
SETS = {"REAL": REAL, "SIM1": SIM1, "two-arm": SIM2}


def described(trial: Trial, limits: FitLimits) -> Floats:
    """What is known after each window ``[window, axis, feature]``."""
    tolerance, small = np.asarray(limits.tolerance), np.asarray(limits.gradients)[:, 3]
    held = [getattr(trial.held, layer) for layer in LAYERS]
    labels = newest(trial.held.primitive).label
    others = np.broadcast_to(labels[:, None], (*labels.shape, labels.shape[1]))
    axes = np.broadcast_to(np.arange(labels.shape[1]), labels.shape)[..., None]
    words = [word(track, back, tolerance, small) for track in held for back in (0, 1)]
    counts = np.stack([(track.label > 0).sum(-1) for track in held], -1)
    last = np.stack([published_last(getattr(trial.published, layer)) for layer in LAYERS], -1)
    return np.concatenate([*words, counts, last, recent(trial.wrench, tolerance), others, axes], -1)


def word(track: LabelTrack, back: int, tolerance: Floats, small: Floats) -> Floats:
    """The newest word, or one before it, ``[window, axis, feature]``: label, age, length, level, span, slope."""
    count = (track.label > 0).sum(-1)
    slot = np.maximum(count - 1 - back, 0)[..., None]
    fields = (track.label, track.t0, track.t1, track.avg, track.vmax, track.vmin, track.grad)
    label, t0, t1, avg, most, least, slope = (np.take_along_axis(values, slot, -1)[..., 0] for values in fields)
    now = (np.arange(len(label))[:, None] + 1) * WINDOW
    found = np.stack([label, now - t0, t1 - t0, avg / tolerance, (most - least) / tolerance, slope / small], -1)
    return np.where((count > back)[..., None], found, 0.0)


def recent(wrench: NDArray[np.floating], tolerance: Floats) -> Floats:
    """The last samples less the newest one, in tolerances ``[window, axis, sample]``."""
    before = np.concatenate([np.repeat(wrench[:1], RECENT, 0), wrench])
    views = np.lib.stride_tricks.sliding_window_view(before, RECENT, axis=0)[WINDOW::WINDOW]  # [window, axis, sample]
    return (views - views[..., -1:]) / tolerance[:, None]


def of_set(recordings: Recordings) -> dict[str, Any]:
    """Shares of revised words of each layer: by the labels shown, and by those learned from other trials."""
    config, limits = limits_of_set(recordings)["fit"]
    assert isinstance(limits, FitLimits)
    trials = streamed(config, limits, recordings)
    known, found = [described(trial, limits) for trial in trials], {}
    for layer in LAYERS:
        words = [shown_twice(getattr(trial.published, layer), newest(getattr(trial.held, layer))) for trial in trials]
        x = np.concatenate([features[rows[:, 0], rows[:, 1]] for features, rows in zip(known, words, strict=True)])
        trial = np.repeat(np.arange(len(trials)), list(map(len, words)))
        _, _, shown, final = np.concatenate(words).T
        forest = ExtraTreesClassifier(TREES, min_samples_leaf=LEAF, n_jobs=-1, random_state=SEED)
        learned = cross_val_predict(forest, x, final, groups=trial, cv=GroupKFold(FOLDS))
        wrong = sums(np.stack([shown != final, learned != final, np.ones(len(final))], 1), trial)
        found[layer] = {"words": len(final), "shown": of_sums(*wrong[:, [0, 2]].T),
                        "learned": of_sums(*wrong[:, [1, 2]].T)}  # fmt: skip
    return found


def main(sets: tuple[str, ...] = tuple(SETS)) -> None:
    """Stream the trials of each set, learn, and write the result."""
    recordings, found = recorded(), {}
    for name in sets:
        chosen = of_sources(recordings, (SETS[name],))
        found[name] = rounded(of_set(chosen if SETS[name] == REAL else spread(chosen, SIMULATED)))
    result = {"trees": TREES, "samples of a leaf": LEAF, "folds by trial": FOLDS, "sets": found}
    command = "python -m experiments.words.foretold" + given(locals(), defaults_of(main))
    write_result("fit_foretold", command, result, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
