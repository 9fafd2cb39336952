"""Rows of the reports' table of results, in the schema of docs/howto/share.md, from the committed results."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from experiments._lib.headline_rows import SOURCES, headline_rows
from experiments._lib.results_io import COMMITTED, committed
from experiments._lib.scores import RICHER, by_benchmark, ends_of, mean_of, of_probes, of_table1, of_two_arms
from rcbht_jax.report.results import SCHEMA

NAME = "report_rows"
NOTES = {
    "sessions": "The classes were recorded in different sessions, which differ before contact: the score does not show "
    "that failure was recognised.",
    "lengths": "The classes differ in length; compare the score with that of duration alone.",
    "approach": "The approach differs between types, so the type can be predicted before contact: the score does not "
    "show that a failure was recognised from its contact.",
    "batches": "Failures of one batch share their starting pose and length; scores on batches not trained on are far "
    "lower.",
    "published": "The paper scored complete sequences of one selected split; ours are trials never trained on, "
    "in repeated splits.",
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


def _row(
    group: str, what: str, score: Record, flags: tuple[str, ...], source: str,
    paper: str = "", peer: Record | None = None, duration: float | None = None,
) -> Record:  # fmt: skip
    return {
        "group": group, "what": what, "paper": paper, "ours": mean_of(score), "interval": _interval(score),
        "peer": peer, "duration": duration, "flags": flags, "source": f"{source}.json",
    }  # fmt: skip


def _peer(name: str, score: Record) -> Record:
    return {"name": name, "mean": mean_of(score), "interval": _interval(score)}


def _interval(score: Record) -> list[float]:
    return [round(end, 6) for end in ends_of(score) or ()]


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
        flags = ("approach", "batches", "lengths") if benchmark.startswith("failure types") else ("lengths",)
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
    for question, scores in of_probes(committed("probes")).items():
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
    result = committed("table1_ours")
    for name, scores in of_table1(result).items():
        what, labels = name.split(" | ")
        printed = result["rows"][name]["paper"]
        paper = "" if printed is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*printed)
        yield _row(
            "Words, Table I of the paper on our labels", f"{what}, {labels} labels", scores["words, nested, grouped"],
            _flags(what == "REAL success/failure"), "table1_ours", paper, duration=scores["duration alone"]["mean"],
        )  # fmt: skip


def _table1() -> Iterator[Record]:
    for what, row in committed("table1_published")["rows"].items():
        low, mean, high = row["target"]["paper"]
        folds = "grouped" if "grouped" in row["measured"] else "repeated"
        yield _row(
            "Offline, published features", f"{what}, {folds}{' by trial' if folds == 'grouped' else ''}",
            row["measured"][folds], _flags("success/failure" in what),
            "table1_published", f"{mean:.2f} ({low:.2f} to {high:.2f})",
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
    for what, (trials, scores) in of_two_arms(committed("two_arm_states")).items():
        yield _row(
            "Two arms, states", f"{what} ({trials} trials)", scores["words"], ("lengths",), "two_arm_states",
            duration=scores["duration alone"]["mean"],
        )  # fmt: skip
