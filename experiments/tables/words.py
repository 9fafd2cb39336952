"""Tables of how well and how soon words describe the signal."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import markdown, table

LAYERS = {"primitive": "primitives", "mc": "compositions", "llb": "behaviours"}


@table("fit-lines", "fit_quality")
def lines(result: dict[str, Any]) -> str:
    """R2 of the lines of primitives by axis, and words for each recording."""
    axes = next(iter(result["sets"].values()))["axes"]
    rows = [
        (name, rule, *(f"{value:.4f}" for value in row["r2"]), f"{row['all_words']['primitive']:.0f}")
        for name, found in result["sets"].items()
        for rule, row in found["rows"].items()
    ]
    return markdown(("", "rule", *axes, "primitives"), rows)


@table("fit-words", "fit_quality")
def words(result: dict[str, Any]) -> str:
    """Primitives for each recording by axis, and the least share of the approach that is constant."""
    axes = next(iter(result["sets"].values()))["axes"]
    rows = [
        (name, rule, *(f"{value:.0f}" for value in row["words"]), f"{min(row['approach_constant']):.3f}")
        for name, found in result["sets"].items()
        for rule, row in found["rows"].items()
    ]
    return markdown(("", "rule", *axes, "share of the approach that is constant, worst axis"), rows)


@table("fit-latency", "fit_quality")
def latency(result: dict[str, Any]) -> str:
    """Median, 95th percentile and largest latency of every layer, s."""
    rows = [
        (name, rule, *(" / ".join(f"{value:.2f}" for value in row["latency"][layer].values()) for layer in LAYERS))
        for name, found in result["sets"].items()
        for rule, row in found["rows"].items()
        if rule in ("paper", "fit x1", "fit x1, W=2")
    ]
    return markdown(("", "rule", *LAYERS.values()), rows)
