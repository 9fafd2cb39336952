"""Failures, not deviations: alarms against the outcome, failures foretold, and types in another batch."""

from __future__ import annotations

from typing import Any

from experiments._lib.intervals import by_trial
from experiments.tables.cells import NONE, Lines, score, table

Result = dict[str, Any]
KINDS = {kind: kind.replace("-", " ") for kind in ("jamming", "wedging", "missing-tab", "moved-part", "early-stop")}
EVERY = "every kind of fault"


@table("faults-outcome", "faults_outcome")
def faults_outcome(result: Result) -> Lines:
    """Alarms of the monitor against the outcome, by kind of fault; trials with and without contact."""
    yield "session", "fault", "sensitivity", "specificity on seated faults", "precision"
    for session, kinds in result["sessions"].items():
        for kind, row in kinds.items():
            yield (session, kind.replace("-", " "), *(score(cell) for cell in row.values()))


@table("will-it-seat", "will_it_seat")
def will_it_seat(result: Result) -> Lines:
    """Areas under the ROC curve of failures foretold, by kind of fault."""
    yield ("sessions", "method", "every kind", *KINDS.values())
    for name, row in result["rows"].items():
        if "area" in row:
            where, method = name.split(" | ")
            yield (where, method, *(score(row["area"][kind]) for kind in (EVERY, *KINDS)))


@table("will-it-seat-said", "will_it_seat")
def will_it_seat_said(result: Result) -> Lines:
    """Sensitivity and specificity of the belief in the outcome at a threshold of one half."""
    scores = ("sensitivity", "specificity", "precision")
    yield ("", "fault", "failed", *scores, "specificity of the belief in a deviation")
    titles = {**KINDS, EVERY: "every kind", "none": "no fault", "no contact": "no contact"}
    for session in result["severities"]:
        trials = result["rows"][f"{session} | trials"]
        row = result["rows"][f"{session} | belief in the outcome"]["said at 0.5"]
        other = result["rows"][f"{session} | belief in a deviation"]["said at 0.5"]
        for kind, title in titles.items():
            facts = trials.get(kind)
            count = f"{facts['failed']} of {facts['trials']}" if facts else NONE
            cells = (score(row[kind][name]) for name in scores)
            yield (session, title, count, *cells, score(other[kind]["specificity"]))


@table("types-across", "types_across")
def types_across(result: Result) -> Lines:
    """Failure types of the batch that did not train, from contact on and by the approach, and those within a batch."""
    ways = ("begins at rest to begins loaded", "begins loaded to begins at rest")
    rows = result["rows"]
    kinds = [name.split(" | ")[1] for name in rows if name.startswith(f"{ways[0]} | ")]
    yield "trained on", "at rest to loaded", "loaded to at rest"
    for kind in kinds:
        yield (kind, *(score(rows[f"{way} | {kind}"]["score"]) for way in ways))
    tested = ("begins loaded", "begins at rest")
    yield ("folds within the tested batch", *(score(rows[f"within | {b}"]["score"]) for b in tested))
    alone = (score(rows[f"within | {b} | approach alone"]["score"]) for b in tested)
    yield ("folds within the tested batch, approach alone", *alone)


@table("types-across-recall", "types_across")
def types_across_recall(result: Result) -> Lines:
    """Which types are recognised in the other batch, and which in their own."""
    rows = result["rows"]
    columns = {
        "at rest to loaded": "begins at rest to begins loaded | other batch",
        "within loaded": "within | begins loaded",
        "loaded to at rest": "begins loaded to begins at rest | other batch",
        "within at rest": "within | begins at rest",
    }
    yield ("type", *columns)
    for name in result["classes"]:
        cells = [rows[row] for row in columns.values()]
        yield (name, *(score(by_trial(cell["recall"][name], sum(cell["true and said"][name]))) for cell in cells))
