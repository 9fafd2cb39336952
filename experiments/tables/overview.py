"""Scores of methods other than the frozen one, and the table of all experiments."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

from experiments._lib.catalogue import EXPERIMENTS
from experiments._lib.report_rows import NAME
from experiments._lib.results_io import COMMITTED
from experiments.tables.cells import NONE, Lines, ends, table
from rcbht_jax.errors import InputError

# Other methods than the frozen one: beginning of the group, of the row's text -> what it is called.
ABLATIONS = {
    ("Offline", "REAL states, grouped"): "states, real trials: the authors' published features, SVM",
    ("Offline", "SIM one-arm states, grouped"): "states, the authors' simulated trials: published features, SVM",
    ("Words and other", "SIM1 states: richer words + SVM, all"): "the same: all families, durations too",
    ("Offline", "REAL success/failure"): "success or failure, real trials (confounded): published features, SVM",
    ("Words and other", "REAL merged states, A to B: richer words + SVM, without"):
        "three states, session A to session B: no absolute level",
    ("Words and other", "REAL merged states, A to B: richer words and levels"):
        "the same: richer words and levels",
    ("Words and other", "failure types: richer words + SVM, without"): "13 failure types: no absolute level",
    ("Words and other", "failure types: richer words + SVM, all"): "the same: all families, durations too",
    ("Trained on sim", "without presets A and B, harm"):
        "four states, real trials: cross-session transfer after identification (hooks fitted to both, A's sensor)",
    ("Trained on sim", "without presets A and B, merged"): "the same: three states",
    ("Online", "REAL at 10 Hz, full-sequence"): "states, real trials, streamed, at their end; beginnings given",
    ("Online", "REAL at 10 Hz, macro step"): "the same, every tenth of a second; beginnings given",
    ("Online", "SIM1 at 10 Hz, macro step"): "the same, the authors' simulated trials; beginnings given",
}  # fmt: skip
NEEDS = {
    "data": "recorded trials",
    "external": "recordings of other robots",
    "golden": "reference results",
    "peers": "`make peers`",
}
MODULES = Path(__file__).resolve().parents[1]


@table("ablations", NAME, links=True)
def ablations(record: dict[str, Any], way: str) -> Lines:
    """Scores of other methods, which are not the headline."""
    rows = record["rows"]
    yield "accuracy", "paper", "95 % interval", "result"
    for (group, what), title in ABLATIONS.items():
        row = _only([row for row in rows if row["group"].startswith(group) and row["what"].startswith(what)], what)
        link = f"[{Path(row['source']).stem}]({way}{row['source']})"
        yield title, row["paper"] or "none", f"{row['ours']:.3f}{ends(*row['interval'])}", link


def _only(rows: list[dict[str, Any]], what: str) -> dict[str, Any]:
    if len(rows) != 1:
        raise InputError(f"{len(rows)} results are called {what}; expected one.")
    return rows[0]


@table("experiments", links=True)
def experiments(way: str) -> Lines:
    """The experiments that ``make reproduce`` runs, and those that it cannot."""
    yield "command", "what", "needs", "about minutes", "results"
    for experiment in EXPERIMENTS:
        text = (MODULES / f"{experiment.module.replace('.', '/')}.py").read_text(encoding="utf-8")
        about = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].replace("\n", " ")
        needs = ", ".join(NEEDS[need] for need in experiment.needs) or NONE
        minutes = experiment.elsewhere or f"{experiment.minutes:g}"
        if experiment.shorter:
            minutes += f"; {experiment.shorter_minutes:g} with `{' '.join(experiment.shorter)}`"
        files = ", ".join(f"[{n}]({way}{n}.json)" for n in experiment.names if (COMMITTED / f"{n}.json").is_file())
        command = " ".join(("python -m", f"experiments.{experiment.module}", *experiment.options))
        command = command.replace("{work}", "WORK")
        yield f"`{command}`", about, needs, minutes, files or NONE
