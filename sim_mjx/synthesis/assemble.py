"""Join the shards of a synthesis into one store."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks
from sim_mjx.engines.common import blocks
from sim_mjx.randomization.trials import Fault
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import records, shards, tables
from sim_mjx.synthesis.plan import SynthesisConfig, encoder_config, indices, label_limits, provenance

Drawn = tuple[Any, list[Fault]]  # parameters of a shard's trials, and their faults
CREATED = "undated"  # a date would make every store different


def assemble(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    manifest: dict[str, Any],
    drawn: dict[int, Drawn],
) -> Path:
    """Join the shards into a store in the work folder; ``drawn`` holds the trials of this run's shards."""
    loaded = [shards.load(folder, shard) for shard in range(-(-job.trials // job.shard))]
    parts = [part for part in loaded if part is not None]
    if len(parts) < len(loaded):
        raise InputError(f"A shard in {folder} was damaged just now; run the same command again.")
    diverged = np.concatenate([part["diverged"] for part in parts])
    stored = np.flatnonzero(~diverged)
    if len(stored) == 0:
        raise InputError(f"The physics diverged in all {job.trials} trials; nothing to store. Check the distributions.")
    batches = [
        drawn.get(shard) or scenario.draw_batch(job.seed, indices(job, shard), job.spec) for shard in range(len(parts))
    ]
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves)[stored], *(params for params, _ in batches))
    all_faults = [fault for _, faults in batches for fault in faults]
    faults = [all_faults[index] for index in stored]
    plain = [name for name in parts[0] if name != "wrench" and "." not in name]
    rows = {name: np.concatenate([part[name] for part in parts])[stored] for name in plain}
    recordings = tables.recordings_of(
        job.preset, scenario, rows, _wrench(parts, stored, rows["length"]), stored, faults
    )
    attrs = {
        "frames": tables.frames_of(scenario),
        "simulated": provenance(manifest),
        "diverged": np.flatnonzero(diverged).tolist(),
    }
    if not scenario.recorded:
        attrs["importer"] = "simulation"  # so that thresholds come from the recordings, not from HIRO's preset
    draft = folder / "store.zarr"
    store.write_recordings(
        draft, recordings, attrs, overwrite=True, created=CREATED,
        simulation=tables.simulation_of(scenario, rows, stored, params, faults),
    )  # fmt: skip
    if job.window is not None:
        _write_labels(draft, job, parts, stored)
    return draft


def _write_labels(draft: Path, job: SynthesisConfig, parts: list[shards.Arrays], stored: NDArray[np.int64]) -> None:
    """Add the labels to the store, under the name and with the attributes of ``rcbht encode``."""

    def joined(name: str) -> NDArray[Any]:
        shapes = [part[name].shape for part in parts]
        out = np.zeros((len(stored), *shapes[0][1:-1], max(shape[-1] for shape in shapes)), parts[0][name].dtype)
        row = 0
        for rows, part in _stored_of(parts, stored):
            out[row : row + len(rows), ..., : part[name].shape[-1]] = part[name][rows]
            row += len(rows)
        return out.reshape(-1, 6, out.shape[-1])

    layers = {
        layer: LabelTrack(**{name: joined(f"{layer}.{name}") for name in records.LABEL_FIELDS}) for layer in LAYERS
    }
    config = encoder_config(job)
    attrs = {
        "semantics": "online",
        "window": config.window,
        "config": asdict(config),
        "thresholds": label_limits().tolist(),
    }
    write_tracks(draft, f"online-W{config.window}", LabelTracks(*layers.values()), attrs, created=CREATED)


def _wrench(parts: list[shards.Arrays], stored: NDArray[np.int64], length: NDArray[np.int32]) -> NDArray[np.float32]:
    """All stored trials [trial, time, 6K], padded to the longest of them."""
    out = np.zeros((len(stored), int(length.max()), parts[0]["wrench"].shape[2]), np.float32)
    row = 0
    for rows, part in _stored_of(parts, stored):
        samples = min(out.shape[1], part["wrench"].shape[1])
        for block in blocks(len(rows)):
            out[row + block.start : row + block.stop, :samples] = part["wrench"][rows[block], :samples]
        row += len(rows)
    return out


def _stored_of(
    parts: list[shards.Arrays], stored: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], shards.Arrays]]:
    """Each shard with the rows of its trials that are stored."""
    start = 0
    for part in parts:
        stop = start + len(part["diverged"])
        yield stored[(stored >= start) & (stored < stop)] - start, part
        start = stop
