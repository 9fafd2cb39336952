"""Processes that write shards: the same bytes as in this process, the same errors, and none is left behind."""

from __future__ import annotations

import gc
import os
import signal
import weakref
from pathlib import Path

import jax
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.part_process import PartProcess
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import records, shards, writers
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.plan import SynthesisConfig, encoder_config, label_limits, manifest_of
from sim_mjx.synthesis.writers import Writers
from tests.support.fake_simulation import fake_engine, short, tree

JOB = SynthesisConfig("B", 12, seed=5, shard=4, window=5, spec=short())


@pytest.fixture(autouse=True)
def _two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "MOST", 2)


def draft_in(folder: Path) -> Draft:
    shards.begin(folder, manifest_of(JOB))
    return Draft(folder, JOB, get_scenario(JOB.preset), manifest_of(JOB))


def made(draft: Draft, shard: int) -> tuple[records.Arrays, records.Arrays]:
    out = fake_engine(draft.draw(shard)[0])
    tracks = records.label(out, encoder_config(JOB), label_limits())
    return records.of_trials(out), records.of_labels(tracks, len(out.length))


def test_labels_are_made_where_the_accelerator_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[object] = []
    encode = records.encode_on_device
    monkeypatch.setattr(records, "encode_on_device", lambda *all: given.extend(all[2:]) or encode(*all))
    records.label(fake_engine(draft_in(tmp_path / "here").draw(0)[0]), encoder_config(JOB), label_limits())
    assert [isinstance(array, jax.Array) for array in given] == [True, True]


def test_processes_write_the_same_bytes_and_say_what_is_wrong(tmp_path: Path) -> None:
    here, there = draft_in(tmp_path / "here"), draft_in(tmp_path / "there")
    with Writers(here, apart=False) as inside, Writers(there, apart=True) as apart:
        assert apart.count == 2
        for shard in range(here.shards):
            given = (shard, here.draw(shard), *made(here, shard))
            inside.submit(*given).result()
            apart.submit(*given).result()
        rows, labels = made(here, 0)
        broken = labels | {"mc.label": labels["mc.label"].astype(np.int16)}
        said = []
        for pool in (inside, apart):
            with pytest.raises(InputError, match=r"mc label is int16") as error:
                pool.submit(0, here.draw(0), rows, broken).result()
            said.append(str(error.value))
        assert said[0] == said[1]
        assert shards.finished(there.folder) == set(range(3))
        killed = [process._process for process in apart._processes]
        for process in killed:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        with pytest.raises(RuntimeError, match="a process that writes parts ended: no reason given"):
            apart.submit(1, here.draw(1), rows, labels).result()
    assert tree(there.path) == tree(here.path)


def test_a_shard_is_not_kept_beside_its_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "MOST", 1)
    draft, alive = draft_in(tmp_path / "work"), []
    rows, labels = made(draft, 0)
    watched = weakref.ref(rows["wrench"])
    wait = PartProcess.wait_until_written

    def seen(process: PartProcess) -> None:
        gc.collect()
        alive.append(watched() is not None)
        wait(process)

    monkeypatch.setattr(PartProcess, "wait_until_written", seen)
    with Writers(draft, apart=True) as pool:
        written = pool.submit(0, draft.draw(0), rows, labels)
        del rows, labels
        written.result()
    assert alive == [False]


def test_a_process_ends_with_its_input(tmp_path: Path) -> None:
    with Writers(draft_in(tmp_path / "work"), apart=True) as pool:
        running = [process._process for process in pool._processes]
        assert [process.poll() for process in running] == [None, None]
    assert [process.returncode for process in running] == [0, 0]


def test_few_cores_write_in_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: writers.FEWEST - 1)
    draft = draft_in(tmp_path / "work")
    with Writers(draft) as pool:
        assert not pool._processes
        pool.submit(0, draft.draw(0), *made(draft, 0)).result()
    assert shards.finished(draft.folder) == {0}
