"""Several workers on one job: the same bytes as one, nothing made twice but what was in flight, failures told."""

from __future__ import annotations

import collections
import errno
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import claims, pipeline, plan, shards, workers
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.pipeline import synthesise, work_on
from sim_mjx.synthesis.status import status_of
from tests.support.fake_simulation import SHARDED, SMALL, fake_engine, logging_engine, tree

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of SHARDED, by one worker."""
    target = tmp_path_factory.mktemp("whole") / "trials.zarr"
    synthesise(target, SHARDED, simulate=fake_engine)
    return tree(target)


def calls(log: Path) -> dict[str, list[int]]:
    """Processes that simulated each shard, by the key of its first trial."""
    found = collections.defaultdict(list)
    for line in log.read_text().splitlines():
        pid, _, key = line.partition(" ")
        found[key].append(int(pid))
    return dict(found)


def start(target: Path, log: Path) -> subprocess.Popen[bytes]:
    """A worker, once it is about to begin."""
    script = str(ROOT / "tests/support/fake_simulation.py")
    child = subprocess.Popen([sys.executable, script, str(target), str(log)], cwd=ROOT, stdout=subprocess.PIPE)
    assert child.stdout is not None
    with child.stdout as said:
        assert said.readline() == b"working\n"
    return child


def test_workers_killed_at_random_moments_give_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    target, log, rng = tmp_path / "trials.zarr", tmp_path / "log", random.Random(3)
    team, killed = [start(target, log) for _ in range(2)], set()
    for _ in range(4):
        time.sleep(rng.uniform(0.1, 0.6))
        victim = team.pop(rng.randrange(len(team)))
        victim.send_signal(signal.SIGKILL)
        if victim.wait() == -signal.SIGKILL:
            killed.add(victim.pid)
        team.append(start(target, log))
    assert [worker.wait() for worker in team] == [0, 0]
    assert len(killed) >= 3
    assert tree(target) == whole
    assert sorted(os.listdir(tmp_path)) == ["log", "trials.zarr"]
    made = calls(log)
    assert len(made) == 30
    assert {pid for pids in made.values() for pid in pids[:-1]} <= killed  # in flight when they died
    assert sum(len(pids) - 1 for pids in made.values()) <= len(killed)


def test_the_same_command_called_twice_shares_the_work(tmp_path: Path, whole: dict[str, bytes]) -> None:
    target, logs = tmp_path / "trials.zarr", [tmp_path / "a", tmp_path / "b"]
    with ThreadPoolExecutor() as pool:
        reports = list(pool.map(lambda log: synthesise(target, SHARDED, simulate=logging_engine(log, 0.05)), logs))
    assert [report.stored for report in reports] == [60, 60]
    assert tree(target) == whole
    both = [set(calls(log)) for log in logs]
    assert not both[0] & both[1]
    assert len(both[0] | both[1]) == 30
    assert min(map(len, both)) > 5
    assert sorted(os.listdir(tmp_path)) == ["a", "b", "trials.zarr"]


def test_a_worker_ends_when_another_joins_and_finds_nothing_to_do_later(tmp_path: Path) -> None:
    target = tmp_path / "t.zarr"
    assert work_on(target, SMALL, simulate=fake_engine) == (12, True)
    before = tree(target)
    assert work_on(target, SMALL, simulate=lambda _: pytest.fail("simulated again")) == (0, True)
    with pytest.raises(InputError, match="exists already"):
        work_on(target, replace(SMALL, seed=6), simulate=fake_engine)
    assert tree(tmp_path) == {f"t.zarr/{name}": data for name, data in before.items()}


def test_a_worker_never_replaces_a_store(tmp_path: Path, whole: dict[str, bytes]) -> None:
    """The run that may replace it joins the shards of its workers."""
    target = tmp_path / "t.zarr"
    synthesise(target, SMALL, simulate=fake_engine)

    def helpers(look: Any) -> None:
        assert work_on(target, SHARDED, simulate=fake_engine) == (60, False)
        assert len(tree(target)) > 0
        look()

    report = synthesise(
        target, SHARDED, overwrite=True, simulate=lambda _: pytest.fail("done already"), helpers=helpers
    )
    assert report.stored == 60
    assert tree(target) == whole


def test_a_store_that_its_workers_completed_is_not_worked_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is a GPU, asking it for memory would take seconds."""
    target = tmp_path / "t.zarr"

    def helpers(_: Any) -> None:
        assert work_on(target, SMALL, simulate=fake_engine) == (12, True)
        monkeypatch.setattr(pipeline, "_work", lambda *_: pytest.fail("worked on"))

    assert synthesise(target, SMALL, helpers=helpers).stored == 12


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_another_has_joined_is_not_joined_again(
    overwrite: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other has deleted shards and manifest, but not yet the folder."""
    target = tmp_path / "t.zarr"

    def helpers(_: Any) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(shards, "close", lambda _: None)
            synthesise(target, SMALL, simulate=fake_engine)
        assert os.listdir(shards.folder_of(target)) == [claims.FOLDER]

    failing = lambda _: pytest.fail("simulated again")  # noqa: E731
    assert synthesise(target, SMALL, simulate=failing, helpers=helpers, overwrite=overwrite).stored == 12
    assert os.listdir(tmp_path) == ["t.zarr"]


def test_workers_of_other_options_or_code_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "t.zarr"

    def second(params: TrialParams) -> Rollouts:
        with pytest.raises(InputError, match="--seed 5, not 6"):
            work_on(target, replace(SMALL, seed=6), simulate=fake_engine)
        with monkeypatch.context() as patch:
            patch.setattr(plan, "code_hash", lambda: "other")
            with pytest.raises(InputError, match=r"the simulation's code \(sim_mjx_sha256\)"):
                synthesise(target, SMALL, simulate=fake_engine)
        return fake_engine(params)

    assert synthesise(target, SMALL, simulate=second).stored == 12


def failing(shard: int, times: int, seen: list[int]) -> Any:
    """The engine, which fails so often at a shard of SMALL."""
    first = get_scenario("B").draw_batch(5, plan.indices(SMALL, shard), SMALL.spec)[0].seed[0]

    def engine(params: TrialParams) -> Rollouts:
        if np.array_equal(params.seed[0], first):
            seen.append(shard)
            if len(seen) <= times:
                raise RuntimeError(f"no luck\nat attempt {len(seen)}")
        return fake_engine(params)

    return engine


def test_a_shard_that_fails_is_tried_three_times(tmp_path: Path) -> None:
    synthesise(tmp_path / "a.zarr", SMALL, simulate=fake_engine)
    seen: list[int] = []
    synthesise(tmp_path / "b.zarr", SMALL, simulate=failing(0, 2, seen))
    assert len(seen) == 3
    assert tree(tmp_path / "a.zarr") == tree(tmp_path / "b.zarr")


def test_a_shard_that_always_fails_is_left_out_and_told(tmp_path: Path) -> None:
    target, seen = tmp_path / "t.zarr", []
    with pytest.raises(
        workers.ShardsFailed, match=r"1 of 3 shards failed 3 times each and is left out, the first"
    ) as told:
        synthesise(target, SMALL, simulate=failing(1, 99, seen))
    assert "trials 5 to 9: RuntimeError: no luck at attempt 3. " in str(told.value)
    assert len(seen) == 3
    assert not target.exists()
    status = status_of(target)
    assert (status.done, status.shards_done, status.complete, status.workers) == (7, 2, False, [])
    [failure] = status.failures
    assert (failure.shard, failure.tries, failure.failed, failure.left_out) == (1, 3, 3, True)
    assert failure.reason == "RuntimeError: no luck at attempt 3."
    with pytest.raises(workers.ShardsFailed):  # a late worker does not begin anew
        work_on(target, SMALL, simulate=lambda _: pytest.fail("tried again"))
    # the command itself does, and makes only what is missing
    log = tmp_path / "log"
    assert synthesise(target, SMALL, simulate=logging_engine(log)).resumed == 7
    assert len(calls(log)) == 1


def test_a_shard_whose_trial_cannot_be_drawn_is_left_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, real, tries = tmp_path / "t.zarr", Draft.draw, []

    def rare(self: Draft, shard: int) -> Any:
        if shard == 1:
            tries.append(shard)
            raise InputError("draw of mine in trial 7 ends in ValueError: no such part.")
        return real(self, shard)

    with monkeypatch.context() as patch:
        patch.setattr(Draft, "draw", rare)
        with pytest.raises(
            workers.ShardsFailed, match=r"trials 5 to 9: draw of mine in trial 7 .*: no such part\. The"
        ):
            synthesise(target, SMALL, simulate=fake_engine)
    assert len(tries) == 3
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == 7


def test_a_full_disk_ends_one_worker_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "t.zarr"
    real = Draft.write

    def full(self: Draft, shard: int, *of_it: Any) -> None:
        if shard == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(self, shard, *of_it)

    with monkeypatch.context() as patch:
        patch.setattr(Draft, "write", full)
        with pytest.raises(OSError, match="No space"):
            work_on(target, SMALL, simulate=fake_engine)
    assert (status_of(target).shards_done, status_of(target).failures) == (1, [])
    assert work_on(target, SMALL, simulate=fake_engine) == (7, True)


def test_status_tells_who_works_and_how_fast(tmp_path: Path) -> None:
    target, seen = tmp_path / "t.zarr", []

    def looking(params: TrialParams) -> Rollouts:
        seen.append(status_of(target))
        return fake_engine(params)

    synthesise(target, SMALL, simulate=looking)
    assert [(one.done, one.shards_done, one.shards) for one in seen] == [(0, 0, 3), (5, 1, 3), (10, 2, 3)]
    assert [[worker.shard for worker in one.workers] for one in seen] == [[0], [1], [2]]
    assert {worker.pid for one in seen for worker in one.workers} == {os.getpid()}
    assert seen[0].per_minute is None
    folder = shards.folder_of(target)
    folder.mkdir()
    synthesise(tmp_path / "again.zarr", SMALL, simulate=fake_engine)
    assert status_of(tmp_path / "again.zarr").complete
    for words, path in (("nor a part of it", tmp_path / "none.zarr"),):
        with pytest.raises(InputError, match=words):
            status_of(path)


def test_the_rate_is_that_of_the_last_ten_minutes(tmp_path: Path) -> None:
    target = tmp_path / "t.zarr"
    folder = shards.folder_of(target)
    shards.begin(folder, plan.manifest_of(replace(SMALL, trials=40)))
    for shard, seconds in enumerate((5060.0, 0.0, 5120.0, 5000.0)):
        digest = shards.store_of(folder) / parts.digest_file(shard)
        digest.parent.mkdir(parents=True)
        digest.touch()
        os.utime(digest, (1e9 + seconds, 1e9 + seconds))
    assert status_of(target).per_minute is None  # nobody is at work
    dead = folder / claims.FOLDER / f"{shards.task(4)}-0"
    dead.touch()
    os.utime(dead, (0, 0))
    assert status_of(target).killed == [4]
    for end in ("release", "failed"):
        claim = claims.take(folder, shards.task(4))
        assert claim is not None
        assert status_of(target).per_minute == pytest.approx(5.0)
        assert status_of(target).killed == []
        getattr(claim, end)(*["E."] * (end == "failed"))
    assert [(one.shard, one.tries, one.left_out) for one in status_of(target).failures] == [(4, 3, False)]
    shards.close(folder)
    assert (folder / claims.FOLDER).is_dir()  # it was begun anew
