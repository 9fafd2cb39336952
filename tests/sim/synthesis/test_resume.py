"""A synthesis that was interrupted or short of disk goes on to the same bytes; foreign folders stay."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_attrs
from sim_mjx.assembly.rollout import TrialParams
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis import claims, descriptions, plan, shards
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.pipeline import synthesise, work_on
from sim_mjx.synthesis.plan import indices
from tests.support.fake_simulation import SMALL, fake_engine, interrupted, tree


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of SMALL, uninterrupted."""
    target = tmp_path_factory.mktemp("whole") / "trials.zarr"
    synthesise(target, SMALL, simulate=fake_engine)
    return tree(target)


@pytest.mark.parametrize("moment", range(1, 13))
def test_interrupted_at_any_rename_gives_the_same_bytes(
    moment: int, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Manifest, claims, the store's beginning, its arrays that grow, its place: before each and after each."""
    target, calls = tmp_path / "trials.zarr", [0]

    def stopping(real: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        def rename(self: Any, place: Any) -> Any:
            if threading.current_thread() is not threading.main_thread():
                return real(self, place)  # the storage library's own, in its own thread
            calls[0] += 1
            if 2 * calls[0] - 1 == moment:
                raise KeyboardInterrupt
            out = real(self, place)
            if 2 * calls[0] == moment:
                raise KeyboardInterrupt
            return out

        return rename

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", stopping(Path.rename))
        patch.setattr(Path, "replace", stopping(Path.replace))
        patch.setattr(os, "link", stopping(os.link))
        with pytest.raises(KeyboardInterrupt):
            synthesise(target, SMALL, simulate=fake_engine)
    there = range(3) if target.exists() else shards.finished(shards.folder_of(target))
    report = synthesise(target, SMALL, simulate=fake_engine)
    assert tree(target) == whole
    assert report.resumed == sum(min(5, 12 - 5 * shard) for shard in there)
    assert os.listdir(tmp_path) == ["trials.zarr"]


def test_killed_while_tidying_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "trials.zarr"
    real = Path.unlink

    def unlink(self: Path, missing_ok: bool = False) -> None:
        if self.name == shards.MANIFEST:
            raise KeyboardInterrupt
        real(self, missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", unlink)
        with pytest.raises(KeyboardInterrupt):
            synthesise(target, SMALL, simulate=fake_engine)
    before = tree(target)
    report = synthesise(target, SMALL, simulate=lambda _: pytest.fail("simulated again"))
    assert (report.stored, report.resumed) == (12, 12)
    assert tree(target) == before
    assert os.listdir(tmp_path) == ["trials.zarr"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 6}, r"begun with --seed 5, not 6\."),
        ({"trials": 13}, "--trials 12, not 13"),
        ({"preset": "A"}, 'the preset or assembly "B", not "A"'),
        ({"shard": 6}, "--shard 5, not 6"),
        ({"spec": replace(SMALL.spec, longest=0.2)}, r"begun with no --max-seconds, not with 0\.2"),
        ({"window": 5}, r"begun with no --window, not with 5\."),
        ({"spec": DomainRandomization(friction=(0.5, 1.0))}, "job.spec.friction"),
    ],
)
def test_work_with_other_options_is_not_resumed(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    target = tmp_path / "t.zarr"
    interrupted(target, SMALL)
    before = tree(tmp_path)
    with pytest.raises(InputError, match=words):
        synthesise(target, replace(SMALL, **change), simulate=fake_engine)
    assert tree(tmp_path) == before


def test_work_of_other_code_is_not_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted(tmp_path / "t.zarr", SMALL)
    monkeypatch.setattr(plan, "code_hash", lambda: "other")
    with pytest.raises(InputError, match=r"the simulation's code \(sim_mjx_sha256\)"):
        synthesise(tmp_path / "t.zarr", SMALL, simulate=fake_engine)


def test_files_of_others_and_links_are_left_alone(tmp_path: Path) -> None:
    folder = shards.folder_of(tmp_path / "t.zarr")
    folder.mkdir()
    (folder / "lock").write_text("precious")
    with pytest.raises(InputError, match="holds lock"):
        synthesise(tmp_path / "t.zarr", SMALL, simulate=fake_engine)
    for target, inside in ((tmp_path / "u.zarr", "."), (tmp_path / "v.zarr", claims.FOLDER)):
        place = shards.folder_of(target) / inside
        place.parent.mkdir(exist_ok=True)
        place.symlink_to(folder)
        with pytest.raises(InputError, match="is a link"):
            synthesise(target, SMALL, simulate=fake_engine)
    assert [(file.name, file.read_text()) for file in folder.iterdir()] == [("lock", "precious")]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_appears_at_the_target_meanwhile_is_kept(overwrite: bool, tmp_path: Path, whole: dict[str, bytes]) -> None:
    target = tmp_path / "t.zarr"

    def meanwhile(params: TrialParams) -> Any:
        target.mkdir(exist_ok=True)
        (target / "thesis.txt").write_text("mine")
        return fake_engine(params)

    with pytest.raises(InputError, match=r"t\.zarr exists"):
        synthesise(target, SMALL, simulate=meanwhile, overwrite=overwrite)
    assert (target / "thesis.txt").read_text() == "mine"
    (target / "thesis.txt").unlink()
    target.rmdir()
    assert synthesise(target, SMALL, simulate=lambda _: pytest.fail("simulated again")).resumed == 12
    assert tree(target) == whole


def test_a_finished_store_that_was_damaged_is_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not taken for the result of the command; what is wanted can be made again."""
    target = tmp_path / "t.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(shards, "remove", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            synthesise(target, SMALL, simulate=fake_engine)
    before = tree(target)
    damage(target / "wrench" / "c" / "0", "flip")
    with pytest.raises(InputError, match="exists already"):
        synthesise(target, SMALL, simulate=fake_engine)
    synthesise(target, SMALL, simulate=fake_engine, overwrite=True)
    assert tree(target) == before


def test_labels_of_other_code_or_thresholds_are_not_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = replace(SMALL, window=5)
    for name, other, words in (
        ("encoding_hash", lambda: "other", r"the encoder's code \(encoding_sha256\)"),
        ("label_limits", lambda: plan.thresholds.preset("pa10").limits, "thresholds"),
    ):
        interrupted(tmp_path / f"{name}.zarr", job)
        with monkeypatch.context() as patch:
            patch.setattr(plan, name, other)
            with pytest.raises(InputError, match=words):
                synthesise(tmp_path / f"{name}.zarr", job, simulate=fake_engine)


def damage(place: Path, how: str) -> None:
    """Spoil a file, or the first one below a folder."""
    file = next(file for file in (place, *sorted(place.rglob("*"))) if file.is_file())
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes({"cut": data[: len(data) // 2], "flip": data, "empty": b""}[how])


SHARD = [f"{name}/c/1" for name in ("wrench", "length", "simulation/seated", "part_sha256", "part_summary")]
METADATA = [("zarr.json", "cut"), ("zarr.json", "empty"), ("dt/c", "flip"), ("axis/c", "flip")]


@pytest.mark.parametrize(
    ("where", "how", "kept"),
    [
        *((SHARD[0], how, 5) for how in ("cut", "empty")),
        *((where, "flip", 5) for where in SHARD),
        *((where, how, 0) for where, how in METADATA),
    ],
)
def test_a_damaged_shard_is_made_again_and_a_store_without_metadata_begun_anew(
    where: str, how: str, kept: int, whole: dict[str, bytes], tmp_path: Path
) -> None:
    target = tmp_path / "t.zarr"
    interrupted(target, SMALL, after=2)
    damage(shards.store_of(shards.folder_of(target)) / where, how)
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == kept
    assert tree(target) == whole


def test_a_resumed_run_says_that_it_verifies(tmp_path: Path) -> None:
    target, said = tmp_path / "t.zarr", list[str]()
    interrupted(target, SMALL, after=2)
    working = claims.take(folder := shards.folder_of(target), shards.task(3))
    assert working is not None
    shards.renew(folder, said.append)
    assert not said  # what another worker may be writing is left alone
    working.release()
    synthesise(target, SMALL, simulate=fake_engine, notice=said.append)
    assert said == ["Verifying 2 finished shards."]


def test_damaged_labels_are_made_again(tmp_path: Path) -> None:
    job, target = replace(SMALL, window=5), tmp_path / "t.zarr"
    interrupted(target, job, after=2)
    damage(shards.store_of(shards.folder_of(target)) / "labels" / "online-W5" / "mc" / "avg" / "c" / "1", "flip")
    assert synthesise(target, job, simulate=fake_engine).resumed == 5
    synthesise(tmp_path / "once.zarr", job, simulate=fake_engine)
    assert tree(target) == tree(tmp_path / "once.zarr")


@pytest.mark.parametrize("moment", [1, 2, 20, 60])
def test_a_full_disk_costs_one_shard(moment: int, whole: dict[str, bytes], tmp_path: Path) -> None:
    """Whatever file of a part is the one for which there is no room."""
    target, calls, real = tmp_path / "t.zarr", [0], zarr.storage.LocalStore.set

    async def full(self: Any, key: str, value: Any) -> None:
        calls[0] += 1
        if calls[0] == moment:
            raise OSError(errno.ENOSPC, "No space left on device")
        await real(self, key, value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zarr.storage.LocalStore, "set", full)
        with pytest.raises(OSError, match="No space"):
            synthesise(target, SMALL, simulate=fake_engine)
    assert not target.exists()
    there = sum(min(5, 12 - 5 * shard) for shard in shards.finished(shards.folder_of(target)))
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == there
    assert tree(target) == whole


def test_a_full_disk_at_the_end_keeps_the_shards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "t.zarr"
    with monkeypatch.context() as patch:
        patch.setattr("rcbht_jax.io.zarr.consolidate", full)
        with pytest.raises(OSError, match="No space"):
            synthesise(target, SMALL, simulate=fake_engine)
    assert not target.exists()
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == 12


def test_no_trial_is_drawn_twice(whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[int] = []
    real = Draft.draw
    monkeypatch.setattr(Draft, "draw", lambda self, shard: drawn.extend(indices(self.job, shard)) or real(self, shard))
    synthesise(tmp_path / "again.zarr", SMALL, simulate=fake_engine)
    assert drawn == list(range(12))
    interrupted(tmp_path / "t.zarr", SMALL)
    drawn.clear()
    synthesise(tmp_path / "t.zarr", SMALL, simulate=fake_engine)
    assert drawn == list(range(5, 12))
    assert tree(tmp_path / "t.zarr") == whole


def replaced(first: bytes, second: bytes) -> Callable[[Path, bytes], object]:
    """Damage that no reader notices."""
    return lambda path, content: path.write_bytes(content.replace(first, second, 1))


@pytest.mark.parametrize(
    "damage",
    [
        lambda path, _: path.write_text("{"), lambda path, _: path.write_bytes(b"\xa9"),
        lambda path, _: os.mkfifo(path),
        replaced(b'"time"', b'"tine"'), replaced(b"float32", b"float64"), replaced(b"12", b"13"),
        replaced(b'": ', b'":\n'),
    ],
)  # fmt: skip
def test_a_damaged_description_of_an_array_begins_anew(
    damage: Callable[[Path, bytes], object], whole: dict[str, bytes], tmp_path: Path
) -> None:
    target = tmp_path / "trials.zarr"
    interrupted(target, SMALL)
    metadata = shards.store_of(shards.folder_of(target)) / "wrench" / "zarr.json"
    content = metadata.read_bytes()
    metadata.unlink()
    damage(metadata, content)
    assert not metadata.is_file() or metadata.read_bytes() != content
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == 0
    assert tree(target) == whole


@pytest.fixture(scope="module")
def growing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A work folder with one shard, with labels."""
    target = tmp_path_factory.mktemp("growing") / "t.zarr"
    interrupted(target, replace(SMALL, window=5))
    return shards.folder_of(target)


@pytest.mark.parametrize("group", [".", "columns", "annotations", "simulation", "labels/online-W5", "labels"])
@pytest.mark.parametrize(
    "damage",
    [
        replaced(b'"attributes": {', b'"attributes": {"evil": 1, '), replaced(b'"zarr_format": 3', b'"zarr_format": 2'),
        lambda path, _: path.write_text("[1]"), lambda path, _: os.mkfifo(path), lambda path, _: None,
        lambda path, _: path.write_text("[" * 100_000),
    ],
)  # fmt: skip
def test_damaged_descriptions_of_groups_are_noticed(
    group: str, damage: Callable[[Path, bytes], object], growing: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(growing, tmp_path / growing.name)
    assert descriptions.are_intact(folder, shards.store_of(folder))
    metadata = shards.store_of(folder) / group / "zarr.json"
    content = metadata.read_bytes()
    metadata.unlink()
    damage(metadata, content)
    assert not descriptions.are_intact(folder, shards.store_of(folder))


@pytest.mark.parametrize("changed", ['"dt": 0.005', '"rows": 12', '"part_rows": 5', '"created": "undated"'])
def test_a_store_with_changed_attributes_is_begun_anew(changed: str, whole: dict[str, bytes], tmp_path: Path) -> None:
    """Readers would believe them; the store would not be the same bytes."""
    target = tmp_path / "t.zarr"
    interrupted(target, SMALL)
    root = shards.store_of(shards.folder_of(target)) / "zarr.json"
    text = root.read_text()
    assert text.count(changed) == 1
    root.write_text(text.replace(changed, changed[:-1] + "9" + changed[-1:]))
    assert synthesise(target, SMALL, simulate=fake_engine).resumed == 0
    assert tree(target) == whole


@pytest.mark.parametrize("content", [b"[1]", b'{"pid": "x"}', b"[" * 60_000, None])
def test_a_claim_that_is_none_waits_for_its_lease(content: bytes | None, tmp_path: Path) -> None:
    (tmp_path / claims.FOLDER).mkdir()
    path = tmp_path / claims.FOLDER / "000000-0"
    os.mkfifo(path) if content is None else path.write_bytes(content)
    assert claims.attempts(tmp_path, "000000")[0].state == "held"
    os.utime(path, (0, 0))
    assert claims.attempts(tmp_path, "000000")[0].state == "dead"


def test_another_kind_of_processor_does_not_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its vector instructions round differently: one store must not hold trials of both."""
    target = tmp_path / "trials.zarr"
    interrupted(target, SMALL)
    before = tree(shards.folder_of(target))
    here = plan.processor()
    monkeypatch.setattr(plan, "processor", lambda: "Linux x86_64 with AVX2 alone")
    words = f'begun with versions.processor "{here}", not "Linux x86_64 with AVX2 alone". Finish it .* processor'
    for work in (synthesise, work_on):
        with pytest.raises(InputError, match=words):
            work(target, SMALL, simulate=fake_engine)
    assert tree(shards.folder_of(target)) == before
    assert plan.manifest_of(replace(SMALL, engine="warp"))["versions"].get("processor") is None
    monkeypatch.undo()
    synthesise(target, SMALL, simulate=fake_engine)
    assert read_attrs(target)["simulated"]["versions"]["processor"] == here


def test_the_processor_is_told_by_its_widest_instructions(monkeypatch: pytest.MonkeyPatch) -> None:
    for found, words in (
        (["X86_V3", "X86_V4"], "AVX-512"),
        (["SSE3", "FMA3", "AVX2"], "AVX2"),
        (["ASIMDHP", "ASIMD"], "NEON"),
        ([], "no vector instructions beyond its base"),
    ):
        known = {"SIMD Extensions": {"baseline": found[:1], "found": found[1:]}}
        monkeypatch.setattr(np, "show_config", lambda mode, known=known: known)
        assert plan.processor.__wrapped__().endswith(f" with {words}")
