"""One worker of a synthesis: claims missing shards, simulates and saves them until all are there.

Any number of workers, on one machine or on many that share the folder, work on one plan. A shard depends on the plan
alone, so who made it does not matter; claims (:mod:`sim_mjx.synthesis.claims`) only keep two from making the same.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import claims, records, shards
from sim_mjx.synthesis.assemble import Drawn
from sim_mjx.synthesis.plan import SynthesisConfig, indices
from sim_mjx.synthesis.regroup import Shard

TRIES = 3  # of a shard that fails
_LONGEST_WAIT = 2.0  # s between two looks at what others hold

Labelled = tuple[Rollouts, LabelTracks | None]


class ShardsFailed(InputError):
    """Shards that failed as often as they are tried; the others are kept."""

    def __init__(self, folder: Path, job: SynthesisConfig, failed: dict[int, list[claims.Attempt]]) -> None:
        self.failed = failed
        shard, tries = next(iter(failed.items()))
        rows = indices(job, shard)
        super().__init__(
            f"{len(failed)} of {count(job)} shards failed {TRIES} times each and {'is' if len(failed) == 1 else 'are'} "
            f"left out, the first with trials {rows.start} to {rows.stop - 1}: {tries[-1].reason} The others are kept "
            f"in {folder}; the same command tries again."
        )


@dataclass(frozen=True)
class SynthesisProgress:
    """Progress of a synthesis."""

    done: int  # trials, those of earlier runs and of other processes included
    total: int  # trials
    per_minute: float  # trials simulated per minute since this process began, by all; 0 before the first shard
    seconds_left: float | None  # None before the first shard


class Tally:
    """Counts the trials of finished shards and tells ``progress``."""

    def __init__(self, job: SynthesisConfig, present: set[int], progress: Callable[[SynthesisProgress], None] | None):
        self.job, self.progress, self.start = job, progress, time.perf_counter()
        self.resumed = self.done = self._trials(present)
        if progress is not None:
            progress(SynthesisProgress(self.done, job.trials, 0.0, None))

    def show(self, present: set[int]) -> None:
        """These shards are finished now."""
        done = self._trials(present)
        if self.progress is not None and done > self.done:
            rate = (done - self.resumed) / (time.perf_counter() - self.start)
            self.progress(SynthesisProgress(done, self.job.trials, 60.0 * rate, (self.job.trials - done) / rate))
        self.done = max(done, self.done)

    def _trials(self, present: set[int]) -> int:
        return sum(len(indices(self.job, shard)) for shard in present)


def count(job: SynthesisConfig) -> int:
    """Shards of a job."""
    return -(-job.trials // job.shard)


def work(
    folder: Path, job: SynthesisConfig, scenario: Scenario, simulate: Callable[[Any], Labelled], tally: Tally
) -> dict[int, Drawn]:
    """Simulate and save missing shards until all are there, waiting for those that others hold.

    Args:
        folder: the work folder, with its manifest.
        job: what to simulate.
        scenario: of the job.
        simulate: a batch of trials.
        tally: told after each shard.

    Returns:
        what was drawn for the shards of this worker, by number.

    Raises:
        ShardsFailed: all others are there.
    """
    drawn: dict[int, Drawn] = {}
    waits = 0
    while is_open(folder):
        present = shards.finished(folder)
        tally.show(present)
        missing = [shard for shard in range(count(job)) if shard not in present]
        failed = _failed(folder)
        left = [shard for shard in missing if len(failed.get(shard, ())) < TRIES]
        if not left and missing:
            raise ShardsFailed(folder, job, {shard: failed[shard] for shard in missing})
        if not left:
            break
        claimed = _claim(folder, sorted(left, key=lambda shard: len(failed.get(shard, ()))))
        if claimed is None:
            waits += 1
            time.sleep(min(_LONGEST_WAIT, waits * claims.POLL))
            continue
        waits = 0
        shard, claim = claimed
        made = _make(folder, job, scenario, simulate, shard, claim)
        if made is not None:
            drawn[shard] = made
    return drawn


def work_in_lanes(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    stream: Callable[[Iterator[tuple[int, Any]]], Iterator[Shard]],
    tally: Tally,
) -> dict[int, Drawn]:
    """Simulate and save the missing shards that nobody holds, as many at once as a device has lanes for.

    A shard is claimed when lanes become free for its trials, and saved in a thread of its own while others are
    simulated. Shards that fail, or that others hold, are left to :func:`work`.

    Args:
        folder, job, scenario, tally: as in :func:`work`.
        stream: simulates shards (number, parameters), asking for the next one when it has room; returns them in any
            order.

    Returns:
        what was drawn for the shards of this worker, by number.
    """
    held: dict[int, tuple[claims.Claim, Drawn]] = {}
    drawn: dict[int, Drawn] = {}

    def batches() -> Iterator[tuple[int, Any]]:
        while is_open(folder):
            skip = shards.finished(folder) | set(held) | set(drawn) | set(_failed(folder))
            claimed = _claim(folder, [shard for shard in range(count(job)) if shard not in skip])
            if claimed is None:
                return
            shard, claim = claimed
            held[shard] = claim, scenario.draw_batch(job.seed, indices(job, shard), job.spec)
            yield shard, held[shard][1][0]

    def save(made: Shard) -> None:
        shard = int(str(made.key))
        _save(folder, scenario, shard, made.trials, made.tracks)
        claim, drawn[shard] = held[shard]
        claim.done()
        del held[shard]

    try:
        with ThreadPoolExecutor(1) as writer:
            saving: deque[Future[None]] = deque()
            for shard in stream(batches()):
                saving.append(writer.submit(save, shard))
                while saving and (saving[0].done() or len(saving) > 2):  # more would fill the memory
                    saving.popleft().result()
                tally.show(shards.finished(folder))
            while saving:
                saving.popleft().result()
    except Exception as error:
        ours = isinstance(error, InputError | OSError)  # of the input or the machine: it would fail again
        for claim, _ in held.values():
            claim.release() if ours else claim.failed(_reason(error))
        if ours:
            raise
    except BaseException:
        for claim, _ in held.values():
            claim.release()
        raise
    return drawn


def is_open(folder: Path) -> bool:
    """Whether there is something to work on: the plan is there, and nobody joins its shards."""
    return shards.has_plan(folder) and all(
        one.state in ("failed", "released") for one in claims.attempts(folder, "join")
    )


def _failed(folder: Path) -> dict[int, list[claims.Attempt]]:
    """Attempts that failed, by shard."""
    noted = {task: [one for one in tries if one.state == "failed"] for task, tries in claims.board(folder).items()}
    return {int(task): tries for task, tries in noted.items() if tries and task.isdecimal()}


def _claim(folder: Path, missing: list[int]) -> tuple[int, claims.Claim] | None:
    """The first of these shards that nobody holds, claimed."""
    held = {task for task, tries in claims.board(folder).items() if any(one.state == "held" for one in tries)}
    for shard in missing:
        if shards.task(shard) in held:
            continue
        claim = claims.take(folder, shards.task(shard))
        if claim is not None:
            return shard, claim
    return None


def _make(
    folder: Path,
    job: SynthesisConfig,
    scenario: Scenario,
    simulate: Callable[[Any], Labelled],
    shard: int,
    claim: claims.Claim,
) -> Drawn | None:
    """Simulate and save a shard under its claim; None where it failed, or is there already."""
    try:
        if shard in shards.finished(folder) or not is_open(folder):  # since we looked
            claim.done()
            return None
        drawn = scenario.draw_batch(job.seed, indices(job, shard), job.spec)
        out, tracks = simulate(drawn[0])
        _save(folder, scenario, shard, out, tracks)
    except (InputError, OSError):  # of the input or the machine: the next shard would fare no better
        claim.release()
        raise
    except Exception as error:
        claim.failed(_reason(error))
        return None
    except BaseException:
        claim.release()
        raise
    claim.done()
    return drawn


def _save(folder: Path, scenario: Scenario, shard: int, out: Rollouts, tracks: LabelTracks | None) -> None:
    labels = {} if tracks is None else records.of_labels(tracks, len(out.length))
    shards.save(folder, shard, records.of_trials(out, scenario.recorded) | labels)


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split()) or 'no reason given'}".rstrip(".") + "."
