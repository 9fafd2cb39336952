"""Failure types of a batch left out of training: accuracy from contact onward, and from the approach alone.

The records of one batch of the authors' simulated failures end a tenth of a second after contact in most trials, those
of the other go on for nearly three seconds. A method that uses whole records learns something else in each. Here a
record is what follows its contact: the wrench since then, less its value just before, for a short time that both
batches have. Neither level, nor drift, nor the time of contact, nor the length of the record is left, and contact is
found in each trial by itself, without labels and without the other trials. Trials that never touch are left out.

The length of that time was chosen on our own simulated types alone (``sim_mjx``, preset openhrp, faults of pose; types
as in the authors' batches), from narrowly varied trials to widely varied ones (placement, stiffness, friction, gains,
set-points, speed) and back. Then each of the authors' batches trains for the other: alone, with our simulated types
beside it at the same total weight, mirrored in y as well, and our simulated types without any of theirs. "Ranks of each
batch" needs all trials of the tested batch, though not their labels (transductive). Rows with some labelled trials of
the tested batch, and five folds within a batch, are ceilings and no answer to the question.

The authors simulate failures by perturbing the approach, which changes the wrench in free motion already. The rows
"approach alone" use an interval that ends before contact, less its mean, so they cannot show that a failure is
recognised. The interval, too, is chosen on our simulated types; the scores of all three intervals on the authors'
trials were known before.

Run: python -m experiments.classification.types_across --folder types --seed 0
The folder keeps simulated trials. Reads the recorded trials (RCBHT_DATA). Scores on the authors' trials for 0.1, 0.5
and 1 s were known before the choice on simulated ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.stats import rankdata
from sklearn.ensemble import ExtraTreesClassifier

from experiments._lib import raw_learners as raw
from experiments._lib.arrays import Floats, Ints
from experiments._lib.benchmarks import BENCHMARKS, FAILURES, FOLDS, items_of, recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import by_trial, of_folds
from experiments._lib.simulated import simulated as made
from experiments._lib.tasks import failure_types
from experiments.classification.grammar import AT_REST, LOADED, by_batch, of_both
from rcbht_jax.learning.metrics import confusion
from rcbht_jax.learning.tasks import SUCCESS, labelled_intervals
from rcbht_jax.learning.validation import cross_validate, repeated_folds
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.plan import SynthesisConfig

SEEN = (0.1, 0.5, 1.0)  # s after contact, of which one is chosen
RISE, LAG, FREE = 1.0, 0.1, 2.6  # N in so many s that show contact, not before FREE s
BEFORE = (0.3, 0.1)  # s before contact, between which the wrench is that of free space
APPROACHES = ((1.0, 0.2), (0.6, 0.2), (0.4, 0.1))  # s before contact, between which the approach is seen
POINTS = 20  # samples of the wrench since contact, or of the approach
TREES = 300
SHOTS = (1, 2, 4)  # labelled trials of each type of the tested batch
DRAWS, REPEATS = 5, 2
NARROW = DomainRandomization(nominal_share=0.0, faults=("pose",), longest=6.5)
WIDE = replace(
    NARROW, shift=(-1e-3, 1e-3), turn=(-0.01, 0.01), friction=(0.5, 2.0), mount=(0.6, 1.6), gain=(0.8, 1.25),
    goal=(0.85, 1.15), speed=(0.9, 1.1), stiffness=(0.6, 1.5),
)  # fmt: skip
SIMULATED = {"narrow": (NARROW, 700, 61), "wide": (WIDE, 900, 62)}  # distributions, trials, seed
MIRROR = np.array([1, -1, 1, -1, 1, -1], np.float32)  # of the wrench in the plane y = 0


@dataclass(frozen=True)
class Batch:
    """Records with their types."""

    wrench: list[NDArray[np.float32]]  # [trial] of [time, 6]
    y: Ints  # [trial]
    dt: float
    never: int = 0  # trials that were left out because nothing touches in them

    def touching(self) -> Batch:
        """The trials in which something touches."""
        rows = [row for row, wrench in enumerate(self.wrench) if contact(wrench, self.dt) is not None]
        return Batch([self.wrench[row] for row in rows], self.y[rows], self.dt, len(self.wrench) - len(rows))

    def touches(self) -> list[int]:
        """The sample of contact of each trial; all must touch."""
        found = [contact(wrench, self.dt) for wrench in self.wrench]
        return [at for at in found if at is not None]

    def mirrored(self, classes: tuple[str, ...]) -> Batch:
        """The records mirrored in the plane y = 0 whose mirrored type is one of the classes."""
        names = [mirror_name(classes[k]) for k in self.y.tolist()]
        rows = [row for row, name in enumerate(names) if name in classes]
        y = np.array([classes.index(names[row]) for row in rows], np.int64)
        return Batch([self.wrench[row] * MIRROR for row in rows], y, self.dt)


def mirror_name(name: str) -> str:
    """A type in the mirror.

    >>> mirror_name("+x-y+r")
    '+x+y-r'
    """
    other = {"+": "-", "-": "+"}
    parts = zip(name[::2], name[1::2], strict=True)
    return "".join(sign + axis if axis == "x" else other[sign] + axis for sign, axis in parts)


def contact(wrench: NDArray[np.float32], dt: float) -> int | None:
    """First sample at which a force has changed by RISE within LAG; None = there is no such sample.

    >>> step = np.zeros((800, 6), np.float32)
    >>> step[700:, 2] = 5.0
    >>> contact(step, 0.005)
    700
    """
    lag, free = round(LAG / dt), round(FREE / dt)
    change = np.abs(wrench[lag:, :3] - wrench[:-lag, :3]).max(1)
    hits = np.flatnonzero(change[max(0, free - lag) :] > RISE)
    return int(hits[0]) + max(free, lag) if len(hits) else None


def described(batch: Batch, seen: float) -> Floats:
    """The wrench after contact, less that before it ``[trial, number]``; a shorter record keeps its last value."""
    rows, dt = [], batch.dt
    for wrench, at in zip(batch.wrench, batch.touches(), strict=True):
        free = wrench[max(0, at - round(BEFORE[0] / dt)) : max(1, at - round(BEFORE[1] / dt))].mean(0)
        part = (wrench[max(0, at - 4) : at + round(seen / dt)] - free).astype(np.float64)
        moments = np.linspace(0, round(seen / dt) + 3, POINTS).round().astype(np.int64)
        course = part[np.minimum(moments, len(part) - 1)]
        rows.append(np.concatenate([course.ravel(), part.mean(0), part.std(0), part.min(0), part.max(0)]))
    return np.array(rows)


def approach(wrench: NDArray[np.float32], at: int, place: tuple[float, float], dt: float) -> Floats:
    """The wrench between two times before contact, less its mean ``[time, 6]``."""
    part = wrench[max(0, at - round(place[0] / dt)) : max(2, at - round(place[1] / dt))].astype(np.float64)
    return np.asarray(part - part.mean(0))


def approaches(batch: Batch, place: tuple[float, float]) -> Floats:
    """The course of each approach, its spread and its extremes ``[trial, number]``."""
    rows = []
    for wrench, at in zip(batch.wrench, batch.touches(), strict=True):
        part = approach(wrench, at, place, batch.dt)
        moments = np.linspace(0, len(part) - 1, POINTS).round().astype(np.int64)
        rows.append(np.concatenate([part[moments].ravel(), part.std(0), part.min(0), part.max(0)]))
    return np.array(rows)


@cache
def authors() -> tuple[tuple[str, ...], dict[str, Batch]]:
    """Types that both batches have, and the batches, without trials that never touch."""
    data = by_batch(recorded())
    items = of_both(labelled_intervals(data, failure_types(sources=(FAILURES,))), (AT_REST, LOADED))
    rows = items.intervals[0].recording
    wrench = [data.wrench[row, : data.length[row]] for row in rows.tolist()]
    made = {}
    for name in (AT_REST, LOADED):
        mine = np.flatnonzero(items.session == name)
        made[name] = Batch([wrench[k] for k in mine.tolist()], items.y[mine], data.dt).touching()
    return items.classes, made


@cache
def simulated(folder: Path, name: str) -> Batch:
    """Our failures of the same types; made once."""
    spec, trials, seed = SIMULATED[name]
    job, classes = SynthesisConfig("openhrp", trials, seed, shard=128, spec=spec), authors()[0]
    data = made(folder / f"types-{name}.zarr", job)
    kind = data.column("failure_type")
    rows = np.flatnonzero((data.outcome != SUCCESS) & np.isin(kind, classes)).tolist()
    y = np.array([classes.index(str(kind[row])) for row in rows], np.int64)
    return Batch([data.wrench[row, : data.length[row]] for row in rows], y, data.dt).touching()


def predict(x: Floats, y: Ints, test: Floats, seed: int, weight: Floats | None = None) -> Ints:
    """The type ``[trial]`` by a forest of extremely random trees."""
    trees = ExtraTreesClassifier(TREES, class_weight="balanced", random_state=seed)
    return np.asarray(trees.fit(x, y, sample_weight=weight).predict(test), np.int64)


def scored(predicted: Ints, y: Ints) -> dict[str, Any]:
    """Accuracy with its interval by trial, and which type was taken for which."""
    classes = authors()[0]
    score = by_trial(float((predicted == y).mean()), len(y))
    table = confusion(y, predicted, len(classes))
    recall = dict(zip(classes, (table.diagonal() / table.sum(1)).tolist(), strict=True))
    predicted_of = dict(zip(classes, table.tolist(), strict=True))
    return rounded({"score": score, "trials tested": len(y), "recall": recall, "true and said": predicted_of})


@cache
def choice(folder: Path, seen: float | tuple[float, float], seed: int) -> dict[str, float]:
    """A time after contact, or a place before it, on simulated types: trained on narrow variation, tested on wide."""
    x = {name: features(simulated(folder, name), seen) for name in SIMULATED}
    found = {}
    for a, b in (("narrow", "wide"), ("wide", "narrow")):
        y = simulated(folder, b).y
        found[f"{a} to {b}"] = float((predict(x[a], simulated(folder, a).y, x[b], seed) == y).mean())
    return rounded(found | {"mean": float(np.mean(list(found.values())))})


def features(batch: Batch, seen: float | tuple[float, float]) -> Floats:
    """What follows contact for a time, or what lies between two times before it."""
    return approaches(batch, seen) if isinstance(seen, tuple) else described(batch, seen)


def chosen(folder: Path, seed: int, among: tuple[Any, ...]) -> Any:
    """The time after contact, or the place before it, that is best on simulated types; the first of equals."""
    return max(among, key=lambda seen: choice(folder, seen, seed)["mean"])


def across(folder: Path, ways: tuple[str, str], kind: str, seed: int) -> dict[str, Any]:
    """One batch trains, the other is tested."""
    seen = SEEN[0] if kind == LOOKED_AT else chosen(folder, seed, SEEN)
    classes, batches = authors()
    train, test = batches[ways[0]], batches[ways[1]]
    theirs = [] if kind == "simulated types alone" else [train, *[train.mirrored(classes)] * ("mirrored" in kind)]
    more = [simulated(folder, name) for name in SIMULATED] if "simulated" in kind else []
    x, z = np.concatenate([described(batch, seen) for batch in theirs + more]), described(test, seen)
    y = np.concatenate([batch.y for batch in theirs + more])
    count = sum(len(batch.y) for batch in more)
    weight = np.concatenate([np.ones(len(y) - count), np.full(count, len(train.y) / max(count, 1))])
    if "ranks" in kind:
        x, z = rankdata(x, axis=0) / len(x), rankdata(z, axis=0) / len(z)
    return scored(predict(x, y, z, seed, weight), test.y)


def from_approach(
    folder: Path, ways: tuple[str, str], seed: int, place: tuple[float, float] | None = None, beside: bool = False
) -> dict[str, Any]:
    """One batch trains, the other is tested, by the approach: at a place or the chosen one, beside what follows."""
    train, test = (authors()[1][name] for name in ways)
    places: list[float | tuple[float, float]] = [place or chosen(folder, seed, APPROACHES)]
    places += [chosen(folder, seed, SEEN)] * beside
    x, z = (np.concatenate([features(batch, seen) for seen in places], 1) for batch in (train, test))
    return scored(predict(x, train.y, z, seed), test.y)


def mixed(folder: Path, seed: int) -> dict[str, Any]:
    """The 13 types of both batches by the approach alone, in the folds of the other methods.

    Where nothing touches, the approach is taken to end with the record.
    """
    data = by_batch(recorded())
    items, place = items_of(data, BENCHMARKS["failure types"]), chosen(folder, seed, APPROACHES)
    parts = []
    for wrench in segments(data, items):
        at = contact(wrench.astype(np.float32), data.dt)
        parts.append(approach(wrench, len(wrench) - 1 if at is None else at, place, data.dt))
    folds = repeated_folds(items.y, items.trial, FOLDS, REPEATS, seed)
    made = cross_validate(raw.forest(raw.statistics(parts), items.y), items.y, folds, seed)
    return rounded(of_folds(made, len(np.unique(items.trial))))


def with_shots(folder: Path, ways: tuple[str, str], shots: int, seed: int) -> dict[str, Any]:
    """Some labelled trials of the tested batch train, too; mean of several draws."""
    batches, seen = authors()[1], chosen(folder, seed, SEEN)
    train, test = batches[ways[0]], batches[ways[1]]
    x, z = described(train, seen), described(test, seen)
    right = []
    for draw in range(DRAWS):
        order = np.random.default_rng(seed + draw).permutation(len(test.y))
        few = np.concatenate([order[test.y[order] == k][:shots] for k in np.unique(test.y)])
        left = np.setdiff1d(np.arange(len(test.y)), few)
        inside, known = np.concatenate([x, z[few]]), np.concatenate([train.y, test.y[few]])
        heavier = np.concatenate([np.ones(len(x)), np.full(len(few), len(x) / len(few))])
        right.append(float((predict(inside, known, z[left], seed + draw, heavier) == test.y[left]).mean()))
    return rounded({"score": by_trial(float(np.mean(right)), len(left))})


def within(folder: Path, name: str, seed: int, before: bool = False) -> dict[str, Any]:
    """Folds of one batch, from contact on or by the approach."""
    batch = authors()[1][name]
    x = features(batch, chosen(folder, seed, APPROACHES) if before else chosen(folder, seed, SEEN))
    predicted = np.zeros(len(batch.y), np.int64)
    folds = min(FOLDS, int(np.bincount(batch.y).min()))  # of the trials of some types, most never touch
    for train, test in repeated_folds(batch.y, np.arange(len(batch.y)), folds, 1, seed)[0]:
        predicted[test] = predict(x[train], batch.y[train], x[test], seed)
    return scored(predicted, batch.y) | {"folds": folds}


def facts(name: str) -> dict[str, Any]:
    """The lengths of a batch's records after contact."""
    batch = authors()[1][name]
    after = [(len(wrench) - at) * batch.dt for wrench, at in zip(batch.wrench, batch.touches(), strict=True)]
    ends = np.quantile(after, [0.1, 0.5, 0.9]).round(2).tolist()
    return {
        "trials": len(batch.y),
        "trials that never touch, left out": batch.never,
        "s recorded after contact, 10 %, median, 90 %": ends,
    }


def named(place: tuple[float, float]) -> str:
    """The name of a place of the approach.

    >>> named((1.0, 0.2))
    '1 to 0.2 s before contact'
    """
    return f"{place[0]:g} to {place[1]:g} s before contact"


ALONE = "approach alone"
LOOKED_AT = f"other batch, {SEEN[0]:g} s (not chosen)"
KINDS = ("other batch", LOOKED_AT, "other batch, mirrored", "other batch and simulated types", "simulated types alone",
         "other batch, ranks of each batch (transductive)")  # fmt: skip
WAYS = ((AT_REST, LOADED), (LOADED, AT_REST))


def main(folder: Path, seed: int = 0, only: Only = ALL_ROWS) -> None:
    about = {
        "what": "failure types of the batch that did not train, from contact on, and by the approach",
        "target": 0.60,
        "classes": list(authors()[0]),
        "simulated trials": {name: number for name, (_, number, _) in SIMULATED.items()},
        "trees": TREES,
    }
    wanted: dict[str, Callable[[], Any]] = {f"records | {name}": partial(facts, name) for name in (AT_REST, LOADED)}
    wanted |= {f"choice | {seen:g} s": partial(choice, folder, seen, seed) for seen in SEEN}
    wanted |= {f"choice | {named(place)}": partial(choice, folder, place, seed) for place in APPROACHES}
    for a, b in WAYS:
        wanted |= {f"{a} to {b} | {kind}": partial(across, folder, (a, b), kind, seed) for kind in KINDS}
        wanted |= {
            f"{a} to {b} | other batch and {n} labelled of each type": partial(with_shots, folder, (a, b), n, seed)
            for n in SHOTS
        }
        wanted[f"{a} to {b} | {ALONE}"] = partial(from_approach, folder, (a, b), seed)
        wanted |= {
            f"{a} to {b} | approach, {named(place)}": partial(from_approach, folder, (a, b), seed, place)
            for place in APPROACHES
        }
        wanted[f"{a} to {b} | approach and contact"] = partial(from_approach, folder, (a, b), seed, None, True)
    wanted |= {f"within | {name}": partial(within, folder, name, seed) for name in (AT_REST, LOADED)}
    wanted |= {f"within | {name} | {ALONE}": partial(within, folder, name, seed, True) for name in (AT_REST, LOADED)}
    wanted[f"13 types, both batches | {ALONE}"] = partial(mixed, folder, seed)
    Rows("types_across", command_of(main, locals(), "--folder FOLDER"), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
