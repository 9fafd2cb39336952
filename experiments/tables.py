"""Tables in Markdown of the committed results, by name; each takes the way from its page to the results."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from experiments.compared import compared
from experiments.compared import result as _result
from experiments.record import COMMITTED
from experiments.reproduce import EXPERIMENTS
from rcbht_jax.errors import InputError
from rcbht_jax.report.results import Row, read_results

# What the README shows: beginning of the group, of the row's text -> what it is called there.
SHOWN = {
    ("Offline", "REAL states, grouped"): "states, real trials, offline",
    ("Offline", "SIM one-arm states, grouped"): "states, the authors' simulated trials, offline",
    ("Words and other", "SIM1 states: richer words + SVM, all"): "the same, richer words on our labels",
    ("Offline", "REAL success/failure"): "success or failure, real trials, offline (confounded)",
    ("Words and other", "REAL merged states, A to B: richer words and levels"): "three states, session A to session B",
    ("Words and other", "failure types: richer words + SVM, without"): "13 failure types of the authors' simulation",
    ("Simulation only", "without presets A and B, harm"): "states, real trials, learned from simulated ones only",
    ("Online", "REAL at 10 Hz, full-sequence"): "states, real trials, streamed, at their end",
    ("Online", "REAL at 10 Hz, macro step"): "states, real trials, streamed, every tenth of a second",
    ("Online", "SIM1 at 10 Hz, macro step"): "states, the authors' simulated trials, streamed, every tenth of a second",
}
NEEDS = {"data": "recorded trials", "golden": "reference results", "peers": "`make peers`"}
FOLDED = ("REAL states", "SIM1 states", "SIM2 states", "failure types")
NONE = "–"


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(score: dict[str, float] | None, interval: bool = True) -> str:
    """A mean with its 95 % interval, or a dash."""
    if score is None:
        return NONE
    limits = f" ({score['low']:.3f} to {score['high']:.3f})" if interval and "low" in score else ""
    return f"{score['mean']:.3f}{limits}"


def results(way: str) -> str:
    """The README's table."""
    rows = read_results(COMMITTED).rows
    lines = []
    for (group, what), title in SHOWN.items():
        row = _only([row for row in rows if row.group.startswith(group) and row.what.startswith(what)], what)
        low, high = row.interval or (row.ours, row.ours)
        link = f"[{Path(row.source).stem}]({way}{row.source})"
        lines.append((title, row.paper or "none", f"{row.ours:.3f} ({low:.3f} to {high:.3f})", link))
    return _markdown(("accuracy", "paper", "here, 95 % interval", "result"), lines)


def _only(rows: list[Row], what: str) -> Row:
    if len(rows) != 1:
        raise InputError(f"{len(rows)} results are called {what}; expected one.")
    return rows[0]


def _peers(benchmarks: Sequence[str]) -> str:
    found = compared()
    kinds = {method: row["kind"] for rows in found.values() for method, row in rows.items()}
    lines = []
    for kind in ("peer", "ours", "probe"):
        for method in (name for name, of in kinds.items() if of == kind):
            said = (found[benchmark].get(method, {}).get("accuracy") for benchmark in benchmarks)
            lines.append((f"*{method}*" if kind == "probe" else method, *map(_number, said)))
    return _markdown(("", *benchmarks), lines)


def peers_folds(way: str) -> str:
    """Other methods and words by cross-validation."""
    return _peers(FOLDED)


def peers_sessions(way: str) -> str:
    """Other methods and words from one session to another."""
    return _peers([name for name in compared() if name not in FOLDED])


def _grammar(benchmarks: Sequence[str]) -> str:
    found: dict[str, dict[str, Any]] = {}
    for name, row in _result("grammar")["rows"].items():
        benchmark, method = name.split(" | ")
        found.setdefault(method, {})[benchmark] = row["accuracy"]
    lines = [(method, *(_number(row.get(benchmark)) for benchmark in benchmarks)) for method, row in found.items()]
    return _markdown(("", *benchmarks), lines)


def grammar_folds(way: str) -> str:
    """Words of several kinds by cross-validation."""
    return _grammar(FOLDED)


def grammar_sessions(way: str) -> str:
    """Words of several kinds from one session or batch to another."""
    return _grammar([name for name in _result("grammar")["benchmarks"] if name not in FOLDED])


def table1(way: str) -> str:
    """Table I of the paper on our labels."""
    lines = []
    for name, row in _result("table1_ours")["rows"].items():
        what, labels = name.split(" | ")
        paper = NONE if row["paper"] is None else "{1:.2f} ({0:.2f} to {2:.2f})".format(*row["paper"])
        low, mean, high = row["paper's features, paper's protocol"]["fold_min_mean_max"]
        nested, words = (row[f"{kind}, nested, grouped"]["accuracy"] for kind in ("paper's features", "words"))
        alone = row["duration alone"]["accuracy"]
        ours = (f"{mean:.3f} ({low:.3f} to {high:.3f})", _number(nested), _number(words), _number(alone, False))
        lines.append((what, labels, paper, *ours))
    head = ("", "labels", "paper: mean (min to max)", "paper's features and protocol: mean (min to max)")
    return _markdown((*head, "paper's features, nested, grouped", "words, nested, grouped", "duration alone"), lines)


def probes(way: str) -> str:
    """What tells failure, success and session without any assembly."""
    found: dict[str, dict[str, Any]] = {}
    for name, row in _result("probes")["rows"].items():
        question, view = name.split(" | ")
        found.setdefault(question, {})[view] = row["balanced_accuracy"]
    views = list(next(iter(found.values())))[1:]
    lines = [(question, *(_number(row.get(view)) for view in views)) for question, row in found.items()]
    return _markdown(("balanced accuracy", *views), lines)


def calibration(way: str) -> str:
    """Thresholds by each method, words alone; the best of a line in bold."""
    result = _result("calibration")
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
    lines = []
    for title, row in rows.items():
        said = [row[key]["words"]["accuracy"]["mean"] if key in row else None for key in methods]
        best = max(value for value in said if value is not None)
        lines.append((title, *(_bold(value, value == best) for value in said)))
    return _markdown(("", *methods.values()), lines)


def calibration_near(way: str) -> str:
    """Thresholds near the preset: chosen, shrunk, averaged."""
    rows = _result("calibration_near")["rows"]
    sets = ("SIM1", "REAL A -> B", "REAL B -> A")
    methods = list(dict.fromkeys(name.split(" | ")[1] for name in rows))
    lines = [
        (method, *(_number(rows.get(f"{of} | {method}", {}).get("accuracy")) for of in sets)) for method in methods
    ]
    return _markdown(("", *sets), lines)


def calibration_simulated(way: str) -> str:
    """Thresholds chosen on simulated failures: on other simulated ones, and on the authors'."""
    there, here = _result("calibration_device_warp_failure_type")["svm"], _result("calibration_transfer")["rows"]
    named = {"preset": "preset", "search": "simulated, search", "gradient": "simulated, gradient"}
    lines = [
        (
            name,
            _number(there[own]),
            *(_number(here[f"{name} | {scaled}"]["accuracy"]) for scaled in ("ranks", "deviation")),
        )
        for own, name in named.items()
    ]
    lines.append(
        ("duration alone", _number(there["duration alone"]), _number(here["duration alone"]["accuracy"]), NONE)
    )
    return _markdown(("", "held-out simulated trials", "the authors' failures, ranks", "deviation"), lines)


def _bold(value: float | None, best: bool) -> str:
    if value is None:
        return "not run"
    return f"**{value:.3f}**" if best else f"{value:.3f}"


def online(way: str) -> str:
    """States streamed at 10 Hz."""
    rows = _result("table2")["rows"]
    names = {"REAL": "REAL", "SIM1": "SIM one arm", "SIM2": "SIM two arms (right)"}
    kinds = {"all": "all features", "relative": "relative features"}
    lines = []
    for name, title in names.items():
        for kind, features in kinds.items():
            if found := rows[f"{name} at 10 Hz"].get(kind):
                means = [found[key]["mean"] for key in ("macro step accuracy", "full-sequence accuracy", "OverallPr")]
                own = min(found["certainty"]["k=0.70"]["m_own"])
                errors = " / ".join(f"{found[f'ECE {part}']['mean']:.3f}" for part in ("steps", "full sequences"))
                lines.append((f"{title}, {features}", *(f"{value:.3f}" for value in means), f"{own:.2f}", errors))
    head = ("step accuracy (mean of classes)", "full-sequence accuracy", "OverallPr", "smallest own-length m at .70")
    return _markdown(("", *head, "calibration error, steps / full"), lines)


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
    rows = _worst_draws(_result("sim_to_real")["rows"])
    lines = []
    for name in [name for group in groups for name in rows if name.split(" | ")[0] == group]:
        scores = [rows[name][states][on] for states in ("merged", "harmonised") for on in ("A", "B", "A+B")]
        said = [f"{score['accuracy']:.3f}" for score in scores]
        for place in (2, 5):
            low, high = scores[place]["interval"]
            said[place] += f" ({low:.3f} to {high:.3f})"
        lines.append((name.replace(" | ", ": "), str(rows[name]["merged"]["trials"]), *said))
    head = ("", "training trials", *(f"{n} states, {on}" for n in (3, 4) for on in ("A", "B", "both")))
    return _markdown(head, lines)


def _worst_draws(rows: dict[str, Any]) -> dict[str, Any]:
    """Rows with scores on both sessions; of several draws of training trials the one that is worst at four states."""
    groups: dict[str, list[Any]] = {}
    for name, row in rows.items():
        if "A+B" in row.get("merged", {}):
            title, _, drawn = name.partition(", draw")
            groups.setdefault(f"{title}, worst draw" if drawn else title, []).append(row)
    return {name: min(found, key=lambda row: row["harmonised"]["A+B"]["accuracy"]) for name, found in groups.items()}


WORDS_SAME = "same primitive / composition / behaviour, % of time"


def _engine_runs(part: str) -> dict[str, Any]:
    """One part of the measurements on a GPU, by engine, and of those on a CPU where they have it."""
    gpu = json.loads((COMMITTED / "engines_gpu.json").read_text(encoding="utf-8"))  # two runs in one file
    found = {f"`{engine}`, one H200": gpu[engine][part] for engine in ("warp", "mjx") if part in gpu[engine]}
    cpu = _result("engines")["mjx"]
    return found | ({"`mjx`, 2 CPU cores": cpu[part]} if part in cpu else {})


def parity(way: str) -> str:
    """The device engines against C MuJoCo."""
    lines = []
    for engine, found in _engine_runs("parity").items():
        wrench = [found[f"{what}_until_contact"] for what in ("force", "moment")]
        words = " / ".join(f"{100 * share:.1f}" for share in found["labels"].values())
        contact = f"{wrench[0]:.3f} N, {wrench[1]:.4f} Nm"
        rest = (f"{found['force_after_contact']:.3f} N", words, f"{100 * found['states']:.2f}")
        lines.append((engine, str(found["trials"]), contact, *rest, f"{100 * found['same_outcome']:.1f}"))
    head = ("engine", "trials", "largest difference until contact", "median force difference after it", WORDS_SAME)
    return _markdown((*head, "same state, % of time", "same outcome, % of trials"), lines)


def parity_floor(way: str) -> str:
    """C MuJoCo against itself when next to nothing changes."""
    lines = []
    for change, found in _result("parity_floor")["rows"].items():
        words = " / ".join(f"{100 * share:.1f}" for share in found["labels"].values())
        lines.append((change, f"{found['force_until_contact']:.3f} N", words))
    return _markdown(("change", "largest difference until contact", WORDS_SAME), lines)


def solver(way: str) -> str:
    """How far the solver of the device engines must go."""
    lines = []
    for engine, rows in _engine_runs("solver").items():
        for row in sorted(rows, key=lambda row: -row["steps_per_s"]):
            middle, most = (row[f"{what}_force_difference_after_contact"] for what in ("median", "p99"))
            limits = "/".join(str(limit) for limit in row["solver"])
            lines.append((engine, limits, f"{middle:.4f} N", f"{most:.2f} N", f"{row['steps_per_s'] / 1e6:.2f}"))
    head = ("engine", "iterations / line search", "median force difference", "99 %", "million steps per second")
    return _markdown(head, lines)


def speed(way: str) -> str:
    """Physics steps per second with everything inside, by engine and batch."""
    lines = []
    for kind in ("speed", "sweep"):
        for engine, found in _engine_runs(kind).items():
            for run in found if isinstance(found, list) else [found]:
                millions, memory = run["steps_per_s"] / 1e6, run["memory_peak_GB"]
                lines.append(
                    (engine, f"{run['batch']:,}", f"{millions:.2f}", f"{run['compile_s']:.0f}", f"{memory:.1f}")
                )
    return _markdown(("engine", "trials at once", "million steps per second", "compilation, s", "memory, GB"), lines)


def synthesis(way: str) -> str:
    """A store of labelled trials from a GPU, from the command to the last byte."""
    lines = []
    for engine, run in _engine_runs("synthesis").items():
        parts = run["seconds_by_part"]
        seconds = (run["seconds"], run["with_compilation_s"], parts["run"], parts["encode_on_device"])
        counts = (f"{run['trials']:,}", f"{run['physics_steps_per_trial']:,}")
        rest = (f"{run['store_GB']:.1f}", str(run["diverged"]))
        lines.append((engine, *counts, *(f"{value:.0f}" for value in seconds), *rest))
    head = ("engine", "trials", "physics steps each", "seconds", "with compilation", "of them physics", "labels")
    return _markdown((*head, "store, GB", "diverged, left out"), lines)


def latency(way: str) -> str:
    """How soon a stream is answered."""
    found = _result("stream_speed")
    start, push = found["start"], found["latency"]
    rows = [
        ("start to first belief, nothing compiled yet", f"{start['cold']['wall, s']:.1f} s"),
        ("start to first belief, compiled programs kept", f"{start['warm cache']['wall, s']:.1f} s"),
        ("one window to belief, median", f"{push['median, ms']:.2f} ms"),
        ("one window to belief, 99 %", f"{push['p99, ms']:.2f} ms"),
    ]
    return _markdown(("six axes, 2 CPU cores", "time"), rows)


def experiments(way: str) -> str:
    """What ``make reproduce`` runs, and what it cannot."""
    lines = []
    for experiment in EXPERIMENTS:
        text = (Path(__file__).parent / f"{experiment.module}.py").read_text(encoding="utf-8")
        about = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].replace("\n", " ")
        needs = ", ".join(NEEDS[need] for need in experiment.needs) or NONE
        minutes = experiment.elsewhere or f"{experiment.minutes:g}"
        files = ", ".join(f"[{n}]({way}{n}.json)" for n in experiment.names if (COMMITTED / f"{n}.json").is_file())
        command = " ".join(("python -m", f"experiments.{experiment.module}", *experiment.options))
        command = command.replace("{work}", "WORK")
        lines.append((f"`{command}`", about, needs, minutes, files or NONE))
    return _markdown(("command", "what", "needs", "about minutes", "results"), lines)


TABLES: dict[str, Callable[[str], str]] = {
    "results": results,
    "peers-folds": peers_folds,
    "peers-sessions": peers_sessions,
    "grammar-folds": grammar_folds,
    "grammar-sessions": grammar_sessions,
    "table1": table1,
    "probes": probes,
    "calibration": calibration,
    "calibration-near": calibration_near,
    "calibration-simulated": calibration_simulated,
    "online": online,
    "parity": parity,
    "parity-floor": parity_floor,
    "solver": solver,
    "speed": speed,
    "synthesis": synthesis,
    "latency": latency,
    "experiments": experiments,
    "sim-to-real": sim_to_real,
    "sim-to-real-choices": sim_to_real_choices,
    "sim-to-real-thresholds": sim_to_real_thresholds,
}
