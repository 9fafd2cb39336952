"""Simulate trials into a store: in shards, by any number of workers, resumable, with the same bytes in every case.

The store grows in a work folder beside the target (``sim_mjx.synthesis.shards``); each shard is a part of the store.
When all shards are there, the store is completed and moved to the target. A trial depends on seed and index alone, so
the shard size decides only how much an interruption costs and how the files of the store are divided. (Processors of
another kind give other bytes, and a GPU does so each time.) The store holds no date. Its group ``simulation/`` has one
row per recording: index, fault, failed_in, seated [4], noise_key [2] and the drawn parameters
(``Scenario.parameters``). Passes of tabs are a track of annotations (``sim_mjx.synthesis.passes``). A two-arm trial is
two recordings, right arm and left arm, as the importer stores them.

Processes with the same job and target share the work (``sim_mjx.synthesis.workers``), on one machine or on several that
see the same folder. The last one completes the store.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from rcbht_jax._util.atomic import Identity, identity
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import claims, records, shards, workers
from sim_mjx.synthesis.batches import Halving
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.plan import SynthesisConfig, check, encoder_config, label_limits, manifest_of, provenance
from sim_mjx.synthesis.regroup import Shard
from sim_mjx.synthesis.workers import Labelled, SynthesisProgress, Tally

Simulate = Callable[[Any], Rollouts]  # a batch of trials of the scenario
# Starts workers in other processes and waits for them; calls its argument now and then.
Helpers = Callable[[Callable[[], None]], None]
LANES = {
    "mjx": 8192,
    "warp": 32768,
    "fused": 32768,
}  # most trials that a device steps together, of as many shards as it takes
GROUP = 256  # trials that leave a device together, with half a megabyte each that waits on the host
LANE = 2 << 20  # bytes of a device's memory, of which the logs of 60 s and the physics need half


@dataclass(frozen=True)
class SynthesisReport:
    """Outcome of a synthesis."""

    stored: int  # trials
    seated: int  # stored trials with all four tabs seated
    diverged: list[int]  # indices of trials that are not stored
    resumed: int  # trials simulated before this process began
    faults: dict[str, tuple[int, int]]  # kind -> stored and seated trials


def synthesise(
    target: Path,
    job: SynthesisConfig,
    *,
    overwrite: bool = False,
    simulate: Simulate | None = None,
    progress: Callable[[SynthesisProgress], None] | None = None,
    notice: Callable[[str], None] | None = None,
    helpers: Helpers | None = None,
    lanes: int | None = None,
    ready: Callable[[Path], object] | None = None,
) -> SynthesisReport:
    """Simulate a set of trials into a store; an interrupted run resumes from its finished shards.

    Processes that are called with the same target and job at the same time share the work; all return when it is done.

    Args:
        target: store to create, for example trials.zarr; the work folder is trials.zarr.work beside it.
        job: what to simulate.
        overwrite: replace the store that is there now, once the new one is complete.
        simulate: what simulates a batch; default ``job.engine``. A trial's result must not depend on its batch.
        progress: called at the start and after each shard.
        notice: called with a sentence that the user should read, for example that a batch was halved.
        helpers: starts other workers of the same job and waits for them; this process does the remaining work.
        lanes: largest number of trials that a device steps together; the number of trials, the device's memory and
            ``LANES`` also limit it. Default: only these limits.
        ready: called with the complete store before it takes its place; what it raises keeps the store that is there.

    Raises:
        InputError: impossible options, the target exists, the work folder belongs to other options, shards failed
            (:class:`sim_mjx.synthesis.workers.ShardsFailed`), or all trials diverged.
    """
    scenario, before = check(job), identity(target)
    _check_lanes(lanes)
    folder = shards.folder_of(target)
    manifest = manifest_of(job)
    finished = folder.is_dir() and _is_result(target, manifest)
    store.check_target(target, overwrite or finished)
    shards.begin(folder, manifest)
    if not finished:
        shards.renew(folder, notice)
    draft = Draft(folder, job, scenario, manifest)
    everything = set(range(draft.shards))
    tally = Tally(job, everything if finished else shards.finished(folder), progress)
    if not finished:
        if helpers is not None:
            helpers(lambda: tally.show(shards.finished(folder)))
        # to ask a device for its memory takes seconds; without a plan another process has completed the store
        if shards.has_plan(folder) and shards.finished(folder) != everything:
            _work(draft, simulate, tally, notice, lanes)
    with claims.wait_for(folder, "join") as ours:
        if ours and shards.has_plan(folder):
            if finished:
                shards.remove(folder)
            else:
                _complete(target, draft, before if overwrite else None, ready)
    shards.close(folder)
    if not _is_made_by(target, manifest):
        raise InputError(f"{folder} was removed while its trials were simulated; run the same command again.")
    tally.show(everything)  # other processes may have made the last ones
    return _report(target, len(scenario.arms), tally.resumed)


def earlier(target: Path, job: SynthesisConfig) -> SynthesisReport | None:
    """What :func:`synthesise` returned when it completed the store of a job; None = the store is not that.

    Raises:
        InputError: impossible options.
    """
    scenario = check(job)
    if shards.folder_of(target).is_dir() or not _is_made_by(target, manifest_of(job)):
        return None
    return _report(target, len(scenario.arms), job.trials)


def work_on(
    target: Path,
    job: SynthesisConfig,
    *,
    simulate: Simulate | None = None,
    progress: Callable[[SynthesisProgress], None] | None = None,
    notice: Callable[[str], None] | None = None,
    lanes: int | None = None,
) -> tuple[int, bool]:
    """Run one worker of a job, which it starts if no other has; the last worker completes the store.

    If the store is complete, there is nothing to do. An existing store is never replaced here: if a run with
    ``overwrite`` replaces it, that run completes the new one.

    Args:
        target, job, simulate, progress, notice, lanes: as in :func:`synthesise`.

    Returns:
        trials that this worker simulated, and whether the store is complete.

    Raises:
        InputError: as in :func:`synthesise`, but failed shards are not tried again.
    """
    scenario = check(job)
    _check_lanes(lanes)
    folder, manifest = shards.folder_of(target), manifest_of(job)
    if not folder.is_dir():
        if _is_made_by(target, manifest):
            return 0, True
        store.check_target(target, False)
    shards.begin(folder, manifest)
    draft = Draft(folder, job, scenario, manifest)
    share = None if lanes is None else -(-lanes // job.shard)
    made = _work(draft, simulate, Tally(job, shards.finished(folder), progress), notice, lanes, share)
    claim = claims.take(folder, "join")
    if claim is not None:
        try:
            if shards.has_plan(folder) and not target.exists():
                _complete(target, draft, None)
        finally:
            claim.release()
        shards.close(folder)
    return made, _is_made_by(target, manifest)


def _check_lanes(lanes: int | None) -> None:
    if lanes is not None and lanes < 1:
        raise InputError(f"The number of lanes is {lanes}; expected 1 or more.")


def _complete(target: Path, draft: Draft, old: Identity, ready: Callable[[Path], object] | None = None) -> None:
    """Have the store at its place, complete, where it replaces only ``old``; the caller holds the claim "join"."""
    if _is_still(target, old) or not _is_result(target, draft.manifest):  # which another made, and was killed then
        draft.finish()
        if ready is not None:
            ready(draft.path)
        store.check_target(target, _is_still(target, old))  # what appeared there meanwhile is kept
        if target.exists():
            target.rename(draft.folder / f"replaced-{time.time_ns()}.zarr")
        draft.path.rename(target)
    shards.remove(draft.folder)


def _is_still(target: Path, old: Identity) -> bool:
    return old is not None and identity(target) == old


def _is_result(target: Path, manifest: Mapping[str, Any]) -> bool:
    """Whether the target is complete, made by a run with these options that was killed before it deleted its folder."""
    if not _is_made_by(target, manifest):
        return False
    try:
        store.verify(target)  # a damaged one is no result: its shards are still there
    except InputError:
        return False
    return True


def _is_made_by(target: Path, manifest: Mapping[str, Any]) -> bool:
    """Whether the target is a store whose attributes state that it was made with these options."""
    if not target.exists():
        return False
    try:
        known = store.read_attrs(target).get("simulated")
    except InputError:
        return False
    return known is not None and shards.as_json(known) == shards.as_json(provenance(manifest))


def _work(
    draft: Draft,
    simulate: Simulate | None,
    tally: Tally,
    notice: Callable[[str], None] | None,
    lanes: int | None,
    share: int | None = None,
) -> int:
    """Simulate and write the missing shards: on a device as its lanes become free, and what is left by batches."""
    made, job, scenario = 0, draft.job, draft.scenario
    if simulate is None and job.engine in LANES:
        count = lanes_for(min(lanes or job.trials, job.trials), job.engine)
        labels = (None, None) if job.window is None else (encoder_config(job), label_limits())
        scene = scenario.scene()

        def stream(
            batches: Iterator[tuple[int, Any]], ready: Callable[[], bool], room: Callable[[], bool]
        ) -> Iterator[Shard]:
            from sim_mjx.synthesis.in_lanes import simulate_in_lanes  # MJX takes seconds to import

            at_once = min(max(job.shard, GROUP), count)
            return simulate_in_lanes(
                scene, batches, job.engine, count, at_once, *labels,
                recorded=scenario.recorded, ready=ready, room=room,
            )  # fmt: skip

        made = workers.work_in_lanes(draft, stream, count, tally, share)
    return made + workers.work(draft, Halving(_labelled(job, scenario, simulate), notice), tally)


def lanes_for(trials: int, engine: str) -> int:
    """Number of lanes for this many trials on JAX's default device."""
    memory = (jax.devices()[0].memory_stats() or {}).get("bytes_limit")  # a CPU reports none
    return balanced(trials, LANES[engine], memory)


def balanced(trials: int, most: int, memory: int | None) -> int:
    """Number of lanes for this many trials of similar length, so that every wave of trials has the same size.

    Args:
        trials: 1 or more.
        most: largest number of lanes.
        memory: memory of the device in bytes; ``None`` = enough.

    >>> balanced(10_000, 32_768, None), balanced(100_000, 32_768, None), balanced(100_000, 32_768, 24 << 30)
    (10000, 25000, 11112)
    """
    if memory is not None:
        most = max(1, min(most, memory // LANE))
    return -(-trials // -(-trials // most))


def _labelled(job: SynthesisConfig, scenario: Scenario, simulate: Simulate | None) -> Callable[[Any], Labelled]:
    """What simulates a batch and, if the job has a window, labels it."""
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
