"""The peers' rows with those of richer words between them, from two results on the same folds."""

from __future__ import annotations

import json
from typing import Any

from experiments._lib.results_io import COMMITTED
from rcbht_jax.report.results import RICHER


def result(name: str) -> Any:
    """A committed result, without what says how it was made."""
    return json.loads((COMMITTED / f"{name}.json").read_text(encoding="utf-8"))["result"]


def compared() -> dict[str, dict[str, Any]]:
    """Benchmark -> method -> row with its kind: "peer", "ours" or "probe"."""
    peers = result("peers")
    richer = result("grammar")["rows"] if (COMMITTED / "grammar.json").is_file() else {}
    out: dict[str, dict[str, Any]] = {benchmark: {} for benchmark in peers["benchmarks"]}
    for name, row in peers["rows"].items():
        benchmark, method = name.split(" | ")
        out[benchmark][method] = row
    for benchmark, rows in out.items():
        for method, title in RICHER.items():
            if row := richer.get(f"{benchmark} | {method}"):
                rows[title] = {"kind": "ours", **row}
    return out
