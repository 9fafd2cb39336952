"""``rcbht export``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.io.export import export, load
from rcbht_jax.io.export.write import check_target


@dataclass(frozen=True)
class Export(Command):
    """Write a store as Parquet, LeRobotDataset v3, MCAP or CSV: a folder with a data card.

    Wrench, times, starts of states, outcomes and labels, all as they are in the store. Nothing is ever replaced.

    Example: rcbht export hiro.zarr --format parquet -o hiro-parquet
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store to export."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to create."""
    format: Literal["parquet", "lerobot", "mcap", "csv"] = "parquet"
    """What to write."""
    tracks: str = ""
    """Label tracks to include, where the store has several."""
    window: int | None = None
    """Label now with windows of so many samples, instead of including stored labels."""

    def run(self) -> dict[str, Any]:
        check_target(self.out)
        data = load(self.store, self.tracks, self.window)
        with tqdm(total=len(data.recordings), desc="export", unit=" trials", file=sys.stderr, disable=None) as bar:
            export(data, self.out, self.format, lambda done: bar.update(done) and None)
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
            f"{result['out']}: {result['recordings']} recordings with "
            f"{result['tracks'] or 'no'} labels as {result['format']}, {result['files']} files, "
            f"{result['bytes'] / 1e6:.1f} MB; its README.md has a line for the licence"
        )
