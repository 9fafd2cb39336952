"""``rcbht train``, ``rcbht evaluate`` and ``rcbht classify``."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import tyro

from rcbht_jax._util.cells import table_text
from rcbht_jax._util.printable import padded, plural, room
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, MadeBy, left_out, option, progress_bar, unset
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.features import FeatureSpec
    from rcbht_jax.learning.evaluation import Grammars
    from rcbht_jax.learning.model_io import TrainedModel
    from rcbht_jax.learning.predict import Classification
    from rcbht_jax.learning.svm import Grid
    from rcbht_jax.learning.tasks import TaskSpec, TrackBatches
    from rcbht_jax.learning.wrench_facts import WrenchFacts
    from rcbht_jax.types import Recordings

WIDEST = 100  # columns of a printed table
CLASSIFIER = MadeBy('"rcbht train STORE.zarr -o {path}"')
Family = Literal["sentence", common.StreamFamily]


@dataclass(frozen=True)
class _Learning(Command):
    store: common.Store
    """Store with label tracks, made by "rcbht encode"."""
    task: common.Task = ""
    tracks: Annotated[tuple[str, ...], unset()] = ()
    """Label tracks to use; A+B concatenates their features. Cross-validation selects one of several choices."""
    boundaries: common.Boundaries = "harmonised"
    arm: Annotated[str, unset("the last by name, as the right one")] = ""
    """Arm whose labels to use, if the store has several; both = side by side."""
    source: common.Sources = ()
    session: common.Sessions = ()
    outcome: common.Outcomes = ()
    features: tuple[Family, ...] = ("histogram", "parts", "spread", "together", "order")
    """Feature families; duration, offset, edges and levels hold absolute values, which differ between data sets."""
    weighing: common.Weighing = ()
    ranks: Flag = True
    """Scale features by mean and standard deviation, instead of by ranks in the training set."""
    balance: Flag = False
    """Give equal weights to offset, edges and levels; to elapsed; and to all other families."""
    kernels: tuple[Literal["linear", "poly", "rbf"], ...] = ("linear", "poly", "rbf")
    """Kernels to choose from by cross-validation."""
    costs: tuple[float, ...] = tuple(10.0**k for k in range(-5, 5))
    """Values of C to choose from by cross-validation."""
    seed: int = 0
    """Seed of the folds."""

    FORMER: ClassVar[dict[str, str]] = {"--arms": "--arm", "--ranks": ""}

    def spec(self, recordings: Recordings) -> TaskSpec:
        from rcbht_jax.learning.task_choice import chosen_task
        from rcbht_jax.learning.tasks import TaskSpec

        task = chosen_task(self.task, recordings)
        return TaskSpec(task, self.boundaries, self.arm, self.source, self.session, self.outcome or None)

    @property
    def families(self) -> FeatureSpec:
        from rcbht_jax.features import FeatureSpec

        return FeatureSpec(families=self.features, weighing=self.weighing, balance=self.balance)

    @property
    def grid(self) -> Grid:
        from rcbht_jax.learning.svm import Grid

        if self.ranks:
            return Grid(kernels=self.kernels, costs=self.costs, scalings=(True,), ranks=True)
        return Grid(kernels=self.kernels, costs=self.costs)

    def read_tracks(self) -> tuple[Grammars, dict[str, dict[str, Any]]]:
        """The label tracks to choose from, and how those of each name were made."""
        from rcbht_jax.io.label_store import choose_name, read_tracks_attrs

        choices = [choice.split("+") for choice in self.tracks or ("",)]
        grammars = [list(dict.fromkeys(choose_name(self.store, wanted) for wanted in choice)) for choice in choices]
        how = {name: read_tracks_attrs(self.store, name) for names in grammars for name in names}
        return {"+".join(names): _batches(self.store, {name: name for name in names}) for names in grammars}, how


def table_and_facts(store: Path) -> tuple[Recordings, WrenchFacts]:
    """The recordings of a store without their samples, and what is needed of these, which are read part by part."""
    from rcbht_jax.io.store import longest_of, read_batches, read_table
    from rcbht_jax.learning.wrench_facts import WrenchFacts

    recordings = read_table(store)
    return recordings, WrenchFacts.of(recordings, read_batches(store), longest_of(store))


@dataclass(frozen=True)
class Evaluate(_Learning):
    """Measure how well a classifier of the labels distinguishes states, outcomes or failure types.

    All sentences of a trial, or of all trials of a --group, are in the same fold; kernel, C and scaling are chosen
    within the training folds. Two baselines are measured on the same folds: a random forest on the duration alone, and
    the most frequent class.

    Example: rcbht evaluate hiro.zarr --task states --session A B --train-on A --test-on B
    """

    train_on: Annotated[tuple[str, ...], unset()] = ()
    """Sessions to train on, in place of cross-validation; needs --test-on."""
    test_on: Annotated[tuple[str, ...], unset()] = ()
    """Sessions to test on."""
    folds: Annotated[int | None, unset("5, or the trials of the rarest class if they are fewer")] = None
    """Folds of the cross-validation."""
    repeats: Annotated[int | None, option("Repetitions of the cross-validation, each with other folds.", "10")] = None
    group: Annotated[str, option("Column whose groups no fold splits, for example operator or session.")] = "trial"

    LARGEST_SEED: ClassVar[int] = 2**31 - 1  # that a protocol takes

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.store import unchanged
        from rcbht_jax.learning.evaluation import FOLDS, EvaluationProtocol, evaluate

        if self.train_on and (self.folds is not None or self.repeats is not None):
            raise InputError("--folds and --repeats are for cross-validation; leave them out, or leave out --train-on.")
        with unchanged(self.store):
            grammars, how = self.read_tracks()
            repeats = EvaluationProtocol.repeats if self.repeats is None else self.repeats
            protocol = EvaluationProtocol(
                self.folds, repeats, self.seed, self.grid, self.train_on, self.test_on, self.group
            )
            families, folds = self.families, 1 if self.train_on else (self.folds or FOLDS) * repeats
            recordings, facts = table_and_facts(self.store)
            spec = self.spec(recordings)
            with progress_bar("evaluate", "folds", folds) as bar:
                result = evaluate(recordings, grammars, spec, families, protocol, how, bar.update, facts=facts)
        return {"tracks": " ".join(grammars), **result.to_json()}

    def text(self, result: dict[str, Any]) -> str:
        from rcbht_jax.learning.metrics import rule_of_three

        items = ", ".join(f"{name} {count}" for name, count in result["items"].items())
        lines = [f"{result['task']['task']} from {result['tracks']}: {plural(result['trials'], 'trial')}; {items}"]
        lines += left_out(result["dropped"])
        if result["untrained"]:
            verb = "is" if len(result["untrained"]) == 1 else "are"
            where = "in no training session" if self.train_on else "tested by a fold that does not train on it"
            lines.append(f"{', '.join(result['untrained'])} {verb} {where}, so none of it can be right there")
        lines.append(f"{'':24}accuracy (95% interval)    balanced accuracy")
        rows = (
            ("labels + SVM", "score"),
            ("duration alone", "duration_baseline"),
            ("most frequent class", "majority_baseline"),
        )
        lines += [f"{title:24}{_scores(result[key])}" for title, key in rows]
        if result["score"]["accuracy"]["mean"] == 1.0:
            most = rule_of_three(result["tested"])
            group = result["protocol"]["group"]
            lines.append(f"no mistake in {plural(result['tested'], group)}: up to {most:.1%} of new ones may have one")
        if "fold_min_mean_max" in result["score"]:
            low, mean, high = result["score"]["fold_min_mean_max"]
            lines.append(
                f"folds of a repetition, min / mean / max as in the paper: {low:.3f} / {mean:.3f} / {high:.3f}"
            )
        chosen, count = next(iter(result["chosen"].items()))
        lines.append(f"chosen most often: {chosen} ({count} of {plural(sum(result['chosen'].values()), 'fold')})")
        lines += ["confusion matrix, rows = true class:", *_table(result["classes"], result["confusion"])]
        return "\n".join([*lines, *_confounds(result)])


@dataclass(frozen=True)
class Train(_Learning):
    """Train a classifier on all sentences of a task and write it to a model file.

    Example: rcbht train hiro.zarr --task states --session A B -o states.model
    """

    out: common.OutModel = Path("rcbht.model")
    group: Annotated[str, option("Column whose groups no fold of the selection splits, such as operator.")] = "trial"

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.store import unchanged
        from rcbht_jax.learning.confounds import examined
        from rcbht_jax.learning.fitting import train
        from rcbht_jax.learning.model_io import save

        with unchanged(self.store):
            grammars, how = self.read_tracks()
            families, grid, (recordings, facts) = self.families, self.grid, table_and_facts(self.store)
            spec = self.spec(recordings)
            with progress_bar("train", "folds", grid.inner) as bar:
                model = train(recordings, grammars, spec, families, grid, how, self.seed, bar.update, facts, self.group)
        save(self.out, model)
        svm = model.svm.spec
        return {
            "model": str(self.out),
            "tracks": svm.features,
            "classes": list(model.svm.classes),
            "kernel": svm.kernel,
            "cost": svm.cost,
            "scaling": svm.scaling,
            **model.extra,
            "confounds": " ".join(examined(recordings, spec, facts)[1]),
        }

    def text(self, result: dict[str, Any]) -> str:
        learnt = (
            f"{result['model']}: {', '.join(result['classes'])} from {result['items']} sentences of "
            f"{plural(result['trials'], 'trial')}; {result['kernel']} kernel, C = {result['cost']:g}"
        )
        if "chosen_on" in result:
            learnt += f" (kernel, cost and labels chosen on {plural(result['chosen_on'], 'sentence')})"
        return "\n".join([learnt, *left_out(result["dropped"]), *_confounds(result)])


@dataclass(frozen=True)
class Classify(Command):
    """Classify every sentence of a store with a model of "rcbht train" and write a table.

    The table has a row per sentence: source, trial, arm, session, start and end in seconds, predicted class, true
    class (empty if the store has none), and a decision value for each pair of classes, positive for the first. If the
    store has true classes, the accuracy is printed, separately for trials that the model was trained on; sentences of
    classes that it has not learned are counted apart. The rate, the axes, their units and the encoder of the labels
    must be those of the training.

    Example: rcbht classify new.zarr --model states.model -o classes.csv
    """

    store: common.Store
    """Store with label tracks, made by "rcbht encode"."""
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"], metavar="MODEL"), CLASSIFIER]
    """Model file of "rcbht train"."""
    tracks: Annotated[str, unset()] = ""
    """Label tracks to use instead of those used in training; A+B if the model uses two."""
    source: common.Sources = ()
    session: common.Sessions = ()
    outcome: Annotated[tuple[str, ...], unset()] = ()
    """Outcomes of the trials to classify; default those used in training, and unknown."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="CLASSES.csv")] = Path("classes.csv")
    """Table to write: .csv, or .jsonl for JSON lines."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.atomic import atomic_write
        from rcbht_jax.io.store import unchanged
        from rcbht_jax.learning.model_io import load
        from rcbht_jax.learning.predict import check_recordings, classify, task_of

        if self.out.suffix not in (".csv", ".jsonl"):
            raise InputError(f"{self.out} must end in .csv or .jsonl, which selects the format.")
        model = load(self.model)
        spec = task_of(model, self.source, self.session, self.outcome)
        with unchanged(self.store):
            recordings, facts = table_and_facts(self.store)
            check_recordings(model, recordings, str(self.store))
            classification = classify(model, recordings, self._tracks(model), spec, facts)
        write = _csv if self.out.suffix == ".csv" else _json_lines
        with atomic_write(self.out) as draft:
            draft.write_text(write(classification, lines_of(classification, recordings)), encoding="utf-8")
        counts = Counter(classification.predicted.tolist())
        return {
            "out": str(self.out),
            "task": spec.task,
            "sentences": len(classification.predicted),
            "classes": {name: counts[name] for name in classification.classes},
            "dropped": classification.items.dropped,
            "known": int((classification.known & ~classification.seen).sum()),
            "accuracy": classification.accuracy(),
            "trained_on": int((classification.known & classification.seen).sum()),
            "accuracy_of_those": classification.accuracy(seen=True),
            "not_learned": classification.not_learned,
        }

    def _tracks(self, model: TrainedModel) -> TrackBatches:
        """The labels that the model reads, by the names that it gives them, in batches."""
        from rcbht_jax.io.label_store import choose_name, read_tracks_attrs
        from rcbht_jax.learning.predict import check_encoders, encoders_of

        names = list(encoders_of(model))
        given = self.tracks.split("+") if self.tracks else names
        if len(given) != len(names):
            raise InputError(
                f"the model reads {plural(len(names), 'label track')} ({' + '.join(names)}); "
                f"--tracks names {len(given)}."
            )
        chosen = {name: choose_name(self.store, wanted) for name, wanted in zip(names, given, strict=True)}
        check_encoders(model, {name: read_tracks_attrs(self.store, wanted) for name, wanted in chosen.items()})
        return _batches(self.store, chosen)

    def text(self, result: dict[str, Any]) -> str:
        counts = ", ".join(f"{name} {count}" for name, count in result["classes"].items())
        lines = [f"{result['out']}: {result['sentences']} sentences; {counts}"]
        lines += left_out(result["dropped"])
        strange = result["not_learned"]
        if result["accuracy"] is None and result["accuracy_of_those"] is None and not strange:
            lines.append("The store has no true classes to compare with.")
        if result["accuracy"] is not None:
            lines.append(f"accuracy: {result['accuracy']:.3f} on {result['known']} sentences of known class")
        if result["accuracy_of_those"] is not None:
            lines.append(
                f"accuracy on training data: {result['accuracy_of_those']:.3f} on {result['trained_on']} sentences, "
                "which does not apply to new trials"
            )
        if strange:
            count = plural(sum(strange.values()), "sentence")
            names = ", ".join(map(repr, strange))
            lines.append(f"not counted: {count} of {names}, which the model has not learned, so that none can be right")
        return "\n".join(lines)


def _confounds(result: dict[str, Any]) -> list[str]:
    return [f"Confounds: {result['confounds']}"] * bool(result["confounds"])


def _scores(score: dict[str, Any]) -> str:
    return "     ".join(_interval(score[key]) for key in ("accuracy", "balanced_accuracy"))


def _interval(score: dict[str, float]) -> str:
    limits = f"({score['low']:.3f} to {score['high']:.3f})" if "low" in score else ""
    return f"{score['mean']:.3f} {limits:16}"


def _table(classes: Sequence[str], confusion: list[list[int]]) -> list[str]:
    """The rows of a confusion matrix; its columns have numbers where their names would make it too wide."""
    rows, columns, most = list(classes), list(classes), len(str(max(map(max, confusion))))
    if max(map(room, rows)) + sum(2 + max(room(name), most) for name in columns) > WIDEST:
        columns = [str(number) for number in range(1, len(columns) + 1)]
        rows = [f"{number:>{len(columns[-1])}} {name}" for number, name in zip(columns, rows, strict=True)]
    width, wide = max(map(room, rows)), [max(room(name), most) for name in columns]
    return [
        padded(name, width)
        + "".join("  " + " " * (size - room(one)) + one for one, size in zip(cells, wide, strict=True))
        for name, cells in zip(["", *rows], [columns, *(map(str, row) for row in confusion)], strict=True)
    ]


def lines_of(classification: Classification, recordings: Recordings) -> list[dict[str, Any]]:
    """One line per sentence, without the decision values."""
    spans = classification.items.intervals
    columns = {
        "source": recordings.source[classification.items.row],
        "trial": recordings.trial[classification.items.row],
        "arm": recordings.arm[classification.items.row]
        if len(spans) == 1
        else np.full(len(classification.predicted), "both"),
        "session": recordings.session[classification.items.row],
        "start": np.round(spans[0].start * recordings.dt, 6),
        "end": np.round(spans[0].end * recordings.dt, 6),
        "class": classification.predicted,
        "truth": classification.items.name,
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*(c.tolist() for c in columns.values()), strict=True)]


def _csv(classification: Classification, lines: list[dict[str, Any]]) -> str:
    rows = zip((line.values() for line in lines), classification.decision.tolist(), strict=True)
    return table_text((*lines[0], *classification.pairs), *((*values, *decision) for values, decision in rows))


def _json_lines(classification: Classification, lines: list[dict[str, Any]]) -> str:
    decisions = (dict(zip(classification.pairs, values, strict=True)) for values in classification.decision.tolist())
    texts = (
        json.dumps(line | {"truth": line["truth"] or None, "decision": decision}, ensure_ascii=False, allow_nan=False)
        for line, decision in zip(lines, decisions, strict=True)
    )
    return "".join(f"{text}\n" for text in texts)


def _batches(store: Path, names: Mapping[str, str]) -> TrackBatches:
    """Label tracks, with progress while they are read: those of a large store take minutes."""
    from rcbht_jax.io.label_store import track_batches

    tracks = track_batches(store, names)
    return replace(tracks, read=lambda: iter(progress_bar("read labels", "batches", iterable=tracks.read())))
