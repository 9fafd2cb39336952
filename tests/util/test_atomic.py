"""A file is there whole or not at all, and nothing is replaced that was not there before."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from rcbht_jax._util import atomic
from rcbht_jax._util.atomic import (
    _exchanged,
    atomic_folder,
    atomic_lines,
    atomic_new,
    atomic_write,
    targets,
    uninterrupted,
)
from rcbht_jax.errors import InputError


def test_the_old_file_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    with atomic_write(path) as draft:
        assert draft.suffix == ".csv"
        draft.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["\U0001f600" * 60 + ".model", "a" * 64 + "." + "b" * 180])
def test_every_name_that_a_file_can_have_can_be_written(name: str, tmp_path: Path) -> None:
    """The name of the draft was too long, which came to light after the work."""
    with atomic_write(tmp_path / name) as draft:
        draft.write_text("new")
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [(name, "new")]


def test_pipes_and_devices_are_written_to_and_links_stay(tmp_path: Path) -> None:
    pipe, link, target = tmp_path / "pipe", tmp_path / "link", tmp_path / "target"
    os.mkfifo(pipe)
    target.write_text("old")
    link.symlink_to(target)
    heard: list[str] = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    for path in (pipe, link, Path("/dev/null")):
        with atomic_write(path) as draft:
            draft.write_text("new")
    reader.join(20)
    assert heard == ["new"]
    assert pipe.is_fifo()
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert Path("/dev/null").is_char_device()
    with pytest.raises(InputError, match="not a regular file"), atomic_write(tmp_path):
        pass
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(InputError, match="leads to itself"), atomic_write(loop):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "loop", "pipe", "target"]


@pytest.mark.parametrize("before", [None, "old"])
def test_what_comes_meanwhile_is_kept_and_so_is_the_new_work(before: str | None, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    if before is not None:
        path.write_text(before)
    with targets([path]):
        path.unlink(missing_ok=True)
        path.write_text("of another process")  # while this one computes
        with pytest.raises(InputError, match=r"kept.* is .*a-2\.csv"):
            replace(path, "ours")
    assert path.read_text() == "of another process"
    assert (tmp_path / "a-2.csv").read_text() == "ours"
    assert len(list(tmp_path.iterdir())) == 2


def replace(path: Path, text: str) -> None:
    with atomic_write(path) as draft:
        draft.write_text(text)


def test_one_command_may_write_its_target_again(tmp_path: Path) -> None:
    """Also behind a link."""
    path, link = tmp_path / "checkpoint.json", tmp_path / "link"
    link.symlink_to(path)
    path.write_text("old")
    with targets([link]):
        for text in ("first", "second"):
            replace(link, text)
    assert path.read_text() == "second"
    assert link.is_symlink()


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_comes_meanwhile_is_kept(overwrite: bool, tmp_path: Path) -> None:
    path = tmp_path / "store"
    if overwrite:
        path.mkdir()
        (path / "old").touch()
    with pytest.raises(InputError, match=r"kept"):
        overtaken(path, overwrite)
    assert [entry.name for entry in path.iterdir()] == ["theirs"]
    assert list((tmp_path / "store-2").iterdir()) == []
    with pytest.raises(InputError, match="exists already"), atomic_folder(path):
        pass


@pytest.mark.parametrize("at_once", [False, True])
def test_a_folder_is_replaced_by_the_complete_new_one(
    at_once: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On systems that exchange two folders at once, and on others."""
    path, exchanged = tmp_path / "store", []
    path.mkdir()
    (path / "old").touch()

    def exchange(one: Path, other: Path) -> bool:
        exchanged.append(at_once and _exchanged(one, other))
        return exchanged[-1]

    monkeypatch.setattr(atomic, "_exchanged", exchange)
    replaced_folder(path)
    assert [entry.name for entry in path.iterdir()] == ["new"]
    assert list(tmp_path.iterdir()) == [path]
    assert exchanged == [at_once] or sys.platform != "linux"


@pytest.mark.skipif(sys.platform != "linux", reason="folders are exchanged on Linux only")
def test_of_two_that_replace_a_folder_at_the_same_moment_none_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The later one deleted the folder of the earlier one, which had come after it had looked."""
    path = tmp_path / "store"
    path.mkdir()

    def overtaken(one: Path, other: Path) -> bool:
        monkeypatch.undo()
        replaced_folder(path)
        return _exchanged(one, other)

    monkeypatch.setattr(atomic, "_exchanged", overtaken)
    with pytest.raises(InputError, match=r"store meanwhile, which is kept; what was to be written is .*store-2"):
        replaced_folder(path)
    assert sorted(tmp_path.iterdir()) == [path, tmp_path / "store-2"]


def test_a_second_ctrl_c_leaves_no_draft(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended the deletion that the first one had begun, although the command says that nothing is left."""
    real = shutil.rmtree

    def pressed(path: Path, ignore_errors: bool) -> None:
        signal.raise_signal(signal.SIGINT)
        real(path, ignore_errors)

    monkeypatch.setattr(atomic.shutil, "rmtree", pressed)
    with pytest.raises(KeyboardInterrupt):
        interrupted_folder(tmp_path / "store")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_two_folders_change_places_loses_neither(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system cannot exchange them at once, the old one has another name for a moment."""
    path, real = tmp_path / "store", Path.rename
    path.mkdir()

    def pressed(one: Path, other: Path) -> None:
        real(one, other)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(atomic, "_exchanged", lambda *_: False)
    monkeypatch.setattr(Path, "rename", pressed)
    with pytest.raises(KeyboardInterrupt):
        replaced_folder(path)
    assert list(tmp_path.iterdir()) == [path]
    assert [entry.name for entry in path.iterdir()] == ["new"]


def replaced_folder(path: Path) -> None:
    with atomic_folder(path, replace=True) as draft:
        draft.mkdir()
        (draft / "new").touch()


def interrupted_folder(path: Path) -> None:
    with atomic_folder(path) as draft:
        draft.mkdir()
        raise KeyboardInterrupt


def overtaken(path: Path, overwrite: bool) -> None:
    """Make a folder while another process puts its own there."""
    with atomic_folder(path, replace=overwrite) as draft:
        draft.mkdir()
        if overwrite:
            path.rename(path.with_name("away"))
        path.mkdir()
        (path / "theirs").touch()


def cut_recording(path: Path, text: str, error: type[BaseException]) -> None:
    with atomic_lines(path) as out:
        out.write(text)
        raise error


def interrupted_block(number: signal.Signals, done: list[bool]) -> None:
    with uninterrupted():
        os.kill(os.getpid(), number)
        done.append(True)


def test_recordings_are_kept_as_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text("of yesterday\n")
    for error, text in ((KeyboardInterrupt, "first\nsecond\nthi"), (OSError, "no line")):
        with pytest.raises(error):
            cut_recording(path, text, error)
        assert path.read_text() == ("first\nsecond\n")  # the second left no line
    with atomic_lines(path) as out:
        out.write("done\n")
    assert path.read_text() == "done\n"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_block_that_must_not_be_interrupted_ends_first(number: signal.Signals) -> None:
    done: list[bool] = []
    kept = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted_block(number, done)
    finally:
        signal.signal(signal.SIGTERM, kept[signal.SIGTERM])
    assert done
    assert signal.getsignal(signal.SIGINT) is kept[signal.SIGINT]


def test_a_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(OSError, match="disk"):
        fill_the_disk(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def fill_the_disk(path: Path) -> None:
    with atomic_write(path) as draft:
        draft.write_text("ne")
        raise OSError("disk full")


@pytest.mark.parametrize("writer", [atomic_write, atomic_new, atomic_folder])
def test_outputs_are_on_the_disk_before_they_are_in_their_place(
    writer: Callable[[Path], AbstractContextManager[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, flushed = tmp_path / "a", []
    monkeypatch.setattr(os, "fsync", lambda handle: flushed.append((os.fstat(handle).st_ino, path.exists())))
    with writer(path) as draft:
        if writer is atomic_folder:
            draft.mkdir()
        (draft / "inside" if draft.is_dir() else draft).write_text("new")
    made = [(entry.stat().st_ino, False) for entry in (path, *path.rglob("*"))]
    assert sorted(flushed) == sorted([*made, (tmp_path.stat().st_ino, True)])  # the move itself comes last


def test_a_new_file_is_made_by_one_and_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with atomic_new(path) as draft:
        draft.write_text("first")
    with pytest.raises(FileExistsError), atomic_new(path) as draft:
        draft.write_text("second")
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]
