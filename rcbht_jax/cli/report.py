"""``rcbht report``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.introspection import model as models
from rcbht_jax.io.export import load
from rcbht_jax.report import Options, page
from rcbht_jax.report.page import chosen
from rcbht_jax.report.results import read_results


@dataclass(frozen=True)
class Report(Command):
    """One HTML file about a store: counts, confounds, results, and a browser of trials, words and beliefs.

    The file fetches nothing: it can be mailed, archived, opened without a network, and printed.

    Example: rcbht report hiro.zarr -o report.html --model states.model --results experiments/results
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store to report on."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="REPORT.html")]
    """File to write; an existing report is replaced when the new one is complete."""
    model: Annotated[Path | None, tyro.conf.arg(aliases=["-m"], metavar="MODEL")] = None
    """Model file of "rcbht train-online", whose beliefs are shown over time."""
    results: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder with JSON files of result rows, shown as a table; docs/howto/share.md describes their format."""
    tracks: str = ""
    """Label tracks to show, where the store has several."""
    window: int | None = None
    """Label now with windows of so many samples, instead of showing stored labels."""
    trial: tuple[str, ...] = ()
    """Trials to show; default --most of them, evenly spaced."""
    most: int = 100
    """How many recordings to show, where none are named."""
    title: str = "Wrench introspection"
    """Heading."""

    def run(self) -> dict[str, Any]:
        _check_target(self.out)
        options = Options(
            title=self.title,
            results=None if self.results is None else read_results(self.results),
            model=None if self.model is None else models.load(self.model),
            trials=self.trial,
            most=self.most,
        )
        data = load(self.store, self.tracks, self.window)
        count = len(chosen(data.recordings, options))
        with tqdm(total=count, desc="report", unit=" trials", file=sys.stderr, disable=None) as bar:
            text = page(data, options, lambda done: bar.update(done) and None)
        with atomic_write(self.out) as draft:
            draft.write_text(text, encoding="utf-8")
        return {
            "out": str(self.out),
            "shown": count,
            "recordings": len(data.recordings),
            "tracks": data.tracks_name or None,
            "results": 0 if options.results is None else len(options.results.rows),
            "bytes": self.out.stat().st_size,
        }

    def text(self, result: dict[str, Any]) -> str:
        return (
            f"{result['out']}: {result['shown']} of {result['recordings']} recordings, labels "
            f"{result['tracks'] or 'none'}, {result['results']} results, {result['bytes'] / 1e6:.1f} MB"
        )


def _check_target(out: Path) -> None:
    if not out.parent.is_dir():
        raise InputError(f"{out.parent} is not a folder; create it first.")
    if out.suffix not in (".html", ".htm"):
        raise InputError(f"{out} does not end in .html; name the report for example report.html.")
    if out.is_dir():
        raise InputError(f"{out} is a folder; choose another name.")
