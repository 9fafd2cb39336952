"""The table of results on the README, read from the committed results.

Run: python -m experiments.readme
"""

from __future__ import annotations

from pathlib import Path

from experiments.record import RESULTS
from rcbht_jax.errors import InputError
from rcbht_jax.report.results import Row, read_results

README = Path(__file__).resolve().parents[1] / "README.md"
BEGIN, END = "<!-- results: python -m experiments.readme -->", "<!-- end of results -->"

# What the README shows: beginning of the group, of the row's text -> what it is called there.
SHOWN = {
    ("Offline", "REAL states, grouped"): "states, real trials, offline",
    ("Offline", "SIM one-arm states, grouped"): "states, the authors' simulated trials, offline",
    ("Offline", "REAL success/failure"): "success or failure, real trials, offline (confounded)",
    ("Online", "REAL at 10 Hz, full-sequence"): "states, real trials, streamed, at their end",
    ("Online", "REAL at 10 Hz, macro step"): "states, real trials, streamed, every tenth of a second",
    ("Online", "SIM1 at 10 Hz, macro step"): "states, the authors' simulated trials, streamed, every tenth of a second",
}


def table() -> str:
    """The table in Markdown, with its markers."""
    rows = read_results(RESULTS).rows
    lines = [BEGIN, "| accuracy | paper | here, 95 % interval | result |", "|---|---|---|---|"]
    for (group, what), title in SHOWN.items():
        row = _only([row for row in rows if row.group.startswith(group) and row.what.startswith(what)], what)
        low, high = row.interval or (row.ours, row.ours)
        link = f"[{Path(row.source).stem}](experiments/results/{row.source})"
        lines.append(f"| {title} | {row.paper or 'none'} | {row.ours:.3f} ({low:.3f} to {high:.3f}) | {link} |")
    return "\n".join([*lines, END])


def _only(rows: list[Row], what: str) -> Row:
    if len(rows) != 1:
        raise InputError(f"{len(rows)} results are called {what}; expected one.")
    return rows[0]


def replaced(text: str) -> str:
    """A README with the table of today in place of the old one."""
    before, found, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        raise InputError(f"{README} lacks the markers of the table of results.")
    return f"{before}{table()}{after}"


if __name__ == "__main__":
    README.write_text(replaced(README.read_text(encoding="utf-8")), encoding="utf-8")
