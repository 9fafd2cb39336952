"""Tables of calibrated thresholds."""

from __future__ import annotations

import statistics
from typing import Any

from experiments.tables.cells import NONE, Lines, score, table


@table("calibration", "calibration")
def calibration(result: dict[str, Any]) -> Lines:
    """Thresholds by each method, words alone; the best of a line in bold."""
    methods = {
        "preset": "preset", "context": "context", "search, best": "search, best",
        "search, inner folds choose among 6 and the preset": "search, inner folds choose", "gradient": "gradient",
    }  # fmt: skip
    transfers, failures = result["real-transfer"], result["failure-type"]
    rows = {
        "SIM1 states, 3 x 5 folds": result["sim1"],
        "REAL A -> B, harmonised": transfers["A -> B, harmonised"],
        "REAL B -> A, harmonised": transfers["B -> A, harmonised"],
        "SIM1 -> REAL, merged": result["sim1-to-real"]["SIM1 -> A+B, merged"],
        f"failure type, {len(failures['classes'])} classes, 5 folds": failures,
    }
    yield ("", *methods.values())
    for title, row in rows.items():
        found = {key: row[key]["words"]["accuracy"] for key in methods if key in row}
        best = max(value["mean"] for value in found.values())
        cells = {key: score(value) for key, value in found.items()}
        cells = {key: f"**{cell}**" if found[key]["mean"] == best else cell for key, cell in cells.items()}
        yield (title, *(cells.get(key, "not run") for key in methods))


@table("calibration-near", "calibration_near")
def calibration_near(result: dict[str, Any]) -> Lines:
    """Thresholds near the preset: chosen, shrunk, averaged."""
    rows = result["rows"]
    sets = ("SIM1", "REAL A -> B", "REAL B -> A")
    methods = list(dict.fromkeys(name.split(" | ")[1] for name in rows))
    yield ("", *sets)
    for method in methods:
        yield (method, *(score(rows[f"{of} | {method}"]["accuracy"]) for of in sets))


@table("calibration-bank", "calibration_bank")
def calibration_bank(result: dict[str, Any]) -> Lines:
    """Kernels of many thresholds and windows: one chosen, several averaged."""
    rows = result["rows"]
    sets = ("REAL A -> B", "REAL B -> A")
    yield ("", "SIM1", "gain over the preset", *sets)
    for spec, method in dict.fromkeys(tuple(name.split(" | ")[::2]) for name in rows):
        here = rows[f"{spec} | SIM1 | {method}"]
        gain = NONE
        if method != "preset":
            gain = f"{here['gain']['mean']:+.3f} ({here['gain']['low']:+.3f} to {here['gain']['high']:+.3f})"
        there = [score(rows[f"{spec} | {of} | {method}"]["accuracy"]) for of in sets]
        yield (f"{spec}: {method}", score(here["accuracy"]), gain, *there)


@table("fit-calibration", "fit_calibration")
def fit_calibration(result: dict[str, Any]) -> Lines:
    """Limits and tolerances of the fit rule by each method, on the session that chose them and on the other one."""
    rows, sets = result["rows"], list(result["benchmarks"])
    yield ("", "primitives", "rest that is constant, worst axis", "fit, session A", *sets)
    for name, limits in rows.items():
        kind, method = name.split(" | ")
        if kind != "limits":
            continue
        scores = (score(rows.get(f"{one} | {method}", {}).get("accuracy")) for one in sets)
        rest = limits["share of rest that is constant, worst axis"]
        words = f"{limits['primitives per trial']:.0f}"
        yield (method, words, f"{rest:.3f}", f"{limits['fit inside']:.3f}", *scores)


@table("calibration-time", "calibration_curves")
def calibration_time(result: dict[str, Any]) -> Lines:
    """Objective over processor seconds on the seeds that all methods have; effect of training on held-out trials."""
    rows = result["rows"]
    methods = {
        "random": "random", "halving": "halving, then CMA-ES", "optuna": "Optuna's TPE, NumPy, one at a time",
        "gradient of the fit": "gradient of `fit`", "gradient": "gradient of a classifier's loss",
    }  # fmt: skip
    runs = {m: [row for name, row in rows.items() if name.split(" | ")[0] == m] for m in methods}
    common = min(len(seeds) for seeds in runs.values())
    falls = ("own held-out loss decreases", "log-loss of hard labels decreases")
    yield ("", "evaluations", "best objective", "reached after", *falls)
    for method, title in methods.items():
        curves = [row["curve (seconds, objective, held-out accuracy, held-out log-loss)"] for row in runs[method]]
        best = statistics.median(curve[-1][1] for curve in curves[:common])
        taken = statistics.median(curve[-1][0] for curve in curves[:common])
        trained = [row.get("held-out training loss, first and last", ()) for row in runs[method]]
        ends = [row.get("held-out accuracy and log-loss at the end", (0, 0))[1] for row in runs[method]]
        own = _share([loss[1] < loss[0] for loss in trained if loss])
        hard = _share([end < c[0][3] for end, c, loss in zip(ends, curves, trained, strict=True) if loss])
        yield title, f"{runs[method][0]['evaluations']}", f"{best:.2f}", f"{taken:.1f} s", own, hard


def _share(true: list[bool]) -> str:
    return f"{sum(true)} of {len(true)}" if true else NONE


@table(
    "calibration-simulated", "calibration_device_warp_failure_type_openhrp",
    "calibration_device_warp_failure_type_hooked_b", "calibration_transfer",
)  # fmt: skip
def calibration_simulated(openhrp: dict[str, Any], hooked: dict[str, Any], transfer: dict[str, Any]) -> Lines:
    """Thresholds chosen on simulated failures: on other simulated ones of each preset, and on the authors'."""
    presets, authors = {"openhrp": openhrp["svm"], "hooked-B": hooked["svm"]}, transfer["rows"]
    yield ("", *(f"held-out trials of {place}" for place in presets), "the authors' failures, ranks", "deviation")
    for name in ("preset", *(f"{place}, {method}" for place in presets for method in ("search", "gradient"))):
        place, _, method = name.rpartition(", ")
        own = [score(scores[method]) if place in ("", one) else NONE for one, scores in presets.items()]
        of_authors = [score(authors[f"{name} | {scaled}"]["accuracy"]) for scaled in ("ranks", "deviation")]
        yield (name, *own, *of_authors)
    durations = [score(scores["duration alone"]) for scores in presets.values()]
    yield ("duration alone", *durations, score(authors["duration alone"]["accuracy"]), NONE)
