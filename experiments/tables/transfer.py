"""Tables from simulation to recorded trials."""

from __future__ import annotations

from typing import Any

from experiments._lib.peer_rows import result
from experiments.tables.cells import markdown


def sim_to_real(way: str) -> str:
    """States of recorded trials by learners that saw simulated ones only."""
    return _transfers(("main", "baseline", "one preset"))


def sim_to_real_choices(way: str) -> str:
    """What each choice does to it."""
    some = ("randomisation", "mating", "sensor", "amount", "features", "features, without A and B", "window", "tare")
    return _transfers(some)


def sim_to_real_thresholds(way: str) -> str:
    """Thresholds calibrated on simulated trials only."""
    return _transfers(("thresholds", "thresholds, without A and B"))


def _transfers(groups: tuple[str, ...]) -> str:
    rows = _worst_draws(result("sim_to_real")["rows"])
    lines = []
    for name in [name for group in groups for name in rows if name.split(" | ")[0] == group]:
        scores = [rows[name][states][on] for states in ("merged", "harmonised") for on in ("A", "B", "A+B")]
        said = [f"{score['accuracy']:.3f}" for score in scores]
        for place in (2, 5):
            low, high = scores[place]["interval"]
            said[place] += f" ({low:.3f} to {high:.3f})"
        lines.append((name.replace(" | ", ": "), str(rows[name]["merged"]["trials"]), *said))
    head = ("", "training trials", *(f"{n} states, {on}" for n in (3, 4) for on in ("A", "B", "both")))
    return markdown(head, lines)


def _worst_draws(rows: dict[str, Any]) -> dict[str, Any]:
    """Rows with scores on both sessions; of several draws of training trials the one that is worst at four states."""
    groups: dict[str, list[Any]] = {}
    for name, row in rows.items():
        if "A+B" in row.get("merged", {}):
            title, _, drawn = name.partition(", draw")
            groups.setdefault(f"{title}, worst draw" if drawn else title, []).append(row)
    return {name: min(found, key=lambda row: row["harmonised"]["A+B"]["accuracy"]) for name, found in groups.items()}


TABLES = {
    "sim-to-real": sim_to_real,
    "sim-to-real-choices": sim_to_real_choices,
    "sim-to-real-thresholds": sim_to_real_thresholds,
}
