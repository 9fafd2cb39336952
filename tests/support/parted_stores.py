"""A store of three parts with everything in it, to be written in any order."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax.annotations import Annotations
from rcbht_jax.io import label_parts, store_writer
from rcbht_jax.io.parts import Layout
from rcbht_jax.io.store_schema import schema_of
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
from tests.support.store_cases import files

COUNT, PART, GAPS = 11, 4, (5, 8)


def ragged(gaps: tuple[int, ...] = ()) -> Recordings:
    """Recordings of lengths from 3 to 600 samples with 0 to 3 intervals each; nothing in the rows of ``gaps``."""
    rng = np.random.default_rng(1)
    wrenches = [rng.normal(size=(int(n), 2)) for n in rng.integers(3, 600, COUNT)]
    marks = [
        (row, f"track{number % 2}", f"label{number}", 0.1 * number, 0.1 * number + 0.05)
        for row in range(COUNT)
        for number in range(row % 4)
        if row not in gaps
    ]
    labels = {"track0": ["label0", "label2"], "track1": ["label1"]}
    texts = {
        "outcome": [f"ö{n}" for n in range(COUNT)],
        "mass": rng.normal(size=COUNT),
        "hook": ["", *"x" * (COUNT - 1)],
    }
    made = Recordings.from_arrays(
        wrenches, 100.0, axes=("grip", "push"), units=("N", "V"),
        annotations=Annotations.from_rows(marks, labels), **texts,
    )  # fmt: skip
    for row in gaps:
        made.wrench[row] = 0
        made.length[row] = 0
    return made


def truth() -> dict[str, Any]:
    rng = np.random.default_rng(2)
    words = np.array([f"fault{n % 3}" for n in range(COUNT)])
    return {"seated": rng.random((COUNT, 4)) > 0.5, "fault": words, "mass": rng.normal(size=COUNT)}


def tracks_of(count: int = COUNT, gaps: tuple[int, ...] = ()) -> LabelTracks:
    """Label tracks with up to 100 slots, none in the rows of ``gaps``."""
    rng = np.random.default_rng(3)

    def layer(slots: int) -> LabelTrack:
        used = np.arange(slots) < rng.integers(1, slots + 1, (count, 2, 1))
        used[list(gaps)] = False
        whole = {
            name: np.where(used, rng.integers(0, 9, used.shape), 0).astype(np.int32) for name in ("t0", "t1", "emit")
        }
        real = {name: np.where(used, rng.normal(size=used.shape), 0) for name in ("vmax", "vmin", "avg", "grad")}
        label = np.where(used, rng.integers(1, 9, used.shape), 0).astype(np.int8)
        return LabelTrack(label=label, **whole, **{name: values.astype(np.float32) for name, values in real.items()})

    return LabelTracks(layer(100), layer(70), layer(3))


def begun(path: Path, gaps: tuple[int, ...] = ()) -> Path:
    """A store without parts, and label tracks in it."""
    schema = schema_of(ragged(gaps=gaps), truth(), COUNT, PART)
    store_writer.create(path, schema, {"importer": "none"}, "then")
    label_parts.require_group(path)
    label_parts.create(path / "labels" / "x", schema.layout, tracks_of(), {"window": 5}, created="then")
    return path


def add(path: Path, number: int, gaps: tuple[int, ...] = ()) -> None:
    rows = Layout(COUNT, PART).span(number)
    some = {name: values[rows] for name, values in truth().items()}
    label_parts.write_part(path / "labels" / "x", number, label_parts.taken(tracks_of(gaps=gaps), rows))
    store_writer.write_part(path, number, trimmed(ragged(gaps=gaps).take(np.arange(rows.start, rows.stop))), some)


def trimmed(part: Recordings) -> Recordings:
    """As who writes a part has it: as long as its longest recording."""
    return dataclasses.replace(part, wrench=part.wrench[:, : int(part.length.max())])


def finish(path: Path) -> Path:
    label_parts.finish(path / "labels" / "x", path)
    store_writer.finish(path)
    return path


def tree(path: Path) -> dict[str, bytes]:
    return {str(entry.relative_to(path)): entry.read_bytes() for entry in files(path)}
