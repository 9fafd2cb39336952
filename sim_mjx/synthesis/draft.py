"""The store that a synthesis makes: each shard is written once, to its place, by the process that has simulated it.

Every trial has its place from the start. One that diverged keeps it, as a row of length 0 that readers leave out.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from rcbht_jax._util.atomic import draft_of
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_parts, parts, store_writer
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.parts import Layout, Part
from rcbht_jax.io.store_schema import schema_of
from rcbht_jax.labels import LAYERS
from rcbht_jax.robots.snap_assembly import FRAMES
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings
from sim_mjx.randomization.trials import Fault
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import descriptions, records, shards, tables
from sim_mjx.synthesis.plan import SynthesisConfig, indices, label_attrs, provenance
from sim_mjx.synthesis.records import Arrays

Drawn = tuple[Any, list[Fault]]  # parameters of a shard's trials, and their faults
CREATED = "undated"  # a date would make every store different


@dataclass(frozen=True)
class Draft:
    """The store of a job in its work folder, on the way to its completion.

    Attributes:
        folder: the work folder, which holds the manifest.
        job: what is simulated.
        scenario: of the job.
        manifest: of the job.
    """

    folder: Path
    job: SynthesisConfig
    scenario: Scenario
    manifest: Mapping[str, Any]

    @property
    def path(self) -> Path:
        """The store."""
        return shards.store_of(self.folder)

    @property
    def shards(self) -> int:
        """Number of shards of the job."""
        return -(-self.job.trials // self.job.shard)

    def draw(self, shard: int) -> Drawn:
        """Parameters and faults of the trials of a shard."""
        return self._drawn(shard, self.job.spec)

    def _drawn(self, shard: int, spec: Any) -> Drawn:
        return self.scenario.draw_batch(self.job.seed, indices(self.job, shard), spec)

    def write(self, shard: int, drawn: Drawn, arrays: Arrays, labels: Arrays | None) -> None:
        """Write a shard to its place. Any process may write any shard; arguments as of :meth:`parts_of`."""
        parts.put(self.path, self.parts_of(shard, drawn, arrays, labels))

    def parts_of(self, shard: int, drawn: Drawn, arrays: Arrays, labels: Arrays | None) -> list[Part]:
        """The parts of the store that a shard makes; creates the store if there is none.

        Args:
            shard: its number.
            drawn: of :meth:`draw`.
            arrays: of its trials, as of :func:`sim_mjx.synthesis.records.of_trials`.
            labels: of its trials, as of :func:`sim_mjx.synthesis.records.of_labels`, if the job has a window.
        """
        (params, faults), index = drawn, np.array(indices(self.job, shard))
        rows = _without(arrays, arrays["diverged"])
        spec = self.job.spec
        whole = params if spec.longest is None else self._drawn(shard, replace(spec, longest=None))[0]
        outcome = tables.outcomes(self.scenario, rows, whole, spec.longest)
        recordings = tables.recordings_of(self.job.preset, self.scenario, rows, index, faults, outcome)
        recordings = replace(recordings, outcome=np.where(recordings.length == 0, "diverged", recordings.outcome))
        simulation = tables.simulation_of(self.scenario, rows, index, params, faults, outcome)
        tracks = None if labels is None else _labels(labels, arrays["diverged"])
        if not self.path.exists():
            self._create(recordings, simulation, tracks)
        labelled = [] if tracks is None else [label_parts.part_of(self._labels, shard, tracks)]
        return [*labelled, *store_writer.parts_of(self.path, shard, recordings, simulation)]

    def finish(self) -> None:
        """Complete the store, all of whose shards are written, and flush it to disk.

        Raises:
            InputError: the physics diverged in all trials.
        """
        with zarr_io.reading(self.path):
            lengths = zarr_io.read_array(zarr_io.open_group(self.path), "length", "int32")
        diverged = np.flatnonzero(lengths[:: len(self.scenario.arms)] == 0).tolist()
        if len(diverged) == self.job.trials:
            raise InputError(
                "The physics diverged in every trial; nothing to store. Check the distributions and, of an assembly of "
                "your own, what its controller commands."
            )
        if self.job.window is not None:
            label_parts.finish(self._labels, self.path)
        store_writer.finish(self.path, {descriptions.DIVERGED: diverged})
        parts.flush_rest(self.path)  # parts were flushed as they were written

    @property
    def _labels(self) -> Path:
        return self.path / "labels" / f"online-W{self.job.window}"

    def _create(self, recordings: Recordings, simulation: Arrays, tracks: LabelTracks | None) -> None:
        """Create the empty store, unless another process has."""
        empty, arms = draft_of(self.path), len(self.scenario.arms)
        attrs: dict[str, Any] = {"frames": FRAMES, "simulated": provenance(self.manifest)}
        if not self.scenario.recorded:  # thresholds then come from the recordings, not from HIRO's preset
            attrs |= {"frames": tables.WORLD, "importer": "simulation"}
        layout = Layout(self.job.trials * arms, min(self.job.shard, self.job.trials) * arms)
        try:
            schema = schema_of(recordings, simulation, layout.rows, layout.part)
            store_writer.create(empty, schema, attrs, CREATED)
            if tracks is not None:
                label_parts.require_group(empty)
                own = empty / self._labels.relative_to(self.path)
                label_parts.create(own, layout, tracks, label_attrs(self.job), created=CREATED)
            descriptions.keep(self.folder, empty)
            empty.rename(self.path)
        except OSError:
            if not self.path.exists():  # else another one was first
                raise
        finally:
            shutil.rmtree(empty, ignore_errors=True)


def _without(rows: Arrays, diverged: Bool[np.ndarray, " trial"]) -> Arrays:
    """The arrays of a shard with empty rows for diverged trials, as long as the longest of the others."""
    empty = {
        "length": 0, "wrench": 0, "onset": np.nan, "onset_harmonised": np.nan, "note": "", "seated": False, "passes": 0,
    }  # fmt: skip
    out = dict(rows)
    if diverged.any():
        for name, nothing in empty.items():
            out[name] = out[name].copy()
            out[name][diverged] = nothing
    return out | {"wrench": out["wrench"][:, : max(1, int(out["length"].max()))]}


def _labels(arrays: Arrays, diverged: Bool[np.ndarray, " trial"]) -> LabelTracks:
    """The labels ``[recording, 6, slot]`` of a shard, none in the rows of diverged trials."""
    layers = []
    for layer in LAYERS:
        made = {name: arrays[f"{layer}.{name}"] for name in records.LABEL_FIELDS}
        if diverged.any():
            gone = diverged[:, None, None, None]
            made = {name: np.where(gone, np.zeros((), values.dtype), values) for name, values in made.items()}
        layers.append(LabelTrack(**{name: v.reshape(-1, 6, v.shape[-1]) for name, v in made.items()}))
    return LabelTracks(*layers)
