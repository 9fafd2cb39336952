"""Tables of methods on the same folds: words, peers, probes, and Table I of the paper."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from experiments._lib.scores import by_benchmark, of_peers, of_probes, of_table1, of_two_arms
from experiments.tables.cells import NONE, Lines, score, table

FOLDED = ("REAL states", "SIM1 states", "SIM2 states", "failure types")
Result = dict[str, Any]


def _others(benchmarks: Iterable[str]) -> list[str]:
    return [name for name in benchmarks if name not in FOLDED]


def _peers(peers: Result, grammar: Result, folded: bool) -> Lines:
    """Other methods and words, by cross-validation or from one session to another."""
    nested = of_peers(peers, grammar)
    benchmarks = FOLDED if folded else _others(nested)
    kinds = {method: row["kind"] for rows in nested.values() for method, row in rows.items()}
    yield ("", *benchmarks)
    for kind in ("peer", "ours", "probe"):
        for method in (name for name, of in kinds.items() if of == kind):
            scores = (nested[benchmark].get(method, {}).get("accuracy") for benchmark in benchmarks)
            yield (f"*{method}*" if kind == "probe" else method, *map(score, scores))


table("peers-folds", "peers", "grammar")(partial(_peers, folded=True))
table("peers-sessions", "peers", "grammar")(partial(_peers, folded=False))


def _grammar(result: Result, folded: bool) -> Lines:
    """Words of several kinds, by cross-validation or from one session or batch to another."""
    nested = by_benchmark(result["rows"])
    benchmarks = FOLDED if folded else _others(result["benchmarks"])
    yield ("", *benchmarks)
    for method in dict.fromkeys(method for rows in nested.values() for method in rows):
        scores = (nested[name].get(method, {}).get("accuracy") for name in benchmarks)
        yield (method, *map(score, scores))


table("grammar-folds", "grammar")(partial(_grammar, folded=True))
table("grammar-sessions", "grammar")(partial(_grammar, folded=False))


@table("table1", "table1_ours")
def table1(result: Result) -> Lines:
    """Table I of the paper on our labels."""
    scores = of_table1(result)
    head = ("", "labels", "paper: mean (min to max)", "paper's features and protocol: mean (min to max)")
    yield (*head, "paper's features, nested, grouped", "words, nested, grouped", "duration alone")
    for name, row in result["rows"].items():
        what, labels = name.split(" | ")
        paper = NONE if row["paper"] is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*row["paper"])
        low, mean, high = row["paper's features, paper's protocol"]["fold_min_mean_max"]
        nested, words, alone = scores[name].values()
        ours = (f"{mean:.3f} ({low:.3f} to {high:.3f})", score(nested), score(words), score(alone, False))
        yield (what, labels, paper, *ours)


@table("probes", "probes")
def probes(result: Result) -> Lines:
    """Scores of probes that separate failure, success and session without any assembly."""
    nested = of_probes(result)
    views = list(next(iter(nested.values())))
    yield ("balanced accuracy", *views)
    for question, row in nested.items():
        yield (question, *(score(row[view]) for view in views))


@table("two-arm", "two_arm_states")
def two_arm(result: Result) -> Lines:
    """The four states from both arms' grammars, within a set and from one set to another."""
    rows = {name: scores for name, (_, scores) in of_two_arms(result).items()}
    yield ("", *next(iter(rows.values())))
    for name, row in rows.items():
        yield (name.replace("two", "`two`", 1).replace("`two`-fixed", "`two-fixed`"), *map(score, row.values()))


@table("two-arm-fidelity", "two_arm")
def two_arm_fidelity(result: Result) -> Lines:
    """Distance of simulated two-arm trials from the recorded ones, and of these from each other."""
    rows: dict[str, dict[str, float]] = {}
    for preset in ("two", "two-fixed"):
        for name, cell in result[preset]["signature of trials like the recorded ones"].items():
            if name in ("right", "left"):
                rows[f"`{preset}`, {name} wrist"] = cell
            elif "half against half" in name:
                rows[f"*{name}*"] = cell
    names = ("coverage", "w1_over_sd", "dtw_over_sd")
    yield "", "coverage", "Wasserstein / sd", "time warping / sd"
    for name, cell in sorted(rows.items(), reverse=True):
        yield (name, *(f"{cell[key]:.3f}" for key in names))
