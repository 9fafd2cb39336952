"""``rcbht train`` and ``rcbht evaluate``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.features import FeatureSpec
from rcbht_jax.io.label_store import choose_tracks
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.evaluation import EvaluationProtocol, Grammars, evaluate, train
from rcbht_jax.learning.model_io import save
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import TaskSpec

Family = Literal[
    "sentence", "histogram", "ngram", "duration", "attributes", "offset", "course", "edges",
    "parts", "spread", "together", "order", "levels",
]  # fmt: skip


@dataclass(frozen=True)
class _Learning(Command):
    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store with label tracks, made by "rcbht encode"."""
    task: Literal["states", "outcome", "failure-type"] = "states"
    """What to tell apart."""
    tracks: tuple[str, ...] = ()
    """Label tracks to use; "A+B" puts two side by side, and of several choices ("A B+C") the inner folds take one."""
    boundaries: Literal["recorded", "harmonised", "merged"] = "harmonised"
    """States: where rotation ends; merged joins rotation and insertion."""
    arms: Literal["R", "L", "both"] = "R"
    """Arm whose labels to read."""
    source: tuple[str, ...] = ()
    """Data sets; default all."""
    session: tuple[str, ...] = ()
    """Recording sessions, for example A B; default all."""
    features: tuple[Family, ...] = ("histogram", "ngram", "attributes")
    """Feature families; duration, offset, edges and levels tell data sets apart that words would not."""
    ranks: bool = False
    """Always scale features, by their ranks among the training sentences; recommended with parts, spread and order."""
    balance: bool = False
    """Let offset, edges and levels together, elapsed, and all other families together weigh the same."""
    kernels: tuple[Literal["linear", "poly", "rbf"], ...] = ("linear", "poly", "rbf")
    """Kernels to choose from."""
    costs: tuple[float, ...] = tuple(10.0**k for k in range(-5, 5))
    """Values of C to choose from."""
    seed: int = 0
    """Of the folds."""

    @property
    def spec(self) -> TaskSpec:
        return TaskSpec(self.task, self.boundaries, self.arms, self.source, self.session)

    @property
    def grid(self) -> Grid:
        if self.ranks:
            return Grid(kernels=self.kernels, costs=self.costs, scalings=(True,), ranks=True)
        return Grid(kernels=self.kernels, costs=self.costs)

    def read_tracks(self) -> tuple[Grammars, dict[str, dict[str, Any]]]:
        """The grammars asked for, and how the labels of each name were made."""
        choices = [choice.split("+") for choice in self.tracks or ("",)]
        found = {wanted: choose_tracks(self.store, wanted) for choice in choices for wanted in choice}
        grammars = [{found[wanted][0]: found[wanted][1] for wanted in choice} for choice in choices]
        how = {name: attrs for name, _, attrs in found.values()}
        return {"+".join(grammar): grammar for grammar in grammars}, how


@dataclass(frozen=True)
class Evaluate(_Learning):
    """Measure how well the labels tell states, outcomes or failure types apart.

    Trials are never divided between training and test; kernel, C and scaling are chosen inside the training
    folds. Beside the score stand what the duration alone and the most frequent class achieve on the same folds.

    Example: rcbht evaluate hiro.zarr --task states --session A B --train-on A --test-on B
    """

    train_on: tuple[str, ...] = ()
    """Sessions to train on, instead of cross-validation."""
    test_on: tuple[str, ...] = ()
    """Sessions to test on."""
    folds: int = 5
    """Folds of the cross-validation."""
    repeats: int = 10
    """Repetitions of the cross-validation with other folds."""

    def run(self) -> dict[str, Any]:
        grammars, how = self.read_tracks()
        protocol = EvaluationProtocol(self.folds, self.repeats, self.seed, self.grid, self.train_on, self.test_on)
        families = FeatureSpec(families=self.features, balance=self.balance)
        result = evaluate(read_recordings(self.store), grammars, self.spec, families, protocol, how)
        return {"tracks": " ".join(grammars), **result.to_json()}

    def text(self, result: dict[str, Any]) -> str:
        items = ", ".join(f"{name} {count}" for name, count in result["items"].items())
        lines = [f"{result['task']['task']} from {result['tracks']}: {result['trials']} trials; {items}"]
        lines += [f"left out: {count} trials, {reason}" for reason, count in result["dropped"].items()]
        lines.append(f"{'':24}accuracy (95% interval)    balanced accuracy")
        rows = (("labels + SVM", "score"), ("duration alone", "duration_baseline"), ("majority", "majority_baseline"))
        lines += [f"{title:24}{_scores(result[key])}" for title, key in rows]
        if "fold_min_mean_max" in result["score"]:
            low, mean, high = result["score"]["fold_min_mean_max"]
            lines.append(f"folds of a run, min / mean / max as the paper reports: {low:.3f} / {mean:.3f} / {high:.3f}")
        chosen, count = next(iter(result["chosen"].items()))
        lines.append(f"chosen most often: {chosen} ({count} of {sum(result['chosen'].values())} folds)")
        lines += ["confusion, rows = truth:", *_table(result["classes"], result["confusion"])]
        return "\n".join([*lines, f"Read with care: {result['confounds']}"])


@dataclass(frozen=True)
class Train(_Learning):
    """Train a classifier on all sentences of a task and write it as a model file.

    Example: rcbht train hiro.zarr --task states --session A B -o states.model
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="MODEL")] = Path("rcbht.model")
    """Model file to write: arrays and JSON, no code."""

    def run(self) -> dict[str, Any]:
        grammars, how = self.read_tracks()
        families = FeatureSpec(families=self.features, balance=self.balance)
        model = train(read_recordings(self.store), grammars, self.spec, families, self.grid, how, self.seed)
        save(self.out, model)
        chosen = model.svm.spec
        return {
            "model": str(self.out),
            "tracks": chosen.features,
            "classes": list(model.svm.classes),
            "kernel": chosen.kernel,
            "cost": chosen.cost,
            "scaling": chosen.scaling,
            **model.extra,
        }

    def text(self, result: dict[str, Any]) -> str:
        return (
            f"{result['model']}: {', '.join(result['classes'])} from {result['items']} sentences of "
            f"{result['trials']} trials; {result['kernel']} kernel, C = {result['cost']:g}"
        )


def _scores(score: dict[str, Any]) -> str:
    return "     ".join(_interval(score[key]) for key in ("accuracy", "balanced_accuracy"))


def _interval(score: dict[str, float]) -> str:
    limits = f"({score['low']:.3f} to {score['high']:.3f})" if "low" in score else ""
    return f"{score['mean']:.3f} {limits:16}"


def _table(classes: Sequence[str], confusion: list[list[int]]) -> list[str]:
    width = max(max(len(name) for name in classes), 6)
    head = " " * width + "".join(f"  {name[:8]:>8}" for name in classes)
    return [head] + [
        f"{name:{width}}" + "".join(f"  {count:8d}" for count in row)
        for name, row in zip(classes, confusion, strict=True)
    ]
