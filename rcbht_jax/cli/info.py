"""``rcbht info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.io.label_store import list_tracks
from rcbht_jax.io.store import read_attrs, read_recordings
from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class Info(Command):
    """Summarise a store: recordings by source, session and outcome, missing state times, label tracks.

    Reads the whole store and so checks it, too.

    Example: rcbht info hiro.zarr
    """

    store: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr")]
    """Store to describe."""

    def run(self) -> dict[str, Any]:
        recordings, attrs = read_recordings(self.store), read_attrs(self.store)
        keys = zip(recordings.source, recordings.session, recordings.outcome, recordings.arm, strict=True)
        rows = [tuple(str(word) for word in key) for key in keys]
        groups = [_describe(recordings, key, np.array([row == key for row in rows])) for key in dict.fromkeys(rows)]
        flags = Counter(
            flag.split(":")[0].split("=")[0] for note in recordings.note for flag in note.split(";") if flag
        )
        return {
            "store": str(self.store),
            "recordings": len(recordings),
            "dt": recordings.dt,
            "groups": groups,
            "notes": dict(sorted(flags.items())),
            "label_tracks": list_tracks(self.store),
            "created": attrs["created"],
            "rcbht_jax_version": attrs["rcbht_jax_version"],
            "content_sha256": attrs["content_sha256"],
        }

    def text(self, result: dict[str, Any]) -> str:
        head = f"{result['store']}: {result['recordings']} recordings at {1 / result['dt']:g} Hz"
        columns = f"{'source':34} {'session':9} {'outcome':8} arm  count  seconds (min/median/max)  onsets missing"
        lines = [head, f"created {result['created']} by rcbht-jax {result['rcbht_jax_version']}", "", columns]
        for group in result["groups"]:
            low, middle, high = group["seconds"]
            lines.append(
                f"{group['source']:34} {group['session']:9} {group['outcome']:8} {group['arm']:3} "
                f"{group['recordings']:6d}  {low:7.2f} {middle:7.2f} {high:7.2f}   "
                f"{'/'.join(str(count) for count in group['onsets_missing'])}"
            )
        notes = ", ".join(f"{flag} {count}" for flag, count in result["notes"].items())
        tracks = ", ".join(result["label_tracks"])
        return "\n".join([*lines, "", f"notes: {notes or 'none'}", f"label tracks: {tracks or 'none'}"])


def _describe(recordings: Recordings, key: tuple[str, ...], member: np.ndarray) -> dict[str, Any]:
    """One row of the summary: the recordings that ``member`` [recording] selects."""
    seconds = recordings.length[member] * recordings.dt
    return {
        **dict(zip(("source", "session", "outcome", "arm"), key, strict=True)),
        "recordings": int(member.sum()),
        "seconds": [round(float(value), 6) for value in np.quantile(seconds, (0.0, 0.5, 1.0))],
        "onsets_missing": np.isnan(recordings.onset[member]).sum(0).tolist(),
    }
