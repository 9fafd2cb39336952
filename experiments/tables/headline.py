"""The README's table, and streamed states with beginnings given and detected."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from experiments._lib.headline_rows import MEASURE, SHORT_LIST, SOURCES, HeadlineRow, headline_rows
from experiments.tables.cells import NONE, Lines, score, table

Result = dict[str, Any]
SHORT = 12  # digits of a digest that are shown


@table("results", *SOURCES, links=True)
def short_results(*sources: Result, way: str) -> Lines:
    """The frozen method on the benchmarks of the README."""
    rows = {(row.source, row.name): row for row in headline_rows(*sources)}
    return _results([rows[key] for key in SHORT_LIST], way)


@table("all-results", *SOURCES, links=True)
def all_results(*sources: Result, way: str) -> Lines:
    """The frozen method on every benchmark."""
    return _results(headline_rows(*sources), way)


def _results(rows: Iterable[HeadlineRow], way: str) -> Lines:
    """Each row carries the digest of the method that made it."""
    head = ("accuracy", "paper", "frozen method, 95 % interval", "words without absolute level", "duration alone")
    yield (*head, "best other method", "made by")
    for row in rows:
        seen = "" if row.allowed is None else f"; none wrong of {row.tested}, at most {row.allowed:.1%}"
        if row.draws is not None:
            seen += "; {:.3f} to {:.3f} with other simulated trials".format(*row.draws)
        name, peer = row.peer
        others = (score(row.relative, False), score(row.duration, False), f"{score(peer, False)} {name}")
        link = f"[{row.method[:SHORT]}]({way}{row.source}.json)"
        yield (row.title, row.paper or NONE, f"**{score(row.score)}**{seen}", *others, link)


@table("causal", "causal")
@table("causal-simulated", "zero_shot_stream")
def causal(result: Result) -> Lines:
    """Step accuracy with beginnings given and detected, beside simple baselines."""
    sets = {name: row for name, row in result["rows"].items() if "trials tested" in row}
    names = [name for name in next(iter(sets.values())) if " | " in name]
    yield ("beginnings", "step accuracy (mean of classes)", *sets)
    for how in ("given", "detected"):
        for name in names:
            if name.startswith(how):
                yield (how, name.split(" | ")[1], *(score(row[name][MEASURE]) for row in sets.values()))


@table("time-known", "causal")
def time_known(result: Result) -> Lines:
    """How well relative features predict the time since a sub-task began."""
    rows = {name.split(", ")[1]: row for name, row in result["rows"].items() if name.startswith("time known")}
    states = list(next(iter(rows.values())))
    yield ("within-class R² of log elapsed time", *states)
    for name, row in rows.items():
        yield (name, *(score(row[state]) for state in states))


@table("failure-calibration", "failure_calibration")
def failure_calibration(result: Result) -> Lines:
    """Calibration error of streamed types of failure by quarter of the record: the likeliest, the worst type."""
    quarters = [f"quarter {number}" for number in range(1, 5)]
    yield ("", "beliefs", "pooled", *quarters)
    for name, kinds in result["rows"].items():
        for kind, row in kinds.items():
            errors = ("likeliest", "worst class")
            cells = [" / ".join(_with_ends(row[part], each) for each in errors) for part in quarters]
            yield (name, kind, _with_ends(row, "pooled"), *cells)


def _with_ends(row: Result, name: str) -> str:
    return score({"mean": row[name], "interval": row[f"{name} interval"]})
