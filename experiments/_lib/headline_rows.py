"""The rows of the headline: the frozen method on every benchmark, and what a simpler or another method reaches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from experiments._lib.scores import by_benchmark
from rcbht_jax.learning.metrics import rule_of_three

Record = dict[str, Any]
MEASURE = "macro step accuracy"  # of streamed states
DETECTED = "detected | "
ELAPSED, FOREST = f"{DETECTED}elapsed time", f"{DETECTED}last 0.1 s and elapsed time, forest"

# Benchmark of headline.json -> what it is called, what the paper prints, flags of the report.
OFFLINE = {
    "REAL states": ("states, real trials", "0.97 (0.93 to 1.00)", ("lengths",)),
    "SIM1 states": ("states, the authors' simulated trials", "0.89 (0.84 to 0.94)", ("lengths",)),
    "REAL success or failure": (
        "success or failure, real trials (confounded: other sessions)", "0.97 (0.83 to 1.00)", ("sessions", "lengths")
    ),
    "REAL success or failure, session held out": (
        "the same, the tested session's successes never seen (still confounded)", "", ("sessions", "lengths")
    ),
    "REAL merged states, A to B": ("three states, session A to session B", "", ("lengths",)),
    "REAL merged states, B to A": ("three states, session B to session A", "", ("lengths",)),
    "REAL states, A to B": ("four states, session A to session B", "", ("lengths",)),
    "REAL states, B to A": ("four states, session B to session A", "", ("lengths",)),
    "failure types": (
        "13 failure types of the authors' simulation (confounded: the approach differs)", "",
        ("approach", "batches", "lengths")
    ),
    "failure types, other batch (at rest to loaded)": (
        "failure types of the batch not trained on (loaded; still confounded)", "", ("approach", "batches", "lengths")
    ),
    "failure types, other batch (loaded to at rest)": (
        "failure types of the batch not trained on (at rest; still confounded)", "", ("approach", "batches", "lengths")
    ),
}  # fmt: skip
# Benchmark of headline.json -> the way of types_across.json, whose other methods see the trials that touch.
ACROSS = {
    "failure types, other batch (at rest to loaded)": "begins at rest to begins loaded",
    "failure types, other batch (loaded to at rest)": "begins loaded to begins at rest",
}
SEEN = {"trees on the wrench from contact on": "other batch", "trees on the approach alone": "approach alone"}
# Row of causal.json -> what it is called.
STREAMED = {
    "REAL": "states, real trials, streamed, beginnings not given",
    "A to B": "the same, session A to session B",
    "B to A": "the same, session B to session A",
    "SIM1": "states, the authors' simulated trials, streamed, beginnings not given",
}
# Row of zero_shot_stream.json -> what it is called.
STREAMED_SIMULATED = {
    "simulated to A and B": "states, real trials, tared, streamed, beginnings not given, zero shot",
    "A alone to B": "states, tared, streamed, trained on session A alone, tested on B",
    "B alone to A": "states, tared, streamed, trained on session B alone, tested on A",
    "simulated and A to B": "states, tared, streamed, trained on session A and simulated trials, tested on B",
    "simulated and B to A": "states, tared, streamed, trained on session B and simulated trials, tested on A",
}
# Boundaries of zero_shot.json -> what it is called.
ZERO_SHOT = {
    "three states": "three states, real trials, zero shot: simulated trials, part and sensor fitted to none of them",
    "four states": "four states, real trials, zero shot",
}
# Rows of the README by source and name: the causal ones first, then the paper's, then the hardest.
SHORT_LIST = (
    ("causal", "REAL"), ("causal", "A to B"), ("causal", "B to A"), ("headline", "REAL states"),
    ("headline", "SIM1 states"), ("headline", "REAL success or failure"), ("zero_shot", "four states"),
    ("headline", "failure types"), ("headline", "failure types, other batch (at rest to loaded)"),
    ("headline", "failure types, other batch (loaded to at rest)"),
)  # fmt: skip


@dataclass(frozen=True)
class HeadlineRow:
    """One score of the frozen method; scores are records with ``mean``, ``low`` and ``high``."""

    name: str  # in the source
    title: str
    paper: str  # as printed; "" = the paper has none
    score: Record
    relative: Record  # of the method without what an offset or a duration changes
    duration: Record  # of the duration, or of the time that has passed, alone
    peer: tuple[str, Record]  # the best of the other methods
    allowed: float | None  # share of trials with a mistake that none seen allows; None = one was seen
    tested: int  # trials
    method: str  # SHA-256
    flags: tuple[str, ...]
    source: str
    draws: tuple[float, float] | None = None  # lowest and highest score with other simulated trials to learn from


SOURCES = (  # results that the rows come from
    "headline", "zero_shot", "causal", "zero_shot_stream", "peers", "simulated_draws", "types_across",
)  # fmt: skip


def headline_rows(
    headline: Record, zero_shot: Record, causal: Record, simulated: Record, peers: Record, draws: Record, across: Record
) -> Iterator[HeadlineRow]:
    """All rows: benchmarks, zero shot, streams."""
    yield from _offline(headline, peers, across)
    yield from _zero_shot(zero_shot, draws)
    yield from _streamed(causal, STREAMED, "causal")
    yield from _streamed(simulated, STREAMED_SIMULATED, "zero_shot_stream")


def _offline(headline: Record, peers: Record, across: Record) -> Iterator[HeadlineRow]:
    measured = by_benchmark(peers["rows"])
    for name, (title, paper, flags) in OFFLINE.items():
        rows = {what: headline["rows"][f"{name} | {what}"] for what in ("frozen", "frozen, relative")}
        others = {"statistics + random forest": headline["rows"][f"{name} | statistics + random forest"]["score"]}
        others |= {
            method: row["accuracy"]
            for method, row in measured.get(name, {}).items()
            if row["kind"] == "peer" and method not in others
        }
        if name in ACROSS:
            others |= {what: across["rows"][f"{ACROSS[name]} | {row}"]["score"] for what, row in SEEN.items()}
        best = max(others, key=lambda method: others[method]["mean"])
        yield HeadlineRow(
            name, title, paper, rows["frozen"]["score"], rows["frozen, relative"]["score"],
            headline["rows"][f"{name} | duration alone"]["score"], (best, others[best]),
            rows["frozen"].get("trials with a mistake, at most"), rows["frozen"]["trials tested"],
            rows["frozen"]["method"], flags, "headline",
        )  # fmt: skip


def _zero_shot(result: Record, draws: Record) -> Iterator[HeadlineRow]:
    both = "A+B"
    for name, title in ZERO_SHOT.items():
        rows = {what.split(" | ")[1]: row for what, row in result["rows"].items() if what.startswith(f"{name} | ")}
        mine, other = rows["frozen"], "statistics + random forest"
        tested = mine[both]["trials"]
        drawn = [row[name] for what, row in draws["rows"].items() if what.startswith("zero shot | ")]
        yield HeadlineRow(
            name, title, "", mine[both], rows["frozen, relative"][both], rows["duration alone"][both],
            (other, rows[other][both]), None if mine["wrong"] else rule_of_three(tested), tested, mine["method"],
            ("lengths",), "zero_shot", (min(drawn), max(drawn)),
        )  # fmt: skip


def _streamed(result: Record, titles: dict[str, str], source: str) -> Iterator[HeadlineRow]:
    for name, title in titles.items():
        row, belief = result["rows"][name], result["belief of the method"]
        yield HeadlineRow(
            name, title, "", row[f"{DETECTED}frozen, {belief}"][MEASURE],
            row[f"{DETECTED}frozen, relative, {belief}"][MEASURE],
            row[ELAPSED][MEASURE], ("last 0.1 s and elapsed time, forest", row[FOREST][MEASURE]),
            None, row["trials tested"], row["method"], ("lengths",), source,
        )  # fmt: skip
