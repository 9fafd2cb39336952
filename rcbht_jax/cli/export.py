"""``rcbht export`` and ``rcbht report``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Folder, option, progress_bar, unset
from rcbht_jax.cli.drawn import DrawnRule, made_now_note, stored_by, thresholds_now
from rcbht_jax.errors import InputError


@dataclass(frozen=True)
class Export(Command):
    """Write a store as Parquet, LeRobotDataset v3, MCAP or CSV: a folder with a data card.

    The files contain the signals, annotations, columns and labels of the store. An existing folder is never replaced.

    Example: rcbht export hiro.zarr --format parquet -o hiro-parquet
    """

    store: common.Store
    """Store to export."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER"), Folder()]
    """Folder to create."""
    format: Literal["parquet", "lerobot", "mcap", "csv"] = "parquet"
    """Format of the files."""
    tracks: common.Tracks = ""
    window: common.NewWindow = None
    rule: common.WordRule = "paper"
    tolerance: common.Tolerance = ()

    def run(self) -> dict[str, Any]:
        from rcbht_jax.io.export import export, load
        from rcbht_jax.io.export.write import check_target

        check_target(self.out)
        words = (self.tracks, self.window, self.rule, self.tolerance)
        data = load(self.store, *words, thresholds_now(self.store, self.window, self.rule))
        with progress_bar("export", "trials", len(data.recordings)) as bar:
            export(data, self.out, self.format, bar.update)
        files = [path for path in self.out.rglob("*") if path.is_file()]
        return {
            "out": str(self.out),
            "format": self.format,
            "recordings": len(data.recordings),
            "tracks": data.tracks_name or None,
            "files": len(files),
            "bytes": sum(path.stat().st_size for path in files),
        }

    def text(self, result: dict[str, Any]) -> str:
        return (
            f"{result['out']}: {plural(result['recordings'], 'recording')} with "
            f"{result['tracks'] or 'no'} labels as {result['format']}, {plural(result['files'], 'file')}, "
            f"{result['bytes'] / 1e6:.1f} MB; add the licence to its README.md"
        )


@dataclass(frozen=True)
class Report(Command):
    """Write one HTML file about a store: counts, confounds, results, and a browser of trials, labels and beliefs.

    The file is self-contained: it can be mailed, archived, opened without a network, and printed.

    Example: rcbht report hiro.zarr -o report.html --model states.model --results experiments/results
    """

    store: common.Store
    """Store to report on."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="REPORT.html")]
    """File to write; an existing report is replaced when the new one is complete."""
    model: Annotated[Path | None, unset(aliases=["-m"], metavar="MODEL"), common.ONLINE_MODEL] = None
    """Model file of "rcbht train-online" whose beliefs are shown over time."""
    results: Annotated[Path | None, unset(metavar="FOLDER")] = None
    """Folder with JSON files of result rows, shown as a table; docs/howto/share.md describes their format."""
    tracks: common.Tracks = ""
    window: common.NewWindow = None
    rule: DrawnRule = "fit"
    tolerance: common.Tolerance = ()
    trial: Annotated[tuple[str, ...], option("Trials to show; default --max-trials of them, evenly spaced.", "")] = ()
    max_trials: int = 100
    """Number of recordings to show, if --trial names none."""
    title: Annotated[str, option("Heading of the page.", "Wrench introspection, or Signal introspection")] = ""

    FORMER: ClassVar[dict[str, str]] = {"--most": "--max-trials"}

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.atomic import atomic_write
        from rcbht_jax.introspection import model as models
        from rcbht_jax.io.export import load
        from rcbht_jax.io.store import unchanged
        from rcbht_jax.report import Options, page
        from rcbht_jax.report.page import chosen
        from rcbht_jax.report.results import read_results

        if self.out.suffix not in (".html", ".htm"):
            raise InputError(f"{self.out} does not end in .html; expected a name such as report.html.")
        options = Options(
            title=self.title,
            results=None if self.results is None else read_results(self.results),
            model=None if self.model is None else models.load(self.model),
            trials=self.trial,
            most=self.max_trials,
        )
        with unchanged(self.store):
            words = self._words()
            data = load(self.store, *words, thresholds_now(self.store, *words[1:3]))
            count = len(chosen(data.recordings, options))
            with progress_bar("report", "trials", count) as bar:
                text = page(data, options, bar.update)
        with atomic_write(self.out) as draft:
            draft.write_text(text, encoding="utf-8")
        return {
            "out": str(self.out),
            "shown": count,
            "recordings": len(data.recordings),
            "tracks": data.tracks_name,
            "results": 0 if options.results is None else len(options.results.rows),
            "bytes": self.out.stat().st_size,
        }

    def _words(self) -> tuple[str, int | None, DrawnRule, tuple[float, ...]]:
        """Which words are shown: tracks, window, rule and tolerance of :func:`rcbht_jax.io.export.load`."""
        from rcbht_jax.io.label_store import list_tracks

        if self.tracks:
            return self.tracks, self.window, "paper", self.tolerance
        now = self.window is not None or self.tolerance or not list_tracks(self.store)
        name = "" if now else stored_by(self.store, self.rule)
        window = 5 if self.window is None else self.window
        return (name, None, "paper", ()) if name else ("", window, self.rule, self.tolerance)

    def text(self, result: dict[str, Any]) -> str:
        return (
            f"{result['out']}: {result['shown']} of {plural(result['recordings'], 'recording')}, labels "
            f"{result['tracks']}{made_now_note(self.store, result['tracks'])}, {plural(result['results'], 'result')}, "
            f"{result['bytes'] / 1e6:.1f} MB"
        )
