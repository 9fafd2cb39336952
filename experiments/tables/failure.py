"""Failures, not deviations: alarms against the outcome, failures foretold, and types in another batch."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import NONE, markdown, score, table

Result = dict[str, Any]
KINDS = {
    "jamming": "jamming", "wedging": "wedging", "missing-tab": "missing tab", "moved-part": "moved part",
    "early-stop": "early stop",
}  # fmt: skip
EVERY = "every kind of fault"


@table("faults-outcome", "faults_outcome")
def faults_outcome(result: Result) -> str:
    """Alarms of the monitor against the outcome, by kind of fault; trials with and without contact."""
    lines = [
        (session, kind.replace("-", " "), *(score(cell) for cell in row.values()))
        for session, kinds in result["sessions"].items()
        for kind, row in kinds.items()
    ]
    return markdown(("session", "fault", "sensitivity", "specificity on seated faults", "precision"), lines)


@table("will-it-seat", "will_it_seat")
def will_it_seat(result: Result) -> str:
    """Areas under the ROC curve of failures foretold, by kind of fault."""
    lines = []
    for name, row in result["rows"].items():
        if "area" in row:
            where, method = name.split(" | ")
            lines.append((where, method, *(score(row["area"][kind]) for kind in (EVERY, *KINDS))))
    return markdown(("sessions", "method", "every kind", *KINDS.values()), lines)


@table("will-it-seat-said", "will_it_seat")
def will_it_seat_said(result: Result) -> str:
    """Sensitivity and specificity of the belief in the outcome at a threshold of one half."""
    lines = []
    titles = {**KINDS, EVERY: "every kind", "none": "no fault", "no contact": "no contact"}
    for session in result["severities"]:
        trials = result["rows"][f"{session} | trials"]
        row = result["rows"][f"{session} | belief in the outcome"]["said at 0.5"]
        other = result["rows"][f"{session} | belief in a deviation"]["said at 0.5"]
        for kind, title in titles.items():
            facts = trials.get(kind)
            count = f"{facts['failed']} of {facts['trials']}" if facts else NONE
            cells = (score(row[kind][name]) for name in ("sensitivity", "specificity", "precision"))
            lines.append((session, title, count, *cells, score(other[kind]["specificity"])))
    head = (
        "",
        "fault",
        "failed",
        "sensitivity",
        "specificity",
        "precision",
        "specificity of the belief in a deviation",
    )
    return markdown(head, lines)


@table("types-across", "types_across")
def types_across(result: Result) -> str:
    """Failure types of the batch that did not train, from contact on, and the ceilings."""
    ways = ("begins at rest to begins loaded", "begins loaded to begins at rest")
    rows = result["rows"]
    kinds = [name.split(" | ")[1] for name in rows if name.startswith(f"{ways[0]} | ")]
    lines = [(kind, *(score(rows[f"{way} | {kind}"]["score"]) for way in ways)) for kind in kinds]
    tested = ("begins loaded", "begins at rest")
    lines.append(("ceiling: folds within the tested batch", *(score(rows[f"within | {b}"]["score"]) for b in tested)))
    return markdown(("trained on", "at rest to loaded", "loaded to at rest"), lines)


@table("types-across-recall", "types_across")
def types_across_recall(result: Result) -> str:
    """Which types are recognised in the other batch, and which in their own."""
    rows = result["rows"]
    columns = {
        "at rest to loaded": "begins at rest to begins loaded | other batch",
        "within loaded": "within | begins loaded",
        "loaded to at rest": "begins loaded to begins at rest | other batch",
        "within at rest": "within | begins at rest",
    }
    lines = [(name, *(f"{rows[row]['recall'][name]:.2f}" for row in columns.values())) for name in result["classes"]]
    return markdown(("type", *columns), lines)
