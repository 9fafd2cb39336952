"""Failure types of the authors' simulated failures, believed from the stream: accuracy at parts of the record.

Half of the trials train, the other half is streamed at 10 Hz; kernel and cost are chosen inside the training half.
Beside it stand the most frequent class, and the time that has passed as the only feature.

Run: python -m experiments.failure_types_online --repeats 10 --seed 0
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from experiments.record import write_result
from rcbht_jax import metrics
from rcbht_jax.classify import Grid, select
from rcbht_jax.data.hiro import read_hiro
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.grammar import FeatureSpec
from rcbht_jax.introspect.coupling import fit_probabilistic
from rcbht_jax.introspect.features import names
from rcbht_jax.introspect.observe import Sight
from rcbht_jax.introspect.train import FAMILIES, RELATIVE, Looks, picked, streamed, watch
from rcbht_jax.tasks import Sentences, TaskSpec, sentences
from rcbht_jax.thresholds import preset

RATE = 10.0  # looks per second
PICKED = 4  # half of a trial's looks that train
FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the record
GRID = Grid(kernels=("linear", "rbf"), costs=(0.01, 1.0, 10.0), scalings=(True,), balanced=True, inner=3, floor=0.1)

Floats = NDArray[np.float64]


def moments(items: Sentences, looks: Looks) -> dict[str, NDArray[np.int64]]:
    """The first look of every trial at or after each part of its record."""
    length = (items.intervals[0].end - items.intervals[0].start)[looks.sentence]
    found = {}
    for fraction in FRACTIONS:
        late = np.flatnonzero(looks.now - looks.begin >= fraction * length)
        found[f"at {fraction:.0%}"] = late[np.unique(looks.sentence[late], return_index=True)[1]]
    return found


def halves(items: Sentences, seed: int) -> NDArray[np.bool_]:
    """Which trials train: half of each class."""
    rng, inside = np.random.default_rng(seed), np.zeros(len(items.y), bool)
    for c in range(len(items.classes)):
        rows = rng.permutation(np.flatnonzero(items.y == c))
        inside[rows[: len(rows) // 2]] = True
    return inside


def repeat(items: Sentences, looks: Looks, training: NDArray[np.bool_], x: Floats, seed: int) -> dict[str, Any]:
    """Train on one half, stream the other."""
    inside = halves(items, seed)
    rows = inside[looks.sentence] & training
    y, group = items.y[looks.sentence], items.trial[looks.sentence]
    spec = select({"": x[rows]}, y[rows], group[rows], GRID, seed)
    machine = fit_probabilistic(x[rows], y[rows], group[rows], items.classes, spec, seed)
    seen = ~inside[looks.sentence]
    p = np.full((len(y), len(items.classes)), np.nan)
    p[seen] = machine.probability(x[seen])
    out: dict[str, Any] = {"every tenth of a second": metrics.accuracy(y[seen], p[seen].argmax(1))}
    for name, at in moments(items, looks).items():
        mine = at[seen[at]]
        out[name] = metrics.accuracy(y[mine], p[mine].argmax(1))
    out["calibration error of steps"] = metrics.calibration_error(p[seen], y[seen])
    out["chosen"] = f"{spec.kernel} C={spec.cost:g}"
    return out


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean and 95 % interval of every score."""
    out: dict[str, Any] = {}
    for name in runs[0]:
        values = [run[name] for run in runs]
        if isinstance(values[0], str):
            out[name] = {word: values.count(word) for word in sorted(set(values))}
            continue
        mean, low, high = metrics.corrected_interval(np.array(values), 1.0)
        out[name] = {"mean": round(mean, 3), "interval": [round(low, 3), round(high, 3)]}
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    recordings, _ = read_hiro(Path(os.environ.get("RCBHT_DATA", "../shared/data/hiro")))
    items = sentences(recordings, TaskSpec("failure-type"))
    config = EncoderConfig(dt=recordings.dt)
    every = round(1 / (RATE * config.dt))
    looks, chosen = streamed(items, every), picked(items, every, PICKED, early=False)
    training = np.isin(looks.sentence * 10**7 + looks.now, chosen.sentence * 10**7 + chosen.now)
    sight = Sight(FeatureSpec(families=FAMILIES))
    with tqdm(total=len(looks), desc="looks", file=sys.stderr, disable=None) as bar:
        x = watch(recordings, looks, sight, config, preset(), bar.update).astype(np.float64)
    family = np.array([name.split(".")[0] for name in names(sight.spec)])
    elapsed = ((looks.now - looks.begin) * config.dt)[:, None]
    kinds = {"all features": x, "relative features": x[:, np.isin(family, RELATIVE)], "time alone": elapsed}
    seeds = range(args.seed, args.seed + args.repeats)
    rows = {
        kind: summary([repeat(items, looks, training, values, s) for s in tqdm(seeds, desc=kind, disable=None)])
        for kind, values in kinds.items()
    }
    result = {
        "what": "failure type of simulated failures from the stream; half of the trials train",
        "trials": len(items.y),
        "left out": items.dropped,
        "classes": {c: int((items.y == k).sum()) for k, c in enumerate(items.classes)},
        "most frequent class": round(float(np.bincount(items.y).max() / len(items.y)), 3),
        "repeats": args.repeats,
        "rows": rows,
    }
    command = f"python -m experiments.failure_types_online --repeats {args.repeats} --seed {args.seed}"
    write_result("failure_types_online", command, result, args.seed)


if __name__ == "__main__":
    main()
