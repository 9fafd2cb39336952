"""The one way to write: files and folders that appear complete or not at all, also after a kill or a power cut.

A draft is written beside its target, flushed, and moved there when complete. A killed process leaves at most a draft,
whose name begins with a dot and contains ".partial-". Only what stood at the target when the work began is replaced:
what another process put there meanwhile is kept, and so is the new work, under another name. Devices and pipes are
written to and never replaced; links stay links.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import shutil
import signal
import stat
import tempfile
import threading
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from rcbht_jax.errors import InputError

_DRAFT = re.compile(r"\.([^/]*)\.partial-[0-9a-f]{12}")  # the name of one
_STEM, _SUFFIX = 160, 64  # bytes in the name of a draft, of the 255 that a name has at most
_FLUSHES = 16  # files that are flushed at the same time
Identity = tuple[int, int, int, int] | None  # of what is at a path; None = nothing

_BEFORE: ContextVar[dict[Path, Identity]] = ContextVar("what was at the targets of a command when it began")
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD, RENAME_EXCHANGE of Linux
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # errors that no other name or input mends
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # what ends a process that may still tidy up


@contextmanager
def targets(paths: Iterable[Path]) -> Iterator[None]:
    """Record what is at some targets now: the block replaces nothing that appears there meanwhile.

    >>> with targets([Path("states.model")]), atomic_write(Path("states.model")) as draft:  # after an hour of training
    ...     draft.write_bytes(b"states")
    6
    """
    token = _BEFORE.set({path: identity(path) for path in map(_followed, paths)})
    try:
        yield
    finally:
        _BEFORE.reset(token)


@contextmanager
def atomic_write(path: Path, *, keep: bool = False) -> Iterator[Path]:
    """Give a draft of the file ``path``, with the same suffix; on success it replaces ``path``, else it is removed.

    Behind a link the file that it points to is replaced, so that the link stays. What is written to a device or a
    pipe is written elsewhere first, and copied there on success.

    >>> with atomic_write(Path("empty.json")) as draft:
    ...     draft.write_text("{}")
    2

    Args:
        path: file to create or replace.
        keep: also keep a file whose writing an error or an interruption ended, if anything was written: for recordings,
            which cannot be made again.

    Raises:
        InputError: ``path`` is a folder, or something appeared there meanwhile; that is kept, and the sentence says
            where the new file is.
    """
    if is_stream(path):
        with tempfile.TemporaryDirectory() as folder:
            draft = Path(folder, f"draft{path.suffix}")
            yield draft
            with draft.open("rb") as source, path.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        return
    if path.is_dir():
        raise InputError(f"{path} is a folder, not a regular file; expected a name for a file.")
    path = _followed(path)
    before, draft = _before(path), draft_of(path)
    try:
        try:
            yield draft
        except BaseException:
            if keep and draft.exists() and draft.stat().st_size:
                _put(draft, path, before)
            raise
        _put(draft, path, before)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def atomic_lines(path: Path) -> Iterator[TextIO]:
    """A recording as lines of text, which :func:`atomic_write` keeps however it ends: as whole lines.

    A device or a pipe gets every line at once.

    >>> with atomic_lines(Path("events.jsonl")) as out:
    ...     out.write("{}" + chr(10))
    3
    """
    if is_stream(path):
        with path.open("w", encoding="utf-8") as out:
            yield out
        return
    with atomic_write(path, keep=True) as draft:
        try:
            with draft.open("w", encoding="utf-8") as out:
                yield out
        except BaseException:
            _cut_to_lines(draft)
            raise


@contextmanager
def atomic_new(path: Path) -> Iterator[Path]:
    """As :func:`atomic_write` for a file that must not exist: of several processes only one makes it.

    >>> with atomic_new(Path("manifest.json")) as draft:
    ...     draft.write_text("{}")
    2

    Raises:
        FileExistsError: ``path`` exists; it is left as it is.
    """
    draft = draft_of(path)
    try:
        yield draft
        _flush(draft)
        os.link(draft, path)
        _flush(path.parent)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path, near: Path | None = None, *, replace: bool = False) -> Iterator[Path]:
    """Give the name of a draft folder to create; on success it becomes the folder ``path``, else it is removed.

    Args:
        path: folder to create or replace.
        near: whose sibling the draft is; default ``path``.
        replace: replace the folder that is there now.

    Raises:
        InputError: there is a folder and ``replace`` is false, or something appeared at ``path`` meanwhile; that is
            kept, and the sentence says where the new folder is.
    """
    before, draft = _before(path), draft_of(path if near is None else near)
    if before is not None and not replace:
        raise InputError(f"{path} exists already; choose another name, or move it away.")
    try:
        yield draft
        flush_all([*draft.rglob("*"), draft])  # before what it replaces is deleted
        if identity(path) != before:
            raise _kept(path, draft)
        with uninterrupted():
            _swap(draft, path, before)
        _flush(path.parent)
        _noted(_followed(path))
    except BaseException:
        with uninterrupted():  # a second Ctrl-C would leave a part of the draft
            shutil.rmtree(draft, ignore_errors=True)
        raise


def draft_of(path: Path) -> Path:
    """A new hidden name beside ``path`` with the same suffix, unless that is absurdly long."""
    stem = os.fsencode(path.stem[:64])[:_STEM].decode(errors="ignore")
    suffix = path.suffix if len(os.fsencode(path.suffix)) <= _SUFFIX else ""
    return path.with_name(f".{stem}.partial-{uuid.uuid4().hex[:12]}{suffix}")


def without_draft(path: str) -> str:
    """A path as the user knows it: the target in place of its draft.

    >>> without_draft("runs/.trials.partial-0123456789ab.zarr/zarr.json"), without_draft("runs/a.csv")
    ('runs/trials.zarr/zarr.json', 'runs/a.csv')
    """
    return _DRAFT.sub(r"\1", path)


def is_stream(path: Path) -> bool:
    """Whether a path is a device, a pipe or a socket: what is written to and never replaced.

    >>> is_stream(Path("/dev/null"))
    True
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay signals such as Ctrl-C until the block ends; does nothing outside the main thread, which receives them.

    For libraries with background tasks (Zarr): interrupted, they would go on writing into a draft being removed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    later = _Later({number: signal.getsignal(number) for number in ENDING})
    caught = [number for number, handler in later.former.items() if callable(handler)]  # the others end the process
    for number in caught:
        signal.signal(number, later)
    try:
        yield
    finally:
        for number in caught:
            signal.signal(number, later.former[number])
    if later.pressed:
        handler: Any = later
        while isinstance(handler, _Later):  # of a block around this one, which ends as well
            handler = handler.former[later.pressed[0]]
        handler(later.pressed[0], None)


class _Later:
    """A handler of signals that only remembers them."""

    def __init__(self, former: dict[signal.Signals, Any]) -> None:
        self.former = former
        self.pressed: list[signal.Signals] = []

    def __call__(self, number: int, _: FrameType | None) -> None:
        self.pressed.append(signal.Signals(number))


def flush_all(entries: Iterable[Path]) -> None:
    """Flush files, and the names in folders, to disk; links are left out."""
    with ThreadPoolExecutor(_FLUSHES) as pool:  # each waits for the disk, which does many at once
        for _ in pool.map(_flush, (entry for entry in entries if not entry.is_symlink())):
            pass


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _followed(path: Path) -> Path:
    """The file that is written: behind a link the one that it points to."""
    sentence = f"{path} is a link that leads to itself; choose another name."
    try:
        followed = path.resolve() if path.is_symlink() else path.absolute()
    except (OSError, RuntimeError) as error:
        raise InputError(sentence) from error
    if followed.is_symlink():  # from Python 3.13 on a loop is no error
        raise InputError(sentence)
    return followed


def identity(path: Path) -> Identity:
    """Identifies what is at a path, to detect a replacement; the content of a folder may change.

    >>> identity(Path("nothing.zarr")) is None
    True
    """
    try:
        found = path.lstat()
    except (OSError, ValueError):
        return None
    if stat.S_ISDIR(found.st_mode):
        return found.st_dev, found.st_ino, 0, 0
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _before(path: Path) -> Identity:
    """What was at a path when the command began, or is there now."""
    known = _BEFORE.get({})
    followed = _followed(path)
    return known[followed] if followed in known else identity(path)


def _put(draft: Path, path: Path, before: Identity) -> None:
    """Move a complete draft to its place, if that holds what it did before."""
    _flush(draft)
    if identity(path) != before:
        raise _kept(path, draft)
    if before is None:
        try:
            os.link(draft, path)  # unlike a move it replaces nothing
        except FileExistsError:
            raise _kept(path, draft) from None
        except OSError:  # a file system without links
            draft.replace(path)
    else:
        draft.replace(path)
    _flush(path.parent)  # the move itself must survive a power cut
    _noted(path)


def _noted(path: Path) -> None:
    """Record what this process has written, which it may replace again."""
    if path in (known := _BEFORE.get({})):
        known[path] = identity(path)


def _cut_to_lines(path: Path) -> None:
    """Cut what follows the last line feed of a file: the line that a full disk or an interruption cut."""
    with path.open("rb+") as file:
        end = size = file.seek(0, os.SEEK_END)
        while end:
            start = max(0, end - 4096)
            file.seek(start)
            if (found := file.read(end - start).rfind(b"\n")) >= 0:
                end = start + found + 1
                break
            end = start
        if end < size:
            file.truncate(end)


def _kept(path: Path, draft: Path) -> InputError:
    """Move a draft to a free name, since its own was taken meanwhile; returns the sentence that says so."""
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in range(2, 1_000_000))
    other = next(name for name in names if not os.path.lexists(name))
    draft.rename(other)
    _flush(path.parent)
    return InputError(f"Another process changed {path} meanwhile, which is kept; what was to be written is {other}.")


def _swap(draft: Path, path: Path, before: Identity) -> None:
    if not path.exists():
        draft.rename(path)
        return
    if _exchanged(draft, path):
        if identity(draft) != before:  # another process was quicker by a moment
            _exchanged(draft, path)
            raise _kept(path, draft)
        shutil.rmtree(draft, ignore_errors=True)
        return
    old = draft.with_name(f"{draft.name}-old")  # for a moment there is nothing at the target
    path.rename(old)
    try:
        draft.rename(path)
    except BaseException:
        old.rename(path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders change places at once, where the system can do that (Linux)."""
    try:
        exchange = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    return exchange(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0


def delete(path: Path) -> None:
    """Delete whatever has this name: a file, a folder with its content, a link but not what it leads to, or nothing."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
