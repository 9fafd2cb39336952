"""Hostile names of trials and folders through every export: files stay inside, names come back, no cell a formula."""

from __future__ import annotations

import csv
import random
from pathlib import Path

from rcbht_jax.errors import InputError
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import read_source
from tests.attacks.folders import recordings

NAMES = (
    "../x", "/tmp/x", "..", ".", "a/b", "a\\b", "con", "x" * 3000, "\n", "a\tb", "-o", "=1+1", "+cmd|' /C calc'!A0",
    "@SUM(1)", "\x1b]0;owned\x07", "\u202egnp.exe", "<script>alert(1)</script>", "%s{0}", "\u4e2d\u6587", "a b", "'=1",
    '"', ",", ";", "\r\n=1", "\ufeff", "nan", "1e5", "True", "None",
)  # fmt: skip
FORMULA = tuple("=@\t\r")


def attack(seed: str, folder: Path) -> str:
    """Export recordings of two hostile names; "", "refused", or what is wrong."""
    rng = random.Random(seed)
    kind = rng.choice(("csv", "parquet", "mcap", "lerobot"))
    made = [rng.choice(NAMES) if rng.random() < 0.7 else _any(rng) for _ in range(2)]
    out = folder / "out"
    try:
        export(DataSet.of(recordings(tuple(made))), out, kind)
        out = out.rename(folder / rng.choice(("out", "o\udcff")))  # as files from another machine may be called
        found = read_source(out, kind).recordings
    except InputError:
        return "refused"
    if any(not path.resolve().is_relative_to(folder.resolve()) for path in folder.rglob("*")):
        return "a file is outside"
    if sorted(path.name for path in folder.iterdir()) != [out.name]:
        return "a file is beside the export"
    if found.trial.tolist() != made:
        return f"{kind}: names come back as {found.trial.tolist()!r}, not {made!r}"
    for path in out.rglob("trials.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            if formula := [cell for row in csv.reader(file) for cell in row if cell.startswith(FORMULA)]:
                return f"a cell is a formula: {formula[0]!r}"
    return ""


def _any(rng: random.Random) -> str:
    return "".join(
        chr(rng.choice((rng.randrange(1, 128), rng.randrange(1, 0xD800)))) for _ in range(rng.randrange(1, 9))
    )
