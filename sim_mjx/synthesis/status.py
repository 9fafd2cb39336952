"""Progress of a synthesis, read from its work folder without disturbing its workers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import load_json
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from sim_mjx.synthesis import claims, shards
from sim_mjx.synthesis.workers import TRIES

WINDOW = 600.0  # s, of the last shards, over which the rate is taken


@dataclass(frozen=True)
class Worker:
    """One active worker."""

    host: str
    pid: int
    shard: int | None  # None = completes the store, or begins
    seconds: float  # since its last sign of life


@dataclass(frozen=True)
class Failure:
    """A shard that failed and is not finished yet."""

    shard: int
    tries: int  # all attempts, those of killed workers included
    failed: int  # attempts that ended with an error
    reason: str  # of the last one that failed
    left_out: bool  # not tried any more


@dataclass(frozen=True)
class SynthesisStatus:
    """Progress of a synthesis."""

    complete: bool  # the store is there and the work folder gone
    trials: int
    done: int  # trials in finished shards
    shards: int
    shards_done: int
    per_minute: float | None  # trials of the last ten minutes' shards; None = too few, or no active worker
    workers: list[Worker]
    failures: list[Failure]
    killed: list[int]  # shards whose last worker died and that no other has taken over


def status_of(target: Path) -> SynthesisStatus:
    """Progress of the synthesis of a store.

    Args:
        target: the store that is being made, or is there.

    Raises:
        InputError: there is neither a store nor a work folder.
    """
    folder = shards.folder_of(target)
    try:
        present, board = shards.finished(folder), claims.board(folder)
        job = load_json(folder / shards.MANIFEST)["job"]
    except FileNotFoundError:
        return _complete(target)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder / shards.MANIFEST} is damaged; delete {folder} to begin anew.") from error
    trials, size = int(job["trials"]), int(job["shard"])
    claimed = {int(task): tries for task, tries in sorted(board.items()) if task.isdecimal()}
    left = {shard: tries for shard, tries in claimed.items() if shard not in present}
    workers = [
        Worker(one.host, one.pid, int(task) if task.isdecimal() else None, one.seconds)
        for task, tries in sorted(board.items())
        for one in tries
        if one.state == "held"
    ]
    return SynthesisStatus(
        complete=False,
        trials=trials,
        done=sum(min(size, trials - shard * size) for shard in present),
        shards=-(-trials // size),
        shards_done=len(present),
        per_minute=_rate(folder, size) if any(one.shard is not None for one in workers) else None,
        workers=workers,
        failures=[
            _failure(shard, tries) for shard, tries in left.items() if any(one.state == "failed" for one in tries)
        ],
        killed=[shard for shard, tries in left.items() if tries[-1].state == "dead"],
    )


def check_finished(path: Path) -> None:
    """Refuse a store that a synthesis has begun and not finished, at its place or in the work folder.

    Raises:
        InputError: says how much of it is there, and what shows its progress and resumes it.
    """
    target = shards.target_of(path)
    if target == path and (path.exists() or not shards.has_plan(shards.folder_of(path))):
        return
    now, state = status_of(target), "still being written" if path.exists() else "not finished"
    raise InputError(
        f"{path} is {state}: {now.shards_done} of {plural(now.shards, 'part')} are there; "
        f'"rcbht simulate {target} --status" shows its progress, and without --status, but with the options of before, '
        "it is resumed."
    )


def _complete(target: Path) -> SynthesisStatus:
    if not target.exists():
        raise InputError(f'There is no {target} yet, nor a part of it; make it with "rcbht simulate {target}".')
    known: dict[str, Any] = store.read_attrs(target).get("simulated") or {}
    trials = int(known.get("job", {}).get("trials", 0))
    if not trials:
        raise InputError(f'{target} was not made by "rcbht simulate"; it has no progress to show.')
    return SynthesisStatus(True, trials, trials, 0, 0, None, [], [], [])


def _failure(shard: int, tries: list[claims.Attempt]) -> Failure:
    failed = [one for one in tries if one.state == "failed"]
    return Failure(shard, len(tries), len(failed), failed[-1].reason, len(failed) >= TRIES)


def _rate(folder: Path, size: int) -> float | None:
    """Trials per minute from the times at which shards were saved, the first of which only begins the interval."""
    times = shards.finished_at(folder)
    if not times:
        return None
    recent = np.array(times)
    recent = recent[recent >= recent[-1] - WINDOW]
    seconds = float(recent[-1] - recent[0])
    return 60.0 * size * (len(recent) - 1) / seconds if seconds > 0 else None
