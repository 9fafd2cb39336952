"""Scores of committed results with 95 % intervals of some width: what tables, pictures and rows of the report show.

Where nothing was wrong, and from one session or batch to another, intervals are Wilson's, each trial counting once
(docs/evaluation.md); else those of the results.
"""

from __future__ import annotations

from typing import Any

from experiments._lib.intervals import by_trial, tested, with_width

Record = dict[str, Any]
# Rows of the experiment "grammar" that are compared with the peers, and their titles there.
RICHER = {
    "richer words, choice of grammar": "richer words + SVM, without duration and offset",
    "richer words and levels, choice of grammar": "richer words and levels + SVM",
    "all families": "richer words + SVM, all",
}
TABLE1 = ("paper's features, nested, grouped", "words, nested, grouped", "duration alone")


def by_benchmark(rows: Record) -> dict[str, Record]:
    """Rows named "benchmark | method" as benchmark -> method -> row."""
    nested: dict[str, Record] = {}
    for name, row in rows.items():
        benchmark, method = name.split(" | ")
        nested.setdefault(benchmark, {})[method] = row
    return nested


def of_methods(result: Record, headline: Record) -> dict[str, Record]:
    """Benchmark -> method -> row, of the result "peers" or "grammar".

    The majority of classes that are equally frequent is right in the same share of any trials, and keeps no interval.
    """
    found = by_benchmark(result["rows"])
    for benchmark, rows in found.items():
        facts = result["benchmarks"][benchmark]
        folds = "folds" in facts["split"]
        trials = facts["trials"] if folds else tested(headline, benchmark)
        for method, row in rows.items():
            if method != "majority":
                score = row["accuracy"]
                score = with_width(score, trials) if folds else by_trial(score["mean"], trials)
                rows[method] = {**row, "accuracy": score}
    return found


def of_peers(peers: Record, grammar: Record, headline: Record) -> dict[str, Record]:
    """Benchmark -> method -> row with its kind ("peer", "ours" or "probe"), from two results on the same folds."""
    found, richer = of_methods(peers, headline), of_methods(grammar, headline)
    for benchmark, rows in found.items():
        rows |= {title: {"kind": "ours", **richer[benchmark][method]} for method, title in RICHER.items()}
    return found


def of_probes(probes: Record) -> dict[str, Record]:
    """Question -> view -> balanced accuracy, without the majority's."""
    return {
        question: {
            view: with_width(row["balanced_accuracy"], sum(row["trials"].values()))
            for view, row in views.items()
            if view != "majority"
        }
        for question, views in by_benchmark(probes["rows"]).items()
    }


def of_table1(result: Record) -> dict[str, Record]:
    """Row of the result "table1_ours" -> one of ``TABLE1`` -> accuracy."""
    found = {}
    for name, row in result["rows"].items():
        trials = max(row["items"].values()) if "states" in name else sum(row["items"].values())
        found[name] = {kind: with_width(row[kind]["accuracy"], trials) for kind in TABLE1}
    return found


def of_two_arms(result: Record) -> dict[str, tuple[int, Record]]:
    """Row of the result "two_arm_states" -> trials that were tested, and method -> accuracy."""
    rows = {name: dict(row) for name, row in result.items() if isinstance(row, dict)}
    trials = {name: row.pop("trials") for name, row in rows.items()}
    found = {}
    for name, row in rows.items():
        other = name.partition(", tested on ")[2]
        count = trials[f"{other}, cross-validated" if other else name]
        scores = {
            kind: by_trial(score["mean"], count) if other else with_width(score, count) for kind, score in row.items()
        }
        found[name] = count, scores
    return found
