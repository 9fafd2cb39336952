"""Tables of calibrated thresholds."""

from __future__ import annotations

from experiments.compared import result
from experiments.tables.cells import NONE, markdown, score


def calibration(way: str) -> str:
    """Thresholds by each method, words alone; the best of a line in bold."""
    found = result("calibration")
    methods = {
        "preset": "preset", "context": "context", "search, best": "search, best",
        "search, inner folds choose among 6 and the preset": "search, inner folds choose", "gradient": "gradient",
    }  # fmt: skip
    transfers, failures = found["real-transfer"], found["failure-type"]
    rows = {
        "SIM1 states, 3 x 5 folds": found["sim1"],
        "REAL A -> B, harmonised": transfers["A -> B, harmonised"],
        "REAL B -> A, harmonised": transfers["B -> A, harmonised"],
        "SIM1 -> REAL, merged": found["sim1-to-real"]["SIM1 -> A+B, merged"],
        f"failure type, {len(failures['classes'])} classes, 5 folds": failures,
    }
    lines = []
    for title, row in rows.items():
        said = [row[key]["words"]["accuracy"]["mean"] if key in row else None for key in methods]
        best = max(value for value in said if value is not None)
        lines.append((title, *(_bold(value, value == best) for value in said)))
    return markdown(("", *methods.values()), lines)


def calibration_near(way: str) -> str:
    """Thresholds near the preset: chosen, shrunk, averaged."""
    rows = result("calibration_near")["rows"]
    sets = ("SIM1", "REAL A -> B", "REAL B -> A")
    methods = list(dict.fromkeys(name.split(" | ")[1] for name in rows))
    lines = [(method, *(score(rows.get(f"{of} | {method}", {}).get("accuracy")) for of in sets)) for method in methods]
    return markdown(("", *sets), lines)


def calibration_simulated(way: str) -> str:
    """Thresholds chosen on simulated failures: on other simulated ones, and on the authors'."""
    there, here = result("calibration_device_warp_failure_type")["svm"], result("calibration_transfer")["rows"]
    named = {"preset": "preset", "search": "simulated, search", "gradient": "simulated, gradient"}
    lines = [
        (
            name,
            score(there[own]),
            *(score(here[f"{name} | {scaled}"]["accuracy"]) for scaled in ("ranks", "deviation")),
        )
        for own, name in named.items()
    ]
    lines.append(("duration alone", score(there["duration alone"]), score(here["duration alone"]["accuracy"]), NONE))
    return markdown(("", "held-out simulated trials", "the authors' failures, ranks", "deviation"), lines)


def _bold(value: float | None, best: bool) -> str:
    if value is None:
        return "not run"
    return f"**{value:.3f}**" if best else f"{value:.3f}"


TABLES = {
    "calibration": calibration,
    "calibration-near": calibration_near,
    "calibration-simulated": calibration_simulated,
}
