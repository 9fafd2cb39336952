"""Scores of committed results: what tables, pictures and rows of the report show."""

from __future__ import annotations

from typing import Any

Record = dict[str, Any]
# Rows of the experiment "grammar" that are compared with the peers, and their titles there.
RICHER = {
    "richer words, choice of grammar": "richer words + SVM, without duration and offset",
    "richer words and levels, choice of grammar": "richer words and levels + SVM",
    "all families": "richer words + SVM, all",
}
TABLE1 = ("paper's features, nested, grouped", "words, nested, grouped", "duration alone")


def mean_of(score: Record) -> float:
    return float(score["mean"] if "mean" in score else score["accuracy"])


def ends_of(score: Record) -> tuple[float, float] | None:
    """The ends of a score's 95 % interval, which results hold as a pair or one by one; None = it has none."""
    low, high = score["interval"] if "interval" in score else (score.get("low"), score.get("high"))
    return None if low is None else (low, high)


def by_benchmark(rows: Record) -> dict[str, Record]:
    """Rows named "benchmark | method" as benchmark -> method -> row."""
    nested: dict[str, Record] = {}
    for name, row in rows.items():
        benchmark, method = name.split(" | ")
        nested.setdefault(benchmark, {})[method] = row
    return nested


def of_peers(peers: Record, grammar: Record) -> dict[str, Record]:
    """Benchmark -> method -> row with its kind ("peer", "ours" or "probe"), from two results on the same folds."""
    found, richer = by_benchmark(peers["rows"]), by_benchmark(grammar["rows"])
    for benchmark, rows in found.items():
        rows |= {title: {"kind": "ours", **richer[benchmark][method]} for method, title in RICHER.items()}
    return found


def of_probes(probes: Record) -> dict[str, Record]:
    """Question -> view -> balanced accuracy, without the majority's."""
    return {
        question: {view: row["balanced_accuracy"] for view, row in views.items() if view != "majority"}
        for question, views in by_benchmark(probes["rows"]).items()
    }


def of_table1(result: Record) -> dict[str, Record]:
    """Row of the result "table1_ours" -> one of ``TABLE1`` -> accuracy."""
    return {name: {kind: row[kind]["accuracy"] for kind in TABLE1} for name, row in result["rows"].items()}


def of_two_arms(result: Record) -> dict[str, tuple[int, Record]]:
    """Row of the result "two_arm_states" -> trials that were tested, and method -> accuracy."""
    rows = {name: dict(row) for name, row in result.items() if isinstance(row, dict)}
    trials = {name: row.pop("trials") for name, row in rows.items()}
    tested = {name: name.partition(", tested on ")[2] for name in rows}
    return {
        name: (trials[f"{tested[name]}, cross-validated" if tested[name] else name], row) for name, row in rows.items()
    }
