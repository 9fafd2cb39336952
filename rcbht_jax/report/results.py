"""Rows of the results table, read from the committed JSON files of the experiments; nothing is typed in by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rcbht_jax.errors import InputError

SESSIONS = "sessions"  # classes were recorded in different sessions
LENGTHS = "lengths"  # classes differ in duration
BATCHES = "batches"  # trials of a class were recorded together
PUBLISHED = "published"  # what the paper measured is not what the words say

FLAGS = {
    SESSIONS: "The classes were recorded in different sessions, which are told apart before contact: the score does "
    "not show that failure was recognised.",
    LENGTHS: "The classes differ in length; read the score beside what duration alone achieves.",
    BATCHES: "Failures of one batch share their starting pose and length; batches that were held out score far less.",
    PUBLISHED: "The paper scored complete sequences of one selected split; ours are trials never trained on, "
    "in repeated splits.",
}


@dataclass(frozen=True)
class Peer:
    """The best of the other methods on the same folds; the best of several flatters them a little."""

    name: str
    mean: float
    interval: tuple[float, float]  # 95 %


@dataclass(frozen=True)
class Row:
    """One score, with everything that must be read beside it."""

    group: str
    what: str
    paper: str  # as printed; "" = the paper has none
    ours: float
    interval: tuple[float, float] | None  # 95 %
    peer: Peer | None  # None = not measured
    duration: float | None  # what duration alone achieves on the same folds
    flags: tuple[str, ...]  # keys of FLAGS
    source: str  # file that holds the numbers


@dataclass(frozen=True)
class Results:
    """Rows, and the files with the commands that make them."""

    rows: tuple[Row, ...]
    files: tuple[tuple[str, str, str, str], ...]  # name, command, date, machine


def read_results(folder: Path) -> Results:
    """Read every result in a folder.

    Raises:
        InputError: no such folder, or a file that is not a result of an experiment.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected one with the JSON results of the experiments.")
    rows: list[Row] = []
    files = []
    for path in sorted(folder.glob("*.json")):
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            command, date, machine = (str(record.get(k, "not recorded")) for k in ("command", "date", "machine"))
            files.append((path.name, command, date, machine))
            if path.stem in _READERS:
                rows += _READERS[path.stem](record["result"], path.name)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path} is not a result of an experiment ({type(error).__name__}: {error}).") from error
    return Results(tuple(_beside(rows)), tuple(files))


def _table1(result: dict[str, Any], source: str) -> Iterator[Row]:
    for what, row in result["rows"].items():
        outcome = "success/failure" in what
        flags = (SESSIONS, LENGTHS) if outcome else (LENGTHS,)
        low, mean, high = row["target"]["paper"]
        measured = row["measured"]
        best = measured.get("grouped", measured["repeated"])
        kind = "grouped by trial" if "grouped" in measured else "repeated"
        yield Row(
            "Offline, published features", f"{what}, {kind}", f"{mean:.2f} ({low:.2f} to {high:.2f})", best["mean"],
            _pair(best["interval"]), None, None, flags, source,
        )  # fmt: skip


def _table2(result: dict[str, Any], source: str) -> Iterator[Row]:
    for what, row in result["rows"].items():
        if not what.endswith("10 Hz"):
            continue  # the paper's other rates are in the file
        paper = result["paper"].get(what.split()[0], {})
        for measure in ("macro step accuracy", "full-sequence accuracy", "OverallPr"):
            said = paper.get(measure)
            found = row["all"][measure]
            yield Row(
                "Online, states of trials not trained on", f"{what}, {measure}", "" if said is None else f"{said:.2f}",
                found["mean"], _pair(found["interval"]), None, None,
                (PUBLISHED, LENGTHS) if said else (LENGTHS,), source,
            )  # fmt: skip


def _two_arm(result: dict[str, Any], source: str) -> Iterator[Row]:
    for what, row in result.items():
        if isinstance(row, dict):
            yield Row(
                "Two arms, states", f"{what} ({row['trials']} trials)", "", row["words"]["mean"],
                (row["words"]["low"], row["words"]["high"]), None, row["duration alone"]["mean"], (LENGTHS,), source,
            )  # fmt: skip


WORDS = "Words and other methods on the same folds"
# Rows of the experiment "grammar" that stand beside the peers, and what they are called there.
RICHER = {
    "richer words, choice of grammar": "richer words + SVM, without duration and offset",
    "richer words and levels, choice of grammar": "richer words and levels + SVM",
    "all families": "richer words + SVM, all",
}
_PRINTED = {"REAL states": "0.97 (0.93 to 1.00)", "SIM1 states": "0.89 (0.84 to 0.94)", "SIM2 states": "1.00"}


def _peers(result: dict[str, Any], source: str) -> Iterator[Row]:
    """Our words beside the best of the other methods."""
    for benchmark, methods in _by_benchmark(result["rows"]).items():
        flags = (BATCHES, LENGTHS) if benchmark == "failure types" else (LENGTHS,)
        others = {name: row["accuracy"] for name, row in methods.items() if row["kind"] == "peer"}
        best = max(others, key=lambda name: others[name]["mean"], default=None)
        peer = None if best is None else Peer(best, others[best]["mean"], _limits(others[best]))
        alone = methods.get("duration alone")
        for name, row in methods.items():
            if row["kind"] == "ours":
                yield Row(
                    WORDS, f"{benchmark}: {name}", _PRINTED.get(benchmark, ""),
                    row["accuracy"]["mean"], _limits(row["accuracy"]), peer,
                    None if alone is None else alone["accuracy"]["mean"], flags, source,
                )  # fmt: skip


def _grammar(result: dict[str, Any], source: str) -> Iterator[Row]:
    """Richer words on the folds of the peers, which ``_beside`` adds."""
    for benchmark, methods in _by_benchmark(result["rows"]).items():
        flags = (BATCHES, LENGTHS) if benchmark.startswith("failure types") else (LENGTHS,)
        alone = methods.get("duration alone")
        for name, title in RICHER.items():
            if name in methods:
                found = methods[name]["accuracy"]
                yield Row(
                    WORDS, f"{benchmark}: {title}", _PRINTED.get(benchmark, ""), found["mean"], _limits(found), None,
                    None if alone is None else alone["accuracy"]["mean"], flags, source,
                )  # fmt: skip


def _beside(rows: list[Row]) -> list[Row]:
    """Rows on the same folds next to each other, all with the best of the other methods."""
    words = [row for row in rows if row.group == WORDS]
    best = {_benchmark(row): row.peer for row in words if row.peer is not None}
    order = list(dict.fromkeys([*best, *map(_benchmark, words)]))
    words.sort(key=lambda row: order.index(_benchmark(row)))
    together = [row if row.peer is not None else replace(row, peer=best.get(_benchmark(row))) for row in words]
    return together + [row for row in rows if row.group != WORDS]


def _benchmark(row: Row) -> str:
    return row.what.split(": ")[0]


def _table1_ours(result: dict[str, Any], source: str) -> Iterator[Row]:
    """Our words for every set and kind of labels; the other protocols are in the file."""
    for name, row in result["rows"].items():
        what, labels = name.split(" | ")
        sessions = what == "REAL success/failure"
        found = row["words, nested, grouped"]["accuracy"]
        paper = "" if row["paper"] is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*row["paper"])
        yield Row(
            "Words, Table I of the paper on our labels", f"{what}, {labels} labels", paper, found["mean"],
            _limits(found), None, row["duration alone"]["accuracy"]["mean"],
            (SESSIONS, LENGTHS) if sessions else (LENGTHS,), source,
        )  # fmt: skip


def _probes(result: dict[str, Any], source: str) -> Iterator[Row]:
    """Words beside what cannot know the outcome, as balanced accuracy."""
    for question, views in _by_benchmark(result["rows"]).items():
        ours = next((row for view, row in views.items() if view.startswith("words")), None)
        first, alone = views.get("first second alone"), views.get("duration alone")
        if ours is None or first is None or alone is None:
            continue
        found, probe = ours["balanced_accuracy"], first["balanced_accuracy"]
        yield Row(
            "Success, failure and session: words beside the first second alone, balanced accuracy", question, "",
            found["mean"], _limits(found), Peer("first second alone", probe["mean"], _limits(probe)),
            alone["balanced_accuracy"]["mean"], (SESSIONS, LENGTHS), source,
        )  # fmt: skip


def _sim_to_real(result: dict[str, Any], source: str) -> Iterator[Row]:
    """What learners that saw simulated trials only say of recorded ones."""
    rows = {name.partition(" | ")[2]: row for name, row in result["rows"].items() if name.startswith(("main", "base"))}
    raw, alone = rows.get("statistics of the raw wrench, random forest"), rows.get("duration alone")
    for name in [key for key, row in rows.items() if row not in (raw, alone)]:
        for states in ("merged", "harmonised"):
            found = rows[name][states]["A+B"]
            same = name == "all presets"  # only there the others were trained on the same trials
            peer = None if raw is None or not same else raw[states]["A+B"]
            yield Row(
                "Simulation only, tested on recorded trials", f"{name}, {states} states", "", found["accuracy"],
                _pair(found["interval"]),
                None if peer is None else Peer("raw statistics + forest", peer["accuracy"], _pair(peer["interval"])),
                None if alone is None or not same else alone[states]["A+B"]["accuracy"], (LENGTHS,), source,
            )  # fmt: skip


def _by_benchmark(rows: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Rows called "benchmark | method" as benchmark -> method -> row."""
    out: dict[str, dict[str, Any]] = {}
    for name, row in rows.items():
        benchmark, method = name.split(" | ")
        out.setdefault(benchmark, {})[method] = row
    return out


def _limits(score: dict[str, float]) -> tuple[float, float]:
    return float(score["low"]), float(score["high"])


def _pair(values: list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


_READERS: dict[str, Callable[[dict[str, Any], str], Iterator[Row]]] = {
    "grammar": _grammar,
    "peers": _peers,
    "probes": _probes,
    "sim_to_real": _sim_to_real,
    "table1_ours": _table1_ours,
    "table1_published": _table1,
    "table2": _table2,
    "two_arm_states": _two_arm,
}


def cells(row: Row) -> tuple[str, str, str, str, str, str]:
    """A row as printed: what, paper, ours, interval, best peer, duration alone."""
    interval = "" if row.interval is None else _written(row.interval)
    alone = "" if row.duration is None else f"{row.duration:.3f}"
    peer = "" if row.peer is None else f"{row.peer.mean:.3f} ({_written(row.peer.interval)}) {row.peer.name}"
    return row.what, row.paper, f"{row.ours:.3f}", interval, peer, alone


def _written(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3f} to {interval[1]:.3f}"
