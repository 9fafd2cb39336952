"""One worker of a synthesis: claims missing shards, simulates and writes them until all are there.

Any number of workers, on one machine or on many that share the folder, work on one plan. A shard depends on the plan
alone, so who made it does not matter; claims (:mod:`sim_mjx.synthesis.claims`) only keep two from making the same.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.synthesis import claims, records, shards
from sim_mjx.synthesis.ahead import Ahead
from sim_mjx.synthesis.draft import Draft, Drawn
from sim_mjx.synthesis.plan import SynthesisConfig, indices
from sim_mjx.synthesis.regroup import Shard
from sim_mjx.synthesis.writers import Writers

TRIES = 3  # of a shard that fails
AHEAD = 2  # shards that are drawn before lanes are free for them, unless SHARE allows more
SHARE = 8  # one of so many missing shards, so that at the end no worker holds what another could begin
_LONGEST_WAIT = 2.0  # s between two checks of what others hold

Labelled = tuple[Rollouts, LabelTracks | None]


class ShardsFailed(InputError):
    """Shards that failed as often as they are tried; the others are kept."""

    def __init__(self, draft: Draft, failed: dict[int, list[claims.Attempt]]) -> None:
        self.failed = failed
        shard, tries = next(iter(failed.items()))
        rows = indices(draft.job, shard)
        super().__init__(
            f"{len(failed)} of {draft.shards} shards failed {TRIES} times each and "
            f"{'is' if len(failed) == 1 else 'are'} left out, the first with trials {rows.start} to {rows.stop - 1}: "
            f"{tries[-1].reason} The others are kept "
            f"in {draft.folder}; the same command tries again."
        )


@dataclass(frozen=True)
class SynthesisProgress:
    """Progress of a synthesis."""

    done: int  # trials, those of earlier runs and of other processes included
    total: int  # trials
    per_minute: float  # trials simulated per minute since this process began, by all; 0 before the first shard
    seconds_left: float | None  # None before the first shard


class Tally:
    """Counts the trials of finished shards and calls ``progress``."""

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


def work(draft: Draft, simulate: Callable[[Any], Labelled], tally: Tally) -> int:
    """Simulate and write missing shards until all are there, waiting for those that others hold.

    Args:
        draft: of the store; its work folder has its manifest.
        simulate: a batch of trials.
        tally: called after each shard.

    Returns:
        trials of the shards of this worker.

    Raises:
        ShardsFailed: all others are there.
    """
    made = waits = 0
    folder = draft.folder
    while is_open(folder):
        present = shards.finished(folder)
        tally.show(present)
        missing = [shard for shard in range(draft.shards) if shard not in present]
        failed = _failed(folder)
        left = [shard for shard in missing if len(failed.get(shard, ())) < TRIES]
        if not left and missing:
            raise ShardsFailed(draft, {shard: failed[shard] for shard in missing})
        if not left:
            break
        claimed = _claim(folder, sorted(left, key=lambda shard: len(failed.get(shard, ()))))
        if claimed is None:
            waits += 1
            time.sleep(min(_LONGEST_WAIT, waits * claims.POLL))
            continue
        waits = 0
        made += _make(draft, simulate, *claimed)
    return made


Stream = Callable[[Iterator[tuple[int, Any]], Callable[[], bool], Callable[[], bool]], Iterator[Shard]]


def work_in_lanes(draft: Draft, stream: Stream, lanes: int, tally: Tally, share: int | None = None) -> int:
    """Simulate and write the missing shards that no worker holds, as many at once as a device has lanes for.

    A shard is claimed when lanes become free for its trials, and written beside the simulation of others. Shards
    that fail, or that others hold, are left to :func:`work`.

    Args:
        draft, tally: as in :func:`work`.
        stream: simulates shards (number, parameters), taking the next one when it has room; returns them in any
            order. It also receives two functions: whether the next shard is available without waiting, and whether
            another one can be written at once.
        lanes: trials that it simulates together.
        share: shards that this worker claims before lanes are free for them; those beyond it are left to workers whose
            lanes are free, since a lane that waits for a trial and one that has two last twice as long. None = all.

    Returns:
        trials of the shards of this worker.
    """
    own = _OwnShards(draft)
    fill = -(-lanes // draft.job.shard)

    def ahead(asked: int, coming: int) -> int:
        missing = draft.shards - len(shards.finished(draft.folder)) - len(own.held)
        more = max(AHEAD, min(fill, missing // SHARE)) - coming
        return more if share is None else min(more, share - asked)

    try:
        with Ahead(own.batches(), fill, ahead) as coming, Writers(draft) as writers:
            for made in stream(coming, coming.ready, lambda: own.unwritten() < writers.count):
                own.write(writers, made)
                del made  # it is copied, and not kept until the next shard comes
                own.settle(writers.count)
                tally.show(shards.finished(draft.folder))
            own.settle(0)
    except Exception as error:
        ours = isinstance(error, InputError | OSError)  # of the input or the machine: it would fail again
        for claim, _ in own.held.values():
            claim.release() if ours else claim.failed(_reason(error))
        if ours:
            raise
    except BaseException:
        for claim, _ in own.held.values():
            claim.release()
        raise
    return sum(len(indices(draft.job, shard)) for shard in own.done)


class _OwnShards:
    """The shards of a worker in lanes: claimed, being written, and written."""

    def __init__(self, draft: Draft) -> None:
        self._draft = draft
        self.held: dict[int, tuple[claims.Claim, Drawn]] = {}
        self.done: set[int] = set()
        self._writing: deque[tuple[int, Future[None]]] = deque()

    def batches(self) -> Iterator[tuple[int, Any]]:
        """Claim missing shards that no worker holds; numbers and parameters of those that can be drawn."""
        folder = self._draft.folder
        while is_open(folder):
            skip = shards.finished(folder) | set(self.held) | self.done | set(_failed(folder))
            claimed = _claim(folder, [shard for shard in range(self._draft.shards) if shard not in skip])
            if claimed is None:
                return
            shard, claim = claimed
            try:
                drawn = self._draft.draw(shard)
            except OSError:  # of the machine: the next shard would fail, too
                claim.release()
                raise
            except Exception as error:
                claim.failed(_reason(error))
                continue
            except BaseException:
                claim.release()
                raise
            self.held[shard] = claim, drawn
            yield shard, drawn[0]

    def write(self, writers: Writers, made: Shard) -> None:
        """Begin to write a simulated shard."""
        shard = int(str(made.key))
        drawn = self.held[shard][1]
        labels = None if made.tracks is None else records.of_labels(made.tracks, len(drawn[1]))
        self._writing.append((shard, writers.submit(shard, drawn, made.rows, labels)))

    def unwritten(self) -> int:
        """Shards that are being written."""
        return sum(not written.done() for _, written in self._writing)

    def settle(self, most: int) -> None:
        """Give back the claims of shards that are written, waiting until at most so many are not."""
        while self._writing and (self._writing[0][1].done() or len(self._writing) > most):  # more would fill the memory
            shard, written = self._writing.popleft()
            written.result()
            self.done.add(shard)
            self.held.pop(shard)[0].done()


def is_open(folder: Path) -> bool:
    """Whether shards may be made: the manifest is there, and no process completes the store."""
    return shards.has_plan(folder) and all(
        one.state in ("failed", "released") for one in claims.attempts(folder, "join")
    )


def _failed(folder: Path) -> dict[int, list[claims.Attempt]]:
    """Attempts that failed, by shard."""
    noted = {task: [one for one in tries if one.state == "failed"] for task, tries in claims.board(folder).items()}
    return {int(task): tries for task, tries in noted.items() if tries and task.isdecimal()}


def _claim(folder: Path, missing: list[int]) -> tuple[int, claims.Claim] | None:
    """Claim the first of these shards that no worker holds."""
    held = {task for task, tries in claims.board(folder).items() if any(one.state == "held" for one in tries)}
    for shard in missing:
        if shards.task(shard) in held:
            continue
        claim = claims.take(folder, shards.task(shard))
        if claim is not None:
            return shard, claim
    return None


def _make(draft: Draft, simulate: Callable[[Any], Labelled], shard: int, claim: claims.Claim) -> int:
    """Simulate and write a shard under its claim; 0 trials where it failed, or is there already."""
    try:
        if shard in shards.finished(draft.folder) or not is_open(draft.folder):  # since it was chosen
            claim.done()
            return 0
        try:
            drawn = draft.draw(shard)
        except InputError as error:  # of one of its trials: the first trial of the job could be drawn
            claim.failed(_reason(error))
            return 0
        out, tracks = simulate(drawn[0])
        labels = None if tracks is None else records.of_labels(tracks, len(drawn[1]))
        draft.write(shard, drawn, records.of_trials(out, draft.scenario.recorded), labels)
    except (InputError, OSError):  # of the input or the machine: the next shard would fail, too
        claim.release()
        raise
    except Exception as error:
        claim.failed(_reason(error))
        return 0
    except BaseException:
        claim.release()
        raise
    claim.done()
    return len(drawn[1])


def _reason(error: Exception) -> str:
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split()) or 'no reason given'}".rstrip(".") + "."
