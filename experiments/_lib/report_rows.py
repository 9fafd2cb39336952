"""Rows of the reports' table of results, in the schema of docs/howto/share.md, from the committed results."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from experiments._lib.headline_rows import SOURCES, headline_rows
from experiments._lib.intervals import by_trial, tested, with_width
from experiments._lib.results_io import COMMITTED, committed
from rcbht_jax.report.results import SCHEMA

NAME = "report_rows"
NOTES = {
    "sessions": "The classes were recorded in different sessions, which differ before contact: the score does not show "
    "that failure was recognised.",
    "lengths": "The classes differ in length; compare the score with that of duration alone.",
    "batches": "Failures of one batch share their starting pose and length; scores on batches not trained on are far "
    "lower.",
    "published": "The paper scored complete sequences of one selected split; ours are trials never trained on, "
    "in repeated splits.",
}
# Rows of the experiment "grammar" that are compared with the peers, and their titles there.
RICHER = {
    "richer words, choice of grammar": "richer words + SVM, without duration and offset",
    "richer words and levels, choice of grammar": "richer words and levels + SVM",
    "all families": "richer words + SVM, all",
}
_PRINTED = {"REAL states": "0.97 (0.93 to 1.00)", "SIM1 states": "0.89 (0.84 to 0.94)", "SIM2 states": "1.00"}
Record = dict[str, Any]


def report_rows() -> Record:
    """The content of ``experiments/results/report_rows.json``."""
    readers = (_frozen, _words, _probes, _sim_to_real, _table1_ours, _table1, _table2, _two_arm)
    sources = []
    for path in sorted(COMMITTED.glob("*.json")):
        if path.stem != NAME:
            record = json.loads(path.read_text(encoding="utf-8"))
            facts = {key: record.get(key, "not recorded") for key in ("command", "date", "machine")}
            sources.append({"file": path.name, **facts})
    return {"schema": SCHEMA, "notes": NOTES, "sources": sources, "rows": [row for read in readers for row in read()]}


def by_benchmark(rows: Record) -> dict[str, Record]:
    """Rows named "benchmark | method" as benchmark -> method -> row."""
    nested: dict[str, Record] = {}
    for name, row in rows.items():
        benchmark, method = name.split(" | ")
        nested.setdefault(benchmark, {})[method] = row
    return nested


def with_intervals(nested: Record, benchmarks: Record, headline: Record) -> Record:
    """Benchmark -> method -> row, whose accuracy has an interval of some width, by the trials that were tested.

    From one session or batch to another it is Wilson's, for which resampled trials are too few (docs/evaluation.md).
    The majority of classes that are equally frequent is right in the same share of any trials, and keeps none.
    """
    found: Record = {}
    for benchmark, rows in nested.items():
        folds = "folds" in benchmarks[benchmark]["split"]
        trials = benchmarks[benchmark]["trials"] if folds else tested(headline, benchmark)
        found[benchmark] = {}
        for method, row in rows.items():
            score = row["accuracy"]
            if method != "majority":
                score = with_width(score, trials) if folds else by_trial(score["mean"], trials)
            found[benchmark][method] = {**row, "accuracy": score}
    return found


def peer_rows(peers: Record, grammar: Record) -> dict[str, Record]:
    """Benchmark -> method -> row with its kind ("peer", "ours" or "probe"), from two results on the same folds."""
    nested = by_benchmark(peers["rows"])
    for benchmark, rows in nested.items():
        for method, title in RICHER.items():
            rows[title] = {"kind": "ours", **grammar["rows"][f"{benchmark} | {method}"]}
    return nested


def _row(
    group: str, what: str, score: Record, flags: tuple[str, ...], source: str,
    paper: str = "", peer: Record | None = None, duration: float | None = None,
) -> Record:  # fmt: skip
    ends = _interval(score)  # of no width: no mistake, or the same in every trial
    return {
        "group": group, "what": what, "paper": paper, "ours": _mean(score),
        "interval": ends if ends[0] < ends[1] else None,
        "peer": peer, "duration": duration, "flags": flags, "source": f"{source}.json",
    }  # fmt: skip


def _peer(name: str, score: Record) -> Record:
    return {"name": name, "mean": _mean(score), "interval": _interval(score)}


def _mean(score: Record) -> float:
    return float(score["mean"] if "mean" in score else score["accuracy"])


def _interval(score: Record) -> tuple[float, float]:
    low, high = score["interval"] if "interval" in score else (score["low"], score["high"])
    return low, high


def _frozen() -> Iterator[Record]:
    """The frozen method, on every benchmark."""
    for row in headline_rows(*map(committed, SOURCES)):
        yield _row(
            f"One frozen method ({row.method[:12]})", row.title, row.score, row.flags, row.source, row.paper,
            _peer(*row.peer), row.duration["mean"],
        )  # fmt: skip


def _words() -> Iterator[Record]:
    """Words and the best of the other methods."""
    peers, richer = (by_benchmark(committed(name)["rows"]) for name in ("peers", "grammar"))
    for benchmark in peers | richer:
        flags = ("batches", "lengths") if benchmark.startswith("failure types") else ("lengths",)
        others = {name: row["accuracy"] for name, row in peers.get(benchmark, {}).items() if row["kind"] == "peer"}
        best = max(others, key=lambda name: others[name]["mean"], default="")
        ours = [("grammar", title, name) for name, title in RICHER.items()]
        ours += [("peers", name, name) for name, row in peers.get(benchmark, {}).items() if row["kind"] == "ours"]
        for source, title, name in ours:
            methods = (richer if source == "grammar" else peers).get(benchmark, {})
            if name in methods:
                yield _row(
                    "Words and other methods on the same folds", f"{benchmark}: {title}", methods[name]["accuracy"],
                    flags, source, _PRINTED.get(benchmark, ""), _peer(best, others[best]) if best else None,
                    methods["duration alone"]["accuracy"]["mean"],
                )  # fmt: skip


def _probes() -> Iterator[Record]:
    """Words, and a classifier that cannot know the outcome."""
    for question, views in by_benchmark(committed("probes")["rows"]).items():
        scores = {view: row["balanced_accuracy"] for view, row in views.items()}
        words = next((score for view, score in scores.items() if view.startswith("words")), None)
        if words is not None:
            yield _row(
                "Success, failure and session: words beside the first second alone, balanced accuracy", question, words,
                ("sessions", "lengths"), "probes", peer=_peer("first second alone", scores["first second alone"]),
                duration=scores["duration alone"]["mean"],
            )  # fmt: skip


def _sim_to_real() -> Iterator[Record]:
    """Classifiers trained on simulated trials only, tested on recorded ones."""
    rows = committed("sim_to_real")["rows"]
    rows = {name.partition(" | ")[2]: row for name, row in rows.items() if name.startswith(("main", "base"))}
    raw, alone = (rows.pop(name) for name in ("statistics of the raw wrench, random forest", "duration alone"))
    for name, row in rows.items():
        for states in ("merged", "harmonised"):
            same = name == "all presets"  # only there were the others trained on the same trials
            peer = _peer("raw statistics + forest", raw[states]["A+B"]) if same else None
            yield _row(
                "Trained on simulation, tested on recorded trials", f"{name}, {states} states", row[states]["A+B"],
                ("lengths",), "sim_to_real", peer=peer, duration=alone[states]["A+B"]["accuracy"] if same else None,
            )  # fmt: skip


def _table1_ours() -> Iterator[Record]:
    """Words for every set and kind of labels; the other protocols are in the file."""
    for name, row in committed("table1_ours")["rows"].items():
        what, labels = name.split(" | ")
        paper = "" if row["paper"] is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*row["paper"])
        yield _row(
            "Words, Table I of the paper on our labels", f"{what}, {labels} labels",
            row["words, nested, grouped"]["accuracy"], _flags(what == "REAL success/failure"), "table1_ours", paper,
            duration=row["duration alone"]["accuracy"]["mean"],
        )  # fmt: skip


def _table1() -> Iterator[Record]:
    for what, row in committed("table1_published")["rows"].items():
        low, mean, high = row["target"]["paper"]
        folds = "grouped" if "grouped" in row["measured"] else "repeated"
        yield _row(
            "Offline, published features", f"{what}, {folds}{' by trial' if folds == 'grouped' else ''}",
            row["measured"][folds], _flags("success/failure" in what), "table1_published",
            f"{mean:.2f} ({low:.2f} to {high:.2f})",
        )  # fmt: skip


def _flags(sessions: bool) -> tuple[str, ...]:
    return ("sessions", "lengths") if sessions else ("lengths",)


def _table2() -> Iterator[Record]:
    result = committed("table2")
    for what, row in result["rows"].items():
        if what.endswith("10 Hz"):  # the paper's other rates are in the file
            paper = result["paper"].get(what.split()[0], {})
            for measure in ("macro step accuracy", "full-sequence accuracy", "OverallPr"):
                printed = paper.get(measure)
                yield _row(
                    "Online, states of trials not trained on", f"{what}, {measure}", row["all"][measure],
                    ("published", "lengths") if printed else ("lengths",), "table2",
                    "" if printed is None else f"{printed:.2f}",
                )  # fmt: skip


def _two_arm() -> Iterator[Record]:
    for what, row in committed("two_arm_states").items():
        if isinstance(row, dict):
            yield _row(
                "Two arms, states", f"{what} ({row['trials']} trials)", row["words"], ("lengths",), "two_arm_states",
                duration=row["duration alone"]["mean"],
            )  # fmt: skip
