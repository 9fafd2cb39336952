"""Tables of recordings of other laboratories."""

from __future__ import annotations

from typing import Any

from experiments.figures.early import SETS
from experiments.tables.cells import NONE, Lines, score, table

SCORES = {
    "accuracy": "accuracy", "macro_f1": "macro F1", "f1@10": "F1@10", "f1@25": "F1@25", "f1@50": "F1@50",
    "edit": "edit", "covering": "covering",
}  # fmt: skip


@table("external-failures", "external_failures")
def failures(result: dict[str, Any]) -> Lines:
    """Accuracy of the one method, its members and peers."""
    rows = result["rows"]
    titles = dict.fromkeys(name.split(" | ")[1] for name in rows)
    yield ("accuracy", *SETS.values())
    for title in titles:
        yield [title, *(score(rows.get(f"{of} | {title}", {}).get("accuracy")) for of in SETS)]


@table("external-first", "external_early")
def first(result: dict[str, Any]) -> Lines:
    """Accuracy after the first samples of a series."""
    rows = result["rows"]
    yield ("samples", *SETS.values())
    for count in result["prefixes"]:
        cells = [rows.get(f"{of} | first {count} samples", {}).get("accuracy") for of in SETS]
        yield [str(count), *map(score, cells)]


@table("external-early", "external_early")
def early(result: dict[str, Any]) -> Lines:
    """Accuracy, earliness and harmonic mean of the rules that stop."""
    rows = result["rows"]
    titles = dict.fromkeys(name.split(" | ")[1] for name in rows if not name.split(" | ")[1].startswith("first "))
    yield "", "accuracy", "earliness", "harmonic mean"
    for of, name in SETS.items():
        for title in titles:
            row = rows.get(f"{of} | {title}", {})
            yield (f"{name}: {title}", *(score(row.get(key)) for key in ("accuracy", "earliness", "harmonic_mean")))


@table("external-caps", "external_caps")
def caps(result: dict[str, Any]) -> Lines:
    """Scores of the segmentation of caps."""
    rows = result["rows"]
    yield ("", *SCORES.values())
    for name, row in rows.items():
        yield [name, *(score({"mean": row["score"][key], "interval": row["interval"][key]}) for key in SCORES)]
    yield ["*most frequent class*", f"{rows['causal']['majority']:.3f}", *[NONE] * (len(SCORES) - 1)]


@table("external-kitting", "kitting", "kitting_more")
def kitting(result: dict[str, Any], more: dict[str, Any]) -> Lines:
    """AUROC of each skill, false alarms, detections and delay of monitors trained on nominal executions only."""
    named = {
        f"{channels}: {name}": row for channels, methods in result["rows"].items() for name, row in methods.items()
    }
    head = (*(f"skill {number}" for number in (3, 4, 5, 7)), "false alarms", "detected", "slowest median delay, s")
    yield ("AUROC", *head)
    for title, row in (named | {name: row for name, row in more["rows"].items() if "skills" in row}).items():
        skills = row["skills"].values()
        late = [cell["delay_median"] for cell in skills if cell["delay_median"] is not None]
        values = [score({"mean": cell["auroc"], "interval": cell["auroc_interval"]}) for cell in skills]
        shares = (score(row["alarms"][kind]) for kind in ("nominal", "anomalous"))
        yield (title, *values, *shares, f"{max(late):.2f}")


@table("external-kitting-types", "kitting_more")
def kitting_types(result: dict[str, Any]) -> Lines:
    """Accuracy of the types of anomalies."""
    yield "", "", "accuracy", "balanced accuracy", "executions"
    for name, row in result["rows"].items():
        if " | " in name:
            of, title = name.split(" | ")
            yield of, title, score(row["accuracy"]), score(row["balanced_accuracy"]), str(row["executions"])
