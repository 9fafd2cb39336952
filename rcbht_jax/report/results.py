"""Rows of the results table, read from the committed JSON files of the experiments; nothing is typed in by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcbht_jax.errors import InputError

SESSIONS = "sessions"  # classes were recorded in different sessions
LENGTHS = "lengths"  # classes differ in duration
PUBLISHED = "published"  # what the paper measured is not what the words say

FLAGS = {
    SESSIONS: "The classes were recorded in different sessions, which are told apart before contact: the score does "
    "not show that failure was recognised.",
    LENGTHS: "The classes differ in length; read the score beside what duration alone achieves.",
    PUBLISHED: "The paper scored complete sequences of one selected split; ours are trials never trained on, "
    "in repeated splits.",
}


@dataclass(frozen=True)
class Row:
    """One score, with everything that must be read beside it."""

    group: str
    what: str
    paper: str  # as printed; "" = the paper has none
    ours: float
    interval: tuple[float, float] | None  # 95 %
    peer: str  # best of the other methods on the same folds; "" = not measured
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
    return Results(tuple(rows), tuple(files))


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
            _pair(best["interval"]), "", None, flags, source,
        )  # fmt: skip


def _table2(result: dict[str, Any], source: str) -> Iterator[Row]:
    for what, row in result["rows"].items():
        paper = result["paper"].get(what.split()[0], {}) if what.endswith("10 Hz") else {}
        for measure in ("macro step accuracy", "full-sequence accuracy", "OverallPr"):
            said = paper.get(measure)
            found = row["all"][measure]
            yield Row(
                "Online, states of trials not trained on", f"{what}, {measure}", "" if said is None else f"{said:.2f}",
                found["mean"], _pair(found["interval"]), "", None, (PUBLISHED, LENGTHS) if said else (LENGTHS,), source,
            )  # fmt: skip


def _two_arm(result: dict[str, Any], source: str) -> Iterator[Row]:
    for what, row in result.items():
        if isinstance(row, dict):
            yield Row(
                "Two arms, states", f"{what} ({row['trials']} trials)", "", row["words"], None, "",
                row["duration alone"], (LENGTHS,), source,
            )  # fmt: skip


def _pair(values: list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


_READERS: dict[str, Callable[[dict[str, Any], str], Iterator[Row]]] = {
    "table1_published": _table1,
    "table2": _table2,
    "two_arm_states": _two_arm,
}


def cells(row: Row) -> tuple[str, str, str, str, str, str]:
    """A row as printed: what, paper, ours, interval, best peer, duration alone."""
    interval = "" if row.interval is None else f"{row.interval[0]:.3f} to {row.interval[1]:.3f}"
    alone = "" if row.duration is None else f"{row.duration:.3f}"
    return row.what, row.paper, f"{row.ours:.3f}", interval, row.peer, alone
