"""Shards that share the lanes of a device: the store is the same, whatever ends first and whatever fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rcbht_jax.errors import InputError
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import claims, records, shards, workers
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig, manifest_of
from sim_mjx.synthesis.regroup import Shard
from sim_mjx.synthesis.workers import Tally
from tests.support import fake_simulation
from tests.support.fake_simulation import SMALL, fake_engine, tree

JOB = replace(fake_simulation.JOB, trials=25)
MADE = list[int]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of JOB, one shard after the other."""
    target = tmp_path_factory.mktemp("plain") / "plain.zarr"
    synthesise(target, JOB, simulate=fake_engine)
    return tree(target)


def fake_rows(params: Any) -> records.Arrays:
    return records.of_trials(fake_engine(params))


def run(tmp_path: Path, stream: Any, job: SynthesisConfig = JOB, share: int | None = None) -> Path:
    """Work of one worker in lanes on a new plan."""
    target = tmp_path / "lanes.zarr"
    folder = shards.folder_of(target)
    shards.begin(folder, manifest_of(job))
    draft = Draft(folder, job, get_scenario(job.preset), manifest_of(job))
    workers.work_in_lanes(draft, stream, 4, Tally(job, set(), None), share)
    return target


def backwards(batches: Iterator[tuple[int, Any]], *_: Callable[[], bool]) -> Iterator[Shard]:
    """Takes three shards at a time and returns the last first."""
    taken = []
    for shard, params in batches:
        taken.append(Shard(shard, fake_rows(params), None))
        if len(taken) == 3:
            yield from reversed(taken)
            taken = []
    yield from taken


def test_the_store_is_that_of_one_shard_after_the_other(tmp_path: Path, plain: dict[str, bytes]) -> None:
    target = run(tmp_path, backwards)
    folder = shards.folder_of(target)
    assert shards.finished(folder) == set(range(5))
    assert not [one for tries in claims.board(folder).values() for one in tries]
    synthesise(target, JOB, simulate=lambda _: pytest.fail("simulated again"))
    assert tree(target) == plain


@pytest.mark.parametrize(("share", "most"), [(None, 3), (2, 2), (1, 1)])
def test_beyond_its_share_a_worker_claims_when_lanes_wait(tmp_path: Path, share: int | None, most: int) -> None:
    held: MADE = []

    def looks(batches: Iterator[tuple[int, Any]], *_: Callable[[], bool]) -> Iterator[Shard]:
        shard, params = next(batches)
        time.sleep(0.5)  # a thread claims meanwhile
        board = claims.board(shards.folder_of(tmp_path / "lanes.zarr"))
        held.append(sum(one.state == "held" for tries in board.values() for one in tries))
        for number, drawn in [(shard, params), *batches]:
            yield Shard(number, fake_rows(drawn), None)

    target = run(tmp_path, looks, share=share)
    assert held == [most]
    assert shards.finished(shards.folder_of(target)) == set(range(5))


def test_what_others_hold_is_left_to_them(tmp_path: Path) -> None:
    seen: MADE = []

    def stream(batches: Iterator[tuple[int, Any]], *_: Callable[[], bool]) -> Iterator[Shard]:
        for shard, params in batches:
            seen.append(shard)
            yield Shard(shard, fake_rows(params), None)

    folder = shards.folder_of(tmp_path / "lanes.zarr")
    shards.begin(folder, manifest_of(JOB))
    claim = claims.take(folder, shards.task(4))
    assert claim is not None
    run(tmp_path, stream)
    assert seen == [shard for shard in range(5) if shard != 4]
    claim.release()


@pytest.mark.parametrize(
    ("error", "state"), [(RuntimeError("lost device"), "failed"), (InputError("No disk."), "released")]
)
def test_an_error_frees_what_was_held(tmp_path: Path, error: Exception, state: str, plain: dict[str, bytes]) -> None:
    def stream(batches: Iterator[tuple[int, Any]], *_: Callable[[], bool]) -> Iterator[Shard]:
        first, second, third = (next(batches) for _ in range(3))
        yield Shard(second[0], fake_rows(second[1]), None)
        assert first[0] != third[0]
        raise error

    if state == "released":
        with pytest.raises(InputError, match=r"No disk\."):
            run(tmp_path, stream)
    else:
        run(tmp_path, stream)
    folder = shards.folder_of(tmp_path / "lanes.zarr")
    assert shards.finished(folder) == {1}
    board = claims.board(folder)
    assert {one.state for task in (0, 2) for one in board[shards.task(task)]} == {state}
    synthesise(tmp_path / "lanes.zarr", JOB, simulate=fake_engine)  # the others are made by the batch
    assert tree(tmp_path / "lanes.zarr") == plain


@pytest.mark.parametrize(
    ("error", "state"),
    [(RuntimeError("no number"), "failed"), (InputError("No part."), "failed"), (KeyboardInterrupt(), "released")],
)
def test_a_shard_that_cannot_be_drawn_is_not_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, state: str
) -> None:
    draw = Draft.draw

    def fails(draft: Draft, shard: int) -> Any:
        if shard == 1:
            raise error
        return draw(draft, shard)

    def stream(batches: Iterator[tuple[int, Any]], *_: Callable[[], bool]) -> Iterator[Shard]:
        for shard, params in batches:
            yield Shard(shard, fake_rows(params), None)

    monkeypatch.setattr(Draft, "draw", fails)
    if state == "failed":
        run(tmp_path, stream, SMALL)
    else:
        with pytest.raises(type(error)):
            run(tmp_path, stream, SMALL)
    folder = shards.folder_of(tmp_path / "lanes.zarr")
    board = claims.board(folder)
    assert [one.state for one in board[shards.task(1)]] == [state]
    assert not [one for tries in board.values() for one in tries if one.state == "held"]
    if state == "failed":  # the others are made, and it is tried again
        assert shards.finished(folder) == {0, 2}
        monkeypatch.undo()
        synthesise(tmp_path / "lanes.zarr", SMALL, simulate=fake_engine)
