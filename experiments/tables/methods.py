"""Tables of methods on the same folds: words, peers, probes, and Table I of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from experiments._lib.peer_rows import compared, result
from experiments.tables.cells import NONE, markdown, score

FOLDED = ("REAL states", "SIM1 states", "SIM2 states", "failure types")


def _peers(benchmarks: Sequence[str]) -> str:
    found = compared()
    kinds = {method: row["kind"] for rows in found.values() for method, row in rows.items()}
    lines = []
    for kind in ("peer", "ours", "probe"):
        for method in (name for name, of in kinds.items() if of == kind):
            said = (found[benchmark].get(method, {}).get("accuracy") for benchmark in benchmarks)
            lines.append((f"*{method}*" if kind == "probe" else method, *map(score, said)))
    return markdown(("", *benchmarks), lines)


def peers_folds(way: str) -> str:
    """Other methods and words by cross-validation."""
    return _peers(FOLDED)


def peers_sessions(way: str) -> str:
    """Other methods and words from one session to another."""
    return _peers([name for name in compared() if name not in FOLDED])


def _grammar(benchmarks: Sequence[str]) -> str:
    found: dict[str, dict[str, Any]] = {}
    for name, row in result("grammar")["rows"].items():
        benchmark, method = name.split(" | ")
        found.setdefault(method, {})[benchmark] = row["accuracy"]
    lines = [(method, *(score(row.get(benchmark)) for benchmark in benchmarks)) for method, row in found.items()]
    return markdown(("", *benchmarks), lines)


def grammar_folds(way: str) -> str:
    """Words of several kinds by cross-validation."""
    return _grammar(FOLDED)


def grammar_sessions(way: str) -> str:
    """Words of several kinds from one session or batch to another."""
    return _grammar([name for name in result("grammar")["benchmarks"] if name not in FOLDED])


def table1(way: str) -> str:
    """Table I of the paper on our labels."""
    lines = []
    for name, row in result("table1_ours")["rows"].items():
        what, labels = name.split(" | ")
        paper = NONE if row["paper"] is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*row["paper"])
        low, mean, high = row["paper's features, paper's protocol"]["fold_min_mean_max"]
        nested, words = (row[f"{kind}, nested, grouped"]["accuracy"] for kind in ("paper's features", "words"))
        alone = row["duration alone"]["accuracy"]
        ours = (f"{mean:.3f} ({low:.3f} to {high:.3f})", score(nested), score(words), score(alone, False))
        lines.append((what, labels, paper, *ours))
    head = ("", "labels", "paper: mean (min to max)", "paper's features and protocol: mean (min to max)")
    return markdown((*head, "paper's features, nested, grouped", "words, nested, grouped", "duration alone"), lines)


def probes(way: str) -> str:
    """What tells failure, success and session without any assembly."""
    found: dict[str, dict[str, Any]] = {}
    for name, row in result("probes")["rows"].items():
        question, view = name.split(" | ")
        found.setdefault(question, {})[view] = row["balanced_accuracy"]
    views = list(next(iter(found.values())))[1:]
    lines = [(question, *(score(row.get(view)) for view in views)) for question, row in found.items()]
    return markdown(("balanced accuracy", *views), lines)


def two_arm(way: str) -> str:
    """The four states from both arms' grammars, within a set and from one set to another."""
    rows = {name: row for name, row in result("two_arm_states").items() if isinstance(row, dict)}
    kinds = [kind for kind in next(iter(rows.values())) if kind != "trials"]
    names = {name: name.replace("two", "`two`", 1).replace("`two`-fixed", "`two-fixed`") for name in rows}
    return markdown(("", *kinds), [(names[name], *(score(row[kind]) for kind in kinds)) for name, row in rows.items()])


def two_arm_fidelity(way: str) -> str:
    """How near simulated two-arm trials are to the recorded ones, beside these among themselves."""
    found = result("two_arm")
    rows: dict[str, dict[str, float]] = {}
    for preset in ("two", "two-fixed"):
        for name, cell in found[preset]["signature of trials like the recorded ones"].items():
            if name in ("right", "left"):
                rows[f"`{preset}`, {name} wrist"] = cell
            elif "half against half" in name:
                rows[f"*{name}*"] = cell
    names = ("coverage", "w1_over_sd", "dtw_over_sd")
    lines = [(name, *(f"{cell[key]:.3f}" for key in names)) for name, cell in sorted(rows.items(), reverse=True)]
    return markdown(("", "coverage", "Wasserstein / sd", "time warping / sd"), lines)


TABLES = {
    "peers-folds": peers_folds,
    "peers-sessions": peers_sessions,
    "grammar-folds": grammar_folds,
    "grammar-sessions": grammar_sessions,
    "table1": table1,
    "probes": probes,
    "two-arm": two_arm,
    "two-arm-fidelity": two_arm_fidelity,
}
