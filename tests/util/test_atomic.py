"""A file is there whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rcbht_jax._util.atomic import atomic_new, atomic_write
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


def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    """A pipe stays a pipe and a link a link; a device is as a pipe."""
    pipe, link, target = tmp_path / "pipe", tmp_path / "link", tmp_path / "target"
    os.mkfifo(pipe)
    target.write_text("old")
    link.symlink_to(target)
    for path in (pipe, tmp_path):
        with pytest.raises(InputError, match="not a regular file"), atomic_write(path):
            pass
    assert pipe.is_fifo()
    with atomic_write(link) as draft:
        draft.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"


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


def test_a_new_file_is_made_by_one_and_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with atomic_new(path) as draft:
        draft.write_text("first")
    with pytest.raises(FileExistsError), atomic_new(path) as draft:
        draft.write_text("second")
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]
