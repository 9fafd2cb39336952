"""Join the shards of a synthesis into one store, shard by shard: each is a part of it, and one is in memory at a time.

Every trial has its place from the start. One that diverged keeps it, as a row of length 0 that readers leave out.
"""

from __future__ import annotations

import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from rcbht_jax.errors import InputError
from rcbht_jax.io import label_parts, store_writer
from rcbht_jax.io.parts import Layout
from rcbht_jax.io.store_schema import schema_of
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
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
    draft = folder / "store.zarr"
    if draft.exists():  # of a run that was interrupted while it joined them
        shutil.rmtree(draft)
    diverged: list[int] = []
    for shard in range(-(-job.trials // job.shard)):
        arrays = shards.load(folder, shard)
        if arrays is None:
            raise InputError(f"A shard in {folder} was damaged just now; run the same command again.")
        batch = drawn.get(shard) or scenario.draw_batch(job.seed, indices(job, shard), job.spec)
        write_shard(draft, job, scenario, manifest, shard, batch, arrays)
        diverged += (indices(job, shard).start + np.flatnonzero(arrays["diverged"])).tolist()
    if len(diverged) == job.trials:
        raise InputError(f"The physics diverged in all {job.trials} trials; nothing to store. Check the distributions.")
    if job.window is not None:
        label_parts.finish(_labels_of(draft, job))
    store_writer.finish(draft, {"diverged": diverged})
    return draft


def write_shard(
    draft: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    manifest: dict[str, Any],
    shard: int,
    drawn: Drawn,
    arrays: shards.Arrays,
) -> None:
    """Write a shard to its place in the draft of the store, which the first one creates.

    Args:
        draft: the store that is being written.
        job: what is simulated. scenario: likewise. manifest: of the job.
        shard: its number.
        drawn: parameters and faults of its trials.
        arrays: of :func:`records.of_trials` and :func:`records.of_labels`.
    """
    (params, faults), index = drawn, np.array(indices(job, shard))
    plain = {name: values for name, values in arrays.items() if "." not in name}
    rows = _without(plain, arrays["diverged"])
    recordings = tables.recordings_of(job.preset, scenario, rows, rows["wrench"], index, faults)
    recordings = replace(recordings, outcome=np.where(recordings.length == 0, "diverged", recordings.outcome))
    simulation = tables.simulation_of(scenario, rows, index, params, faults)
    tracks = None if job.window is None else _labels(arrays)
    arms = len(scenario.arms)
    layout = Layout(job.trials * arms, min(job.shard, job.trials) * arms)
    if not draft.exists():
        _create(draft, job, scenario, manifest, layout, recordings, simulation, tracks)
    if tracks is not None:
        label_parts.write_part(_labels_of(draft, job), shard, tracks)
    store_writer.write_part(draft, shard, recordings, simulation)


def _create(
    draft: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    manifest: dict[str, Any],
    layout: Layout,
    recordings: Recordings,
    simulation: shards.Arrays,
    tracks: LabelTracks | None,
) -> None:
    attrs: dict[str, Any] = {"frames": tables.frames_of(scenario), "simulated": provenance(manifest)}
    if not scenario.recorded:
        attrs["importer"] = "simulation"  # so that thresholds come from the recordings, not from HIRO's preset
    schema = schema_of(recordings, simulation, layout.rows, layout.part)
    store_writer.create(draft, schema, attrs, CREATED)
    if tracks is not None:
        config = encoder_config(job)
        how = {  # as "rcbht encode" says it
            "semantics": "online",
            "window": config.window,
            "config": asdict(config),
            "thresholds": label_limits().tolist(),
        }
        label_parts.create_in(draft, _labels_of(draft, job).name, layout, tracks, how, created=CREATED)


def _labels_of(draft: Path, job: SynthesisConfig) -> Path:
    return draft / "labels" / f"online-W{job.window}"


def _without(rows: shards.Arrays, diverged: Bool[np.ndarray, " trial"]) -> shards.Arrays:
    """The arrays of a shard with nothing in the rows of diverged trials, as long as the longest of the others."""
    empty = {"length": 0, "wrench": 0, "onset": np.nan, "onset_harmonised": np.nan, "note": "", "seated": False}
    out = dict(rows)
    if diverged.any():
        for name, nothing in empty.items():
            out[name] = out[name].copy()
            out[name][diverged] = nothing
    return out | {"wrench": out["wrench"][:, : max(1, int(out["length"].max()))]}


def _labels(arrays: shards.Arrays) -> LabelTracks:
    """The labels ``[recording, 6, slot]`` of a shard, none in the rows of diverged trials."""
    layers = []
    for layer in LAYERS:
        found = {name: arrays[f"{layer}.{name}"] for name in records.LABEL_FIELDS}
        kept = ~arrays["diverged"][:, None, None, None]
        made = {name: np.where(kept, values, np.zeros((), values.dtype)) for name, values in found.items()}
        layers.append(LabelTrack(**{name: v.reshape(-1, 6, v.shape[-1]) for name, v in made.items()}))
    return LabelTracks(*layers)
