"""A batch that the device does not hold is halved, said, and gives the same bytes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.workers import ShardsFailed
from tests.support.fake_simulation import SMALL, fake_engine, tree


def small_device(most: int, sizes: list[int]) -> object:
    """The engine on a device that holds so many trials at once."""

    def engine(params: TrialParams) -> Rollouts:
        sizes.append(len(params.seed))
        if len(params.seed) > most:
            raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 99 bytes.")
        return fake_engine(params)

    return engine


@pytest.mark.parametrize("window", [None, 5])
def test_half_batches_give_the_same_bytes(window: int | None, tmp_path: Path) -> None:
    job = replace(SMALL, trials=6, shard=6, window=window)
    synthesise(tmp_path / "whole.zarr", job, simulate=fake_engine)
    said: list[str] = []
    sizes: list[int] = []
    synthesise(tmp_path / "halves.zarr", job, simulate=small_device(2, sizes), notice=said.append)
    assert tree(tmp_path / "halves.zarr") == tree(tmp_path / "whole.zarr")
    assert sizes == [6, 3, 2, 2, 2]
    assert [sentence.split("at once; going on with ")[1] for sentence in said] == ["3.", "2."]


def test_the_next_shard_begins_with_what_fits(tmp_path: Path) -> None:
    sizes: list[int] = []
    synthesise(tmp_path / "t.zarr", SMALL, simulate=small_device(3, sizes))
    assert sizes == [5, 3, 2, 3, 2, 2]


def test_one_trial_that_does_not_fit_is_a_failure(tmp_path: Path) -> None:
    with pytest.raises(ShardsFailed, match="RESOURCE_EXHAUSTED"):
        synthesise(tmp_path / "t.zarr", SMALL, simulate=small_device(0, []))
