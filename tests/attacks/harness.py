"""Runs attacks: in children with limits of memory and time, or directly."""

from __future__ import annotations

import json
import os
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from tests.attacks import folders, names, readers, requests, streams, writers

SECONDS, PATIENCE = 20.0, 90.0  # of one attempt: of the processor, and by the clock of a busy machine
MEMORY = 3 * 2**30  # bytes beyond what a child begins with: a file may declare 2 GiB

READERS = {reader.name: reader for reader in (*readers.READERS, *folders.READERS)}
NAMES = (
    *(f"read {name}" for name in READERS),
    *(f"write {writer}" for writer in writers.WRITERS),
    "stream",
    "stream again",
    "names",
    "page",
)


def make_good(folder: Path) -> None:
    """The good files of all readers."""
    for reader in READERS.values():
        reader.make(folder / reader.name)


def attempt(number: int, seed: int, good: Path) -> tuple[str, str]:
    """One attack: its name, and "", "refused" or what is wrong."""
    name, key = NAMES[number % len(NAMES)], f"{seed}-{number}"
    kind, _, what = name.partition(" ")
    folder = Path(tempfile.mkdtemp(prefix="attack-"))
    try:
        if kind == "stream":
            return name, streams.attack(key)
        if kind == "names":
            return name, names.attack(key, folder)
        if kind == "page":
            return name, requests.attack(key)
        if kind == "write":
            return name, writers.attack(what, key, folder)
        return name, readers.attack(READERS[what], key, good / what, folder)
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return name, f"{type(error).__name__}: {str(error)[:120]} ({Path(at.filename).name}:{at.lineno})"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def in_children(numbers: range, seed: int, good: Path) -> Iterator[tuple[int, str, str]]:
    """Attempts in a child, and in another one from where a child died: number, name, what is wrong."""
    first = numbers.start
    while first < numbers.stop:
        for number, name, wrong in _in_child(range(first, numbers.stop), seed, good):
            yield number, name, wrong
            first = number + 1


def in_runners(numbers: range, seed: int, good: Path, count: int) -> Iterator[tuple[int, str, str]]:
    """As :func:`in_children`, by several processes at once: number, name, what is wrong, in order of number."""
    size, pipes = -(-len(numbers) // count), list[int]()
    for first in range(numbers.start, numbers.stop, size):
        read, write = os.pipe()
        if os.fork() == 0:
            with suppress(BaseException):
                for found in in_children(range(first, min(first + size, numbers.stop)), seed, good):
                    os.write(write, json.dumps(found).encode() + b"\n")
            os._exit(0)
        os.close(write)
        pipes.append(read)
    for read in pipes:  # which holds the lines of a batch
        with os.fdopen(read) as lines:
            yield from (tuple(json.loads(line)) for line in lines)
        os.wait()


def in_child(work: Callable[[], None]) -> None:
    """Do something in a child, so that this process starts no threads that a fork would lose."""
    if (child := os.fork()) == 0:
        with suppress(BaseException):
            work()
            os._exit(0)
        traceback.print_exc()
        os._exit(1)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError("the good files cannot be made")


def _in_child(numbers: range, seed: int, good: Path) -> Iterator[tuple[int, str, str]]:
    read, write = os.pipe()
    if (child := os.fork()) == 0:
        with suppress(BaseException):
            os.close(read)
            _limit()
            for number in numbers:
                signal.setitimer(signal.ITIMER_PROF, SECONDS)
                os.write(write, json.dumps([number, *attempt(number, seed, good)]).encode() + b"\n")
        os._exit(0)
    os.close(write)
    rest, number = b"", numbers.start
    while number < numbers.stop:
        ready, _, _ = select.select([read], [], [], PATIENCE)
        block = os.read(read, 2**16) if ready else b""
        if not block:
            break
        *whole, rest = (rest + block).split(b"\n")
        for line in whole:
            number, name, wrong = json.loads(line)
            yield number, name, wrong
            number += 1
    if number < numbers.stop:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    os.close(read)
    if number < numbers.stop:
        died = "waited without end" if not ready else f"died by signal {os.WTERMSIG(status)}"
        yield number, NAMES[number % len(NAMES)], died


def _limit() -> None:
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)


def clock() -> float:
    """Seconds, for progress."""
    return time.monotonic()
