"""``rcbht demo`` on recorded trials."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.cli.encode import Encode
from rcbht_jax.cli.import_hiro import ImportHiro
from rcbht_jax.cli.learning import Evaluate
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings
from rcbht_jax.plots import label_map, save, trial_figure

SOURCE = "REAL_HIRO_ONE_SA_SUCCESS"
WINDOW = 5


@dataclass(frozen=True)
class DemoRecorded(Command):
    """The whole chain on the authors' real trials: import, encode, evaluate, pictures, summary.

    Example: rcbht demo --data ../shared/data/hiro --out demo-out
    """

    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of the authors' data sets."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")] = Path("demo-out")
    """Folder for the store, the pictures and the summary; what an earlier demo left there is replaced."""

    def run(self) -> dict[str, Any]:
        if not self.data.is_dir():
            raise InputError(f"{self.data} is no folder; give the folder of the authors' data sets: --data DIR.")
        start = time.perf_counter()
        self.out.mkdir(parents=True, exist_ok=True)
        store = self.out / "hiro.zarr"
        _say(1, f"import {self.data} into {store}")
        imported = ImportHiro(self.data, store, overwrite=True).run()
        _say(2, "label every recording with the streaming encoder")
        encoded = Encode(store, window=WINDOW).run()
        _say(3, "tell the states of the real trials apart, five times five grouped folds")
        evaluate = Evaluate(store, source=(SOURCE,), repeats=5)
        scored = evaluate.run()
        _say(4, "draw pictures")
        pictures = self._draw(store, encoded["name"])
        result = {
            "recordings": len(imported["imported"]),
            "left_out": len(imported["skipped"]),
            "labels": encoded["labels"],
            "evaluation": scored,
            "pictures": [str(path) for path in pictures],
        }
        summary = self.out / "summary.txt"
        result |= {"summary": str(summary), "seconds": time.perf_counter() - start}
        summary.write_text(self._summary(result, evaluate.text(scored)))
        return result

    def text(self, result: dict[str, Any]) -> str:
        return Path(result["summary"]).read_text().rstrip()

    def _draw(self, store: Path, tracks_name: str) -> list[Path]:
        recordings, (tracks, _) = read_recordings(store), read_tracks(store, tracks_name)
        paths = []
        for session in ("A", "B"):
            rows = np.flatnonzero(recordings.session == session)
            if rows.size:
                row = int(rows[rows.size // 2])
                paths.append(self.out / f"trial-{recordings.trial[row]}.png")
                save(trial_figure(recordings, tracks, row, window=WINDOW), paths[-1])
        select = recordings.source == SOURCE
        paths.append(self.out / "label-map.png")
        save(label_map(recordings, tracks, "llb", select=select, by="state", title=SOURCE), paths[-1])
        return paths

    def _summary(self, result: dict[str, Any], evaluation: str) -> str:
        labels = ", ".join(f"{count} {layer}" for layer, count in result["labels"].items())
        lines = [
            f"rcbht demo, {result['seconds']:.0f} s",
            f"{result['recordings']} recordings imported, {result['left_out']} left out",
            f"published labels: {labels}",
            "",
            evaluation,
            "",
            "pictures:",
            *(f"  {path}" for path in result["pictures"]),
        ]
        return "\n".join(lines) + "\n"


def _say(step: int, what: str) -> None:
    print(f"[{step}/4] {what}", file=sys.stderr, flush=True)
