"""``rcbht classify``."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import choose_tracks
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.model_io import TrainedModel, load
from rcbht_jax.learning.predict import Classification, check_encoders, classify, encoders_of, task_of
from rcbht_jax.types import LabelTracks, Recordings


@dataclass(frozen=True)
class Classify(Command):
    """Ask a model of "rcbht train" what class every sentence of a store is, and write a table.

    One line per sentence: trial, arm, session, start and end in seconds, class, the class that the store has (empty if
    it has none), and a decision value for each pair of classes, above zero for the first. Where the store has classes,
    the share that is right is told, for trials that the model was trained on apart. The labels must be made as those
    were that the model was trained on.

    Example: rcbht classify new.zarr --model states.model -o classes.csv
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store with label tracks, made by "rcbht encode"."""
    model: Annotated[Path, tyro.conf.arg(metavar="MODEL")]
    """Model file of "rcbht train"."""
    tracks: str = ""
    """Label tracks to read in place of those that the model names; "A+B" where it names two."""
    source: tuple[str, ...] = ()
    """Data sets; default all, not only those that were trained on."""
    session: tuple[str, ...] = ()
    """Recording sessions; default all."""
    outcome: tuple[Literal["success", "failure", "unknown"], ...] = ()
    """Outcomes of the trials; default those that were trained on, and unknown ones."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = Path("classes.csv")
    """Table to write: .csv, or .jsonl for JSON lines."""

    def run(self) -> dict[str, Any]:
        if self.out.suffix not in (".csv", ".jsonl"):
            raise InputError(f"{self.out} must end in .csv or .jsonl, which says what to write.")
        model = load(self.model)
        spec = task_of(model, self.source, self.session, self.outcome)
        tracks = self._read_tracks(model)
        recordings = read_recordings(self.store)
        found = classify(model, recordings, tracks, spec)
        write = _csv if self.out.suffix == ".csv" else _json_lines
        with atomic_write(self.out) as draft:
            draft.write_text(write(found, lines_of(found, recordings)), encoding="utf-8")
        said = Counter(found.said.tolist())
        return {
            "out": str(self.out),
            "task": spec.task,
            "sentences": len(found.said),
            "classes": {name: said[name] for name in found.classes},
            "dropped": found.items.dropped,
            "known": int((found.known & ~found.seen).sum()),
            "accuracy": found.accuracy(),
            "trained_on": int(found.seen.sum()),
            "accuracy_of_those": found.accuracy(seen=True),
        }

    def _read_tracks(self, model: TrainedModel) -> dict[str, LabelTracks]:
        """The labels that the model reads, by the names that it gives them."""
        names = list(encoders_of(model))
        given = self.tracks.split("+") if self.tracks else names
        if len(given) != len(names):
            raise InputError(
                f"the model reads {len(names)} label tracks ({' + '.join(names)}); --tracks names {len(given)}."
            )
        found = {name: choose_tracks(self.store, wanted) for name, wanted in zip(names, given, strict=True)}
        check_encoders(model, {name: attrs for name, (_, _, attrs) in found.items()})
        return {name: labels for name, (_, labels, _) in found.items()}

    def text(self, result: dict[str, Any]) -> str:
        counts = ", ".join(f"{name} {count}" for name, count in result["classes"].items())
        lines = [f"{result['out']}: {result['sentences']} sentences; {counts}"]
        lines += [f"left out: {count} trials, {reason}" for reason, count in result["dropped"].items()]
        if result["accuracy"] is None and result["accuracy_of_those"] is None:
            lines.append("The store does not say what they are.")
        if result["accuracy"] is not None:
            lines.append(f"right: {result['accuracy']:.3f} of {result['known']} whose class is known")
        if result["accuracy_of_those"] is not None:
            lines.append(
                f"right: {result['accuracy_of_those']:.3f} of {result['trained_on']} sentences that the model was "
                "trained on, which says nothing about new ones"
            )
        return "\n".join(lines)


def lines_of(found: Classification, recordings: Recordings) -> list[dict[str, Any]]:
    """One line per sentence, without the decision values."""
    spans = found.items.intervals
    columns = {
        "source": recordings.source[found.items.row],
        "trial": recordings.trial[found.items.row],
        "arm": recordings.arm[found.items.row] if len(spans) == 1 else np.full(len(found.said), "both"),
        "session": recordings.session[found.items.row],
        "start": np.round(spans[0].start * recordings.dt, 6),
        "end": np.round(spans[0].end * recordings.dt, 6),
        "class": found.said,
        "truth": found.items.name,
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*(c.tolist() for c in columns.values()), strict=True)]


def _csv(found: Classification, lines: list[dict[str, Any]]) -> str:
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*lines[0], *found.pairs])
    writer.writerows([*line.values(), *values] for line, values in zip(lines, found.decision.tolist(), strict=True))
    return table.getvalue()


def _json_lines(found: Classification, lines: list[dict[str, Any]]) -> str:
    decisions = (dict(zip(found.pairs, values, strict=True)) for values in found.decision.tolist())
    texts = (
        json.dumps(line | {"truth": line["truth"] or None, "decision": decision}, ensure_ascii=False, allow_nan=False)
        for line, decision in zip(lines, decisions, strict=True)
    )
    return "".join(f"{text}\n" for text in texts)
