"""Tables of calibrated thresholds."""

from __future__ import annotations

import statistics

from experiments._lib.peer_rows import result
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


def calibration_bank(way: str) -> str:
    """Kernels of many thresholds and windows: one chosen, several averaged."""
    rows = result("calibration_bank")["rows"]
    sets = ("REAL A -> B", "REAL B -> A")
    lines = []
    for spec, method in dict.fromkeys(tuple(name.split(" | ")[::2]) for name in rows):
        here = rows[f"{spec} | SIM1 | {method}"]
        gain = NONE
        if method != "preset":
            gain = f"{here['gain']['mean']:+.3f} ({here['gain']['low']:+.3f} to {here['gain']['high']:+.3f})"
        there = [score(rows[f"{spec} | {of} | {method}"]["accuracy"]) for of in sets]
        lines.append((f"{spec}: {method}", score(here["accuracy"]), gain, *there))
    return markdown(("", "SIM1", "gain over the preset", *sets), lines)


def calibration_time(way: str) -> str:
    """Objective over processor seconds on the seeds that all methods have; what training does to held-out trials."""
    rows = result("calibration_curves")["rows"]
    methods = {
        "random": "random", "halving": "halving, then CMA-ES", "optuna": "Optuna's TPE, NumPy, one at a time",
        "gradient of the fit": "gradient of `fit`", "gradient": "gradient of a classifier's loss",
    }  # fmt: skip
    made = {m: [row for name, row in rows.items() if name.split(" | ")[0] == m] for m in methods}
    common = min(len(seeds) for seeds in made.values())
    lines = []
    for method, title in methods.items():
        curves = [row["curve (seconds, objective, held-out accuracy, held-out log-loss)"] for row in made[method]]
        best = statistics.median(curve[-1][1] for curve in curves[:common])
        taken = statistics.median(curve[-1][0] for curve in curves[:common])
        trained = [row.get("held-out training loss, first and last", ()) for row in made[method]]
        ends = [row.get("held-out accuracy and log-loss at the end", (0, 0))[1] for row in made[method]]
        own = _share([loss[1] < loss[0] for loss in trained if loss])
        hard = _share([end < c[0][3] for end, c, loss in zip(ends, curves, trained, strict=True) if loss])
        lines.append((title, f"{made[method][0]['evaluations']}", f"{best:.2f}", f"{taken:.1f} s", own, hard))
    head = (
        "",
        "evaluations",
        "best objective",
        "found after",
        "own held-out loss falls",
        "log-loss of hard labels falls",
    )
    return markdown(head, lines)


def _share(true: list[bool]) -> str:
    return f"{sum(true)} of {len(true)}" if true else NONE


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
    "calibration-bank": calibration_bank,
    "calibration-time": calibration_time,
    "calibration-simulated": calibration_simulated,
}
