"""Every writer of files against targets that a stranger prepared: nothing of others is lost, nothing half is left."""

from __future__ import annotations

import fcntl
import os
import random
import resource
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rcbht_jax._util import checkpoint
from rcbht_jax._util.atomic import atomic_lines, targets
from rcbht_jax.encoding.thresholds import preset, read_thresholds, write_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.mapping import Channel, Mapping, read_mapping, write_mapping
from rcbht_jax.io.rosbags import McapWriter, read_bag
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.learning.model_io import write_archive
from sim_mjx.randomization import overrides
from tests.support.store_cases import simple

OTHERS = b"three years of work"
PIPE = 2**20  # bytes that a pipe holds, so that nobody has to read it


def _lines(path: Path) -> None:
    with atomic_lines(path) as out:
        out.write("{}\n" * 50)


def _mcap(path: Path) -> None:
    with McapWriter(path) as out:
        out.wrench(0.0, (1.0,) * 6)


# What is written, and what reads it back.
WRITERS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "lines": (_lines, Path.read_text),
    "thresholds": (lambda path: write_thresholds(path, preset(), {}), read_thresholds),
    "mapping": (lambda path: write_mapping(path, Mapping((Channel("Fz", unit="N"),), time="t")), read_mapping),
    "checkpoint": (lambda path: checkpoint.save(path, 1, [1]), lambda path: checkpoint.load(path, 1)),
    "physical": (lambda path: overrides.write(path, {"parts.tab_stiffness": 1.0}, {}), overrides.read),
    "archive": (lambda path: write_archive(path, {"a": 1}, {}), Path.read_bytes),
    "mcap": (_mcap, lambda path: list(read_bag(path))),
    "store": (lambda path: write_recordings(path, simple(2, 5), {}), read_recordings),
    "store again": (lambda path: write_recordings(path, simple(2, 5), {}, overwrite=True), read_recordings),
}


def _target(kind: str, here: Path) -> Path:
    """A target of some kind in a folder."""
    path = here / "target.mcap"
    match kind:
        case "file":
            path.write_bytes(OTHERS)
        case "folder":
            path.mkdir()
            (path / "theirs").write_bytes(OTHERS)
        case "empty folder":
            path.mkdir()
        case "link":
            (here / "real").write_bytes(OTHERS)
            path.symlink_to(here / "real")
        case "dangling link":
            path.symlink_to(here / "nothing")
        case "loop":
            path.symlink_to(path)
        case "pipe":
            os.mkfifo(path)
        case "null" | "full":
            path.symlink_to(f"/dev/{kind}")
        case "no parent":
            path = here / "none" / "target.mcap"
        case "parent is a file":
            path = here / "bystander" / "target"
        case "read only":
            (here / "locked").mkdir(0o555)
            path = here / "locked" / "target.mcap"
        case "dots":
            path = here / ".."
        case "long":
            path = here / ("x" * 300)
        case "odd":
            path = here / "a\nb\x1b[2J\u202e.mcap"
        case "not a name":
            path = here / "\udcff\udc80.mcap"
    return path


KINDS = (
    "new", "file", "folder", "empty folder", "link", "dangling link", "loop", "pipe", "null", "full", "no parent",
    "parent is a file", "read only", "dots", "long", "odd", "not a name", "meanwhile", "disk full",
)  # fmt: skip


def attack(writer: str, seed: str, folder: Path) -> str:
    """Write once to a hostile target; "", "refused", or what is wrong.

    Args:
        writer: one of ``WRITERS``.
        seed: chooses the target.
        folder: an empty one, to work in.
    """
    kind = random.Random(seed).choice(KINDS)
    here = folder / "here"
    here.mkdir()
    (here / "bystander").write_bytes(OTHERS)
    path = _target(kind, here)
    before = _seen(here)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK) if kind == "pipe" else None
    if reader is not None:
        fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, PIPE)
    try:
        outcome = _write(writer, kind, path)
    finally:
        if reader is not None:
            os.close(reader)
    wrong = _changed(before, _seen(here), path, kind, refused=outcome == "refused")
    if not wrong and outcome == "" and path.is_file():
        try:
            WRITERS[writer][1](path)
        except Exception as error:
            wrong = f"what was written cannot be read: {error!r}"
    return f"{kind}: {wrong}" if wrong else outcome


def _write(writer: str, kind: str, path: Path) -> str:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with targets([path]):
            if kind == "meanwhile":
                path.write_bytes(OTHERS)
            if kind == "disk full":
                resource.setrlimit(resource.RLIMIT_FSIZE, (20, limits[1]))
            WRITERS[writer][0](path)
    except (InputError, OSError, UnicodeError):  # the command line makes a sentence of each
        return "refused"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    return ""


def _seen(folder: Path) -> dict[str, tuple[int, bytes | str]]:
    """Name -> kind of file, and content or where a link points."""
    found: dict[str, tuple[int, bytes | str]] = {}
    for path in sorted(folder.rglob("*")):
        mode = stat.S_IFMT(path.lstat().st_mode)
        content: bytes | str = ""
        if stat.S_ISLNK(mode):
            content = os.readlink(path)
        elif stat.S_ISREG(mode):
            content = path.read_bytes()
        found[str(path.relative_to(folder))] = (mode, content)
    return found


def _changed(
    before: dict[str, tuple[int, bytes | str]],
    after: dict[str, tuple[int, bytes | str]],
    path: Path,
    kind: str,
    *,
    refused: bool,
) -> str:
    """What a writer did that it must not; "" = nothing."""
    if drafts := [name for name in after if ".partial" in name]:
        return f"a draft is left: {drafts[0]}"
    mine = {"file": path.name, "link": "real"}.get(kind, "") if not refused else ""
    for name, what in before.items():
        if name != mine and after.get(name) != what:
            return f"{name} is not what it was"
    if kind == "meanwhile" and (path.is_dir() or path.read_bytes() != OTHERS):
        return "what another process wrote meanwhile is gone"
    if refused and kind not in ("meanwhile", "disk full") and set(after) != set(before):
        return f"it was refused and left {sorted(set(after) - set(before))}"
    with suppress(OSError):
        if kind in ("null", "full") and not path.is_char_device():
            return "a device was replaced"
    return ""
