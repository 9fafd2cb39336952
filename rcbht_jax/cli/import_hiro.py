"""``rcbht import hiro``."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm  # type: ignore[import-untyped]

from rcbht_jax.cli.command import Command
from rcbht_jax.io.hiro.importer import import_hiro


@dataclass(frozen=True)
class ImportHiro(Command):
    """Import the authors' trials (folders of R_Torques.dat and siblings) into a store.

    Broken trials are reported and left out; exact copies are imported once.

    Example: rcbht import hiro ../shared/data/hiro hiro.zarr
    """

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of the data sets, or one data set."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.zarr")]
    """Store to create, for example hiro.zarr."""
    overwrite: bool = False
    """Replace an existing store, once the new one is complete."""

    def run(self) -> dict[str, Any]:
        report = import_hiro(self.directory, self.out, self.overwrite, _bar)
        return {"store": str(self.out), **report.to_dict()}

    def text(self, result: dict[str, Any]) -> str:
        sets = Counter(name.rsplit("/", 2)[0] for name in result["imported"] if name.count("/") > 1)
        lines = [f"{len(result['imported'])} recordings in {result['store']}"]
        lines += [f"  {count:5d}  {source}" for source, count in sorted(sets.items())]
        for title, key in (("left out", "skipped"), ("exact copies", "duplicates"), ("warnings", "warnings")):
            if result[key]:
                lines.append(f"{title}: {len(result[key])}")
                lines += [f"  {_sentence(path, reason)}" for path, reason in result[key]]
        return "\n".join(lines)


def _sentence(path: str, reason: str) -> str:
    """Messages of the parser begin with the path already."""
    return reason if reason.startswith(path) else f"{path}: {reason}"


def _bar(folders: list[Path]) -> Iterable[Path]:
    """Progress on standard error, silent where that is not a terminal."""
    bar: Iterable[Path] = tqdm(folders, desc="import", unit=" trials", file=sys.stderr, disable=None)
    return bar
