"""Claims: which worker makes which shard, so that no worker makes one that another holds.

A claim is a file ``claims/TASK-NUMBER`` in the work folder, created with ``O_EXCL``: of several processes one succeeds,
on every file system that knows exclusive creation. A claim is never handed on. Whoever takes over from a dead worker
creates the next number, so that two that find the same worker dead cannot both take over; the highest number counts.
The files are thus the list of attempts at a shard, failed ones with their reason.

Whether a holder lives is decided by two means, because neither alone is enough:

* a lock (flock) on the file, which the kernel drops the moment the process ends, however it ends: another process of
  the same machine takes over at once. On shared folders such locks may not reach other machines, so they are used
  only on the kernel that the holder runs on.
* a lease: the holder touches the file every ``HEARTBEAT`` s, and one that has not for ``LEASE`` s counts as dead, for
  processes of other machines and where the file system has no locks. Both times are the file system's, not the clocks
  of the machines.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import platform
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rcbht_jax._util.atomic import delete
from rcbht_jax._util.untrusted import parse_json

FOLDER = "claims"
HEARTBEAT = 15.0  # s
LEASE = 120.0  # s; shared file systems may show a touched file up to a minute late
POLL = 0.2  # s between two checks of what others hold
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_MOST_REASON = 500  # characters

State = Literal["held", "dead", "failed", "released"]


@dataclass(frozen=True)
class Attempt:
    """An attempt at a task, as its claim file records it."""

    task: str
    number: int  # of attempts before it
    state: State
    host: str  # "" = not known
    pid: int  # 0 = not known
    seconds: float  # since it was last touched
    reason: str = ""  # why it failed


class Claim:
    """A claim that this process holds; see :func:`take`."""

    def __init__(self, path: Path, handle: int) -> None:
        self.path, self._handle = path, handle
        self._about = {"host": platform.node(), "kernel": _kernel(), "pid": os.getpid(), "locked": True}
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # a file system without locks: others go by the lease
            self._about["locked"] = False
        self._write()  # after the lock: a claim that can be read is locked
        self._over = threading.Event()
        self._beat = threading.Thread(target=self._touch, daemon=True)
        self._beat.start()

    def done(self) -> None:
        """The task is done: delete the claim."""
        self.path.unlink(missing_ok=True)
        self._end()

    def failed(self, reason: str) -> None:
        """The task failed: end the claim, whose file stays as the record of this attempt."""
        self._about["failed"] = reason[:_MOST_REASON]
        self._write()
        self._end()

    def release(self) -> None:
        """The task was interrupted, but did not fail: end the claim, so that any worker may try again."""
        self._about["released"] = True
        with suppress(OSError):  # on a full disk the dropped lock has the same meaning
            self._write()
        self._end()

    def _end(self) -> None:
        self._over.set()
        self._beat.join()
        os.close(self._handle)

    def _write(self) -> None:
        text = json.dumps(self._about).encode()
        os.pwrite(self._handle, text, 0)  # only ever longer than before

    def _touch(self) -> None:
        while not self._over.wait(HEARTBEAT):
            os.utime(self._handle)


def take(folder: Path, task: str) -> Claim | None:
    """Claim a task; None where another holds it.

    Args:
        folder: the work folder.
        task: what is claimed, a name without "-".

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> (folder / "claims").mkdir()
        >>> claim = take(folder, "join")
        >>> take(folder, "join") is None
        True
        >>> claim.release()
        >>> take(folder, "join").done()
    """
    before = attempts(folder, task)
    if any(one.state == "held" for one in before):
        return None
    number = before[-1].number + 1 if before else 0
    path = folder / FOLDER / f"{task}-{number}"
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
    except (FileExistsError, FileNotFoundError):  # another was quicker, or the folder has been removed
        return None
    try:
        claim = Claim(path, handle)
    except BaseException:  # a full disk: others need not wait for the lease
        path.unlink(missing_ok=True)
        os.close(handle)
        raise
    # Since the attempts were read, they may have been cleared and the task claimed anew.
    if any(other.state == "held" and other.number != number for other in attempts(folder, task)):
        claim.release()
        return None
    return claim


@contextmanager
def wait_for(folder: Path, task: str) -> Iterator[bool]:
    """Hold a task, once other holders have ended; yields False if the work folder is deleted or moved meanwhile."""
    while (claim := take(folder, task)) is None:
        if not (folder / FOLDER).is_dir():  # a shard written after that makes the work folder anew, without claims
            yield False
            return
        time.sleep(POLL)
    try:
        yield True
    except BaseException:
        claim.release()
        raise
    claim.done()


def attempts(folder: Path, task: str) -> list[Attempt]:
    """The attempts at a task, the first one first."""
    return board(folder, task).get(task, [])


def board(folder: Path, only: str | None = None) -> dict[str, list[Attempt]]:
    """All attempts, or those at one task, by task; the first one first."""
    found: dict[str, list[Attempt]] = defaultdict(list)
    try:
        names = os.listdir(folder / FOLDER)
    except FileNotFoundError:
        return found
    clock: float | None = None
    for name in names:
        task, dash, number = name.rpartition("-")
        if not dash or name.startswith(".") or not number.isdecimal() or only not in (None, task):
            continue
        path = folder / FOLDER / name
        try:
            about, touched, locked = _read(path)
            if clock is None:
                clock = _now(path.parent)
        except FileNotFoundError:
            continue  # done or removed meanwhile
        found[task].append(_attempt(task, int(number), about, max(0.0, clock - touched), locked))
    return {task: sorted(tries, key=lambda one: one.number) for task, tries in found.items()}


def clear(folder: Path) -> None:
    """Delete the files of attempts that have ended, so that failed ones no longer count."""
    for tries in board(folder).values():
        for one in tries:
            if one.state != "held":
                delete(folder / FOLDER / f"{one.task}-{one.number}")


def _attempt(task: str, number: int, about: dict[str, Any], seconds: float, locked: bool | None) -> Attempt:
    state: State
    if "failed" in about:
        state = "failed"
    elif "released" in about:
        state = "released"
    elif locked is not None:
        state = "held" if locked else "dead"
    else:
        state = "held" if seconds < LEASE else "dead"
    host, pid = str(about.get("host", "")), int(about.get("pid", 0))
    return Attempt(task, number, state, host, pid, seconds, str(about.get("failed", "")))


def _read(path: Path) -> tuple[dict[str, Any], float, bool | None]:
    """Content of a claim, when it was touched, and whether its holder has it locked; None = a lock does not tell."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # does not wait for a pipe
    try:
        touched = os.fstat(handle).st_mtime
        try:
            about = parse_json(os.read(handle, 1 << 16))
            if not isinstance(about, dict) or not isinstance(about.get("pid", 0), int):
                raise ValueError
        except (OSError, ValueError):  # its holder is writing it, or died doing so: the lease decides; or a folder
            return {}, touched, None
        if about.get("kernel") != _kernel() or not about.get("locked"):
            return about, touched, None
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return about, touched, True
        except OSError:
            return about, touched, None
        return about, touched, False
    finally:
        os.close(handle)


def _now(folder: Path) -> float:
    """The file system's time, s; this machine's for who may only look at the folder."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".clock-") as probe:
            return os.fstat(probe.fileno()).st_mtime
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        return time.time()


@cache
def _kernel() -> str:
    """Identifier of the running kernel: containers of one kernel share its locks, machines of one name do not."""
    return _BOOT.read_text().strip() if _BOOT.exists() else platform.node()
