"""Tables from simulation to recorded trials."""

from __future__ import annotations

from functools import partial
from typing import Any

from experiments.figures.sim_to_real import TITLES_OF_ROWS
from experiments.tables.cells import Lines, score, table

BOUNDARIES = ("merged", "harmonised")  # three states, four states
Result = dict[str, Any]


def _transfers(result: Result, groups: tuple[str, ...]) -> Lines:
    """States of recorded trials by classifiers trained on simulated ones only: some groups of rows."""
    rows = _by_draw(result["rows"])
    yield ("", "training trials", *(f"{n} states, {on}" for n in (3, 4) for on in ("A", "B", "both")))
    for name in [name for group in groups for name in rows if name.split(" | ")[0] == group]:
        draws = rows[name]
        worst = {key: min((row[key] for row in draws), key=lambda one: one["A+B"]["accuracy"]) for key in BOUNDARIES}
        cells = [score(worst[key][on]) for key in BOUNDARIES for on in ("A", "B", "A+B")]
        title = TITLES_OF_ROWS.get(name, name.replace(" | ", ": "))
        yield (title, str(draws[0]["merged"]["trials"]), *cells)


@table("simulated-draws", "simulated_draws")
def simulated_draws(result: dict[str, Any]) -> Lines:
    """Scores on recorded trials of learners that saw one draw of the simulated trials each."""
    names = dict.fromkeys(name.split(" | ")[0] for name in result["rows"])
    draws = dict.fromkeys(name.split(" | ")[1] for name in result["rows"])
    yield ("learner", "states", *draws)
    for name in names:
        for states in result["rows"][f"{name} | {next(iter(draws))}"]:
            accuracies = (result["rows"][f"{name} | {draw}"][states] for draw in draws)
            title = "frozen method, zero shot" if name == "zero shot" else f"words alone: {name}"
            yield (title, states, *(f"{one:.3f}" for one in accuracies))


@table("zero-shot", "zero_shot")
def zero_shot(result: Result) -> Lines:
    """States of recorded trials by simulated ones that were fitted to none of them."""
    yield "", "by", "training trials", "A", "B", "both"
    for name, row in result["rows"].items():
        yield (*name.split(" | "), str(row["training trials"]), *(score(row[on]) for on in ("A", "B", "A+B")))


CHOICES = ("randomisation", "mating", "sensor", "amount", "features", "features, without A and B", "window", "tare")
GROUPS = {
    "sim-to-real": ("main", "baseline", "one preset"),
    "sim-to-real-choices": CHOICES,
    "sim-to-real-thresholds": ("thresholds", "thresholds, without A and B"),
}
for _name, _groups in GROUPS.items():
    table(_name, "sim_to_real")(partial(_transfers, groups=_groups))


def _by_draw(rows: dict[str, Any]) -> dict[str, list[Any]]:
    """Rows with scores on both sessions, and several draws of the training trials together."""
    groups: dict[str, list[Any]] = {}
    for name, row in rows.items():
        if "A+B" in row["merged"]:
            title, _, drawn = name.partition(", draw")
            groups.setdefault(f"{title}, worst draw" if drawn else title, []).append(row)
    return groups
