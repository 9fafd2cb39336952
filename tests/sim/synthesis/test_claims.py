"""Claims: one holder at a time; that of a dead process is taken over at once, of another machine after its lease."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sim_mjx.synthesis import claims

HOLD = """
import sys
from pathlib import Path
from sim_mjx.synthesis import claims

claim = claims.take(Path(sys.argv[1]), "7")
print(claim is not None, flush=True)
sys.stdin.read()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / claims.FOLDER).mkdir()
    return tmp_path


def taken(folder: Path, task: str = "7") -> claims.Claim:
    claim = claims.take(folder, task)
    assert claim is not None
    return claim


def foreign(folder: Path, seconds: float, text: str | None = None, number: int = 0) -> None:
    """The claim of another machine, touched so long ago."""
    path = folder / claims.FOLDER / f"7-{number}"
    about = {"host": "elsewhere", "kernel": "another", "pid": 42, "locked": True}
    path.write_text(json.dumps(about) if text is None else text)
    touched = path.stat().st_mtime - seconds
    os.utime(path, (touched, touched))


def test_of_many_at_once_one_holds_it(folder: Path) -> None:
    for _ in range(20):
        start = threading.Barrier(8)

        def one(_: int, start: threading.Barrier = start) -> claims.Claim | None:
            start.wait()
            return claims.take(folder, "7")

        with ThreadPoolExecutor(8) as pool:
            got = list(filter(None, pool.map(one, range(8))))
        assert len(got) <= 1  # two that see each other may both step back
        for claim in got:
            claim.release()
    assert claims.take(folder, "8") is not None


def test_a_killed_holder_is_followed_at_once_and_a_living_one_is_not(folder: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "True\n"
        os.utime(folder / claims.FOLDER / "7-0", (0, 0))  # however long ago it was touched
        assert claims.take(folder, "7") is None
        [held] = claims.attempts(folder, "7")
        assert (held.state, held.pid) == ("held", child.pid)
        child.kill()
        child.wait()
        assert [one.state for one in claims.attempts(folder, "7")] == ["dead"]
        taken(folder).done()
    assert claims.take(folder, "7") is not None


@pytest.mark.parametrize("text", [None, "", '{"host": "el', '{"pid": "me"}'])
def test_holders_of_other_machines_live_as_long_as_their_lease(folder: Path, text: str | None) -> None:
    foreign(folder, claims.LEASE - 20, text, number=3)  # the files of earlier attempts have been cleared
    assert claims.take(folder, "7") is None
    foreign(folder, claims.LEASE + 1, text, number=3)
    claim = taken(folder)
    assert claim.path.name == "7-4"
    assert claims.take(folder, "7") is None


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS])
def test_who_may_only_look_sees_the_claims(folder: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def refused(**_: object) -> None:
        raise OSError(number, os.strerror(number))

    foreign(folder, claims.LEASE - 60)
    monkeypatch.setattr(claims.tempfile, "NamedTemporaryFile", refused)
    assert [one.state for one in claims.attempts(folder, "7")] == ["held"]


def test_where_there_are_no_locks_the_lease_tells(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    locked = taken(folder, "8")
    monkeypatch.setattr(claims.fcntl, "flock", missing)
    assert claims.take(folder, "8") is None  # by a process that has them
    locked.done()
    claim = taken(folder)
    assert claims.take(folder, "7") is None
    os.utime(claim.path, (0, 0))
    assert claims.take(folder, "7") is not None


def test_a_holder_touches_its_claim(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "HEARTBEAT", 0.01)
    claim = taken(folder)
    os.utime(claim.path, (0, 0))
    for _ in range(500):
        if claim.path.stat().st_mtime > 0:
            break
        threading.Event().wait(0.01)
    assert claim.path.stat().st_mtime > 0
    claim.done()
    assert not claim.path.exists()


def test_two_that_find_a_holder_dead_do_not_both_follow(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second looks before the first has taken over, and acts after it."""
    foreign(folder, claims.LEASE + 1)
    seen = claims.attempts(folder, "7")
    first = taken(folder)
    real = claims.attempts
    looks = [seen]
    monkeypatch.setattr(claims, "attempts", lambda *words: looks.pop() if looks else real(*words))
    assert claims.take(folder, "7") is None
    # the same where the notes of earlier attempts were cleared in between, so that the next number is free
    (folder / claims.FOLDER / "7-0").unlink()
    for earlier in ([claims.Attempt("7", 4, "dead", "", 0, 0.0)], []):
        looks = [earlier]
        assert claims.take(folder, "7") is None
    first.done()
    assert claims.take(folder, "7") is not None


def test_failures_are_noted_and_cleared(folder: Path) -> None:
    taken(folder).failed("ValueError: no.")
    taken(folder).failed("ValueError: " + "long" * 1000)
    taken(folder).release()
    other = taken(folder, "8")
    states = [one.state for one in claims.attempts(folder, "7")]
    assert states == ["failed", "failed", "released"]
    reasons = [one.reason for one in claims.attempts(folder, "7")]
    assert (reasons[0], len(reasons[1])) == ("ValueError: no.", 500)
    (folder / claims.FOLDER / ".clock-1").touch()
    claims.clear(folder)
    assert list(claims.board(folder)) == ["8"]
    assert claims.take(folder, "8") is None
    other.done()
    assert claims.board(folder) == {}


def test_a_full_disk_leaves_no_claim(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(OSError, match="No space"):
            claims.take(folder, "7")
        assert os.listdir(folder / claims.FOLDER) == []
    assert claims.take(folder, "7") is not None


def test_in_a_folder_that_is_gone_there_is_nothing_to_claim(tmp_path: Path) -> None:
    assert claims.take(tmp_path / "gone", "7") is None
    assert claims.board(tmp_path / "gone") == {}
    with claims.wait_for(tmp_path / "gone", "join") as ours:
        assert not ours


def test_nobody_waits_for_a_folder_moved_away_while_a_shard_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work" / "store.zarr").mkdir(parents=True)
    monkeypatch.setattr(claims.time, "sleep", lambda _: pytest.fail("it waits for ever"))
    with claims.wait_for(tmp_path / "work", "join") as ours:
        assert not ours
