"""Simulate trials into a store: in shards, resumable, with the same bytes however often it was interrupted.

Each shard is simulated and saved in a work folder beside the target (``sim_mjx.synthesis.shards``); when all are there
they are joined into one store, of which each is a part. A trial depends on seed and index alone, so the shard size
decides only how much an interruption costs and how the files of the store are divided. The store holds no date. Its
group ``simulation/`` has one row per recording: index, fault, failed_in, seated [4], noise_key [2] and the drawn
parameters (``Scenario.parameters``). A two-arm trial is two recordings, right arm and left arm, as the importer stores
them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.atomic import flush_tree
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.types import LabelTracks
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import records, shards
from sim_mjx.synthesis.assemble import Drawn, assemble
from sim_mjx.synthesis.plan import (
    SynthesisConfig,
    check,
    encoder_config,
    indices,
    label_limits,
    manifest_of,
    provenance,
)

Simulate = Callable[[Any], Rollouts]  # a batch of trials of the scenario
Labelled = tuple[Rollouts, LabelTracks | None]
# Default trials per shard: what an interruption costs at most. A GPU needs many to be busy.
SHARD = {"native": 256, "mjx": 8192, "warp": 16384}


@dataclass(frozen=True)
class SynthesisProgress:
    """Progress of a synthesis."""

    done: int  # trials, those of earlier runs included
    total: int  # trials
    per_minute: float  # trials simulated per minute in this run, 0 before the first shard
    seconds_left: float | None  # None before the first shard


@dataclass(frozen=True)
class SynthesisReport:
    """Outcome of a synthesis."""

    stored: int  # trials
    seated: int  # stored trials with all four tabs seated
    diverged: list[int]  # indices of trials that are not stored
    resumed: int  # trials simulated by an earlier run
    faults: dict[str, tuple[int, int]]  # kind -> stored and seated trials


def synthesise(
    target: Path,
    job: SynthesisConfig,
    *,
    overwrite: bool = False,
    simulate: Simulate | None = None,
    progress: Callable[[SynthesisProgress], None] | None = None,
) -> SynthesisReport:
    """Simulate a set of trials into a store; an interrupted run resumes from its finished shards.

    Args:
        target: store to create, for example trials.zarr; the work folder is trials.zarr.work beside it.
        job: what to simulate.
        overwrite: replace an existing store, once the new one is complete.
        simulate: what simulates a batch; default ``job.engine``. A trial's result must not depend on its batch.
        progress: called at the start and after each shard.

    Raises:
        InputError: impossible options, the target exists, the work folder belongs to other options, or all trials
            diverged.
    """
    scenario = check(job)
    folder = shards.folder_of(target)
    manifest = manifest_of(job)
    finished = folder.is_dir() and _is_result(target, manifest)
    store.check_target(target, overwrite or finished)
    with shards.working(folder, manifest):
        resumed = job.trials
        if not finished:
            drawn = _simulate_missing(folder, job, scenario, _labelled(job, scenario, simulate), progress)
            resumed -= sum(len(faults) for _, faults in drawn.values())
            draft = assemble(folder, job, scenario, manifest, drawn)
            store.check_target(target, overwrite)  # again: something may have appeared there meanwhile
            if target.exists():
                target.rename(folder / f"replaced-{time.time_ns()}.zarr")
            draft.rename(target)
            flush_tree(target)  # before the shards are deleted
        shards.remove(folder)
    return _report(target, len(scenario.arms), resumed)


def _is_result(target: Path, manifest: dict[str, Any]) -> bool:
    """Whether the target is complete, made by a run with these options that was killed before it deleted its folder."""
    if not target.exists():
        return False
    try:
        known = store.read_attrs(target).get("simulated")
        store.verify(target)  # a damaged one is no result: its shards are still there
    except InputError:
        return False
    return known is not None and shards.as_json(known) == shards.as_json(provenance(manifest))


def _simulate_missing(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    simulate: Callable[[Any], Labelled],
    progress: Callable[[SynthesisProgress], None] | None,
) -> dict[int, Drawn]:
    """Simulate and save the missing shards; returns what was drawn for each, by number."""
    count = -(-job.trials // job.shard)
    missing = [shard for shard in range(count) if shards.load(folder, shard) is None]
    left = sum(len(indices(job, shard)) for shard in missing)
    resumed = done = job.trials - left
    drawn: dict[int, Drawn] = {}
    start = time.perf_counter()
    if progress is not None:
        progress(SynthesisProgress(done, job.trials, 0.0, None))
    for shard in missing:
        rows = indices(job, shard)
        drawn[shard] = scenario.draw_batch(job.seed, rows, job.spec)
        out, tracks = simulate(drawn[shard][0])
        labels = {} if tracks is None else records.of_labels(tracks, len(out.length))
        shards.save(folder, shard, records.of_trials(out, scenario.recorded) | labels)
        done += len(rows)
        if progress is not None:
            rate = (done - resumed) / (time.perf_counter() - start)
            progress(SynthesisProgress(done, job.trials, 60.0 * rate, (job.trials - done) / rate))
    return drawn


def _labelled(job: SynthesisConfig, scenario: Scenario, simulate: Simulate | None) -> Callable[[Any], Labelled]:
    """What simulates a batch and, if the job has a window, labels it."""
    if simulate is None and job.window is not None:
        config, limits = encoder_config(job), label_limits()
        return partial(records.simulate_labelled, scenario.scene(), engine=job.engine, config=config, limits=limits)
    run = simulate or partial(engines.simulate, scenario.scene(), engine=job.engine)

    def labelled(params: Any) -> Labelled:
        out = run(params)
        return out, None if job.window is None else records.label(out, encoder_config(job), label_limits())

    return labelled


def _report(target: Path, arms: int, resumed: int) -> SynthesisReport:
    """What the finished store holds."""
    simulation = {name: rows[::arms] for name, rows in store.read_simulation(target, "seated", "fault").items()}
    seated, kinds = np.asarray(simulation["seated"].all(1)), simulation["fault"]
    faults = {str(k): (int((kinds == k).sum()), int(seated[kinds == k].sum())) for k in np.unique(kinds)}
    return SynthesisReport(len(seated), int(seated.sum()), store.read_attrs(target)["diverged"], resumed, faults)
