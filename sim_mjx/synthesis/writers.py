"""Processes that write shards, beside the one that simulates: threads of one process wait for each other's locks.

A shard's arrays go to them through memory that both see. A process of its own is ``python -m
sim_mjx.synthesis.writers FOLDER``: a line of JSON on standard input names the arrays of a shard, a line on standard
output says that it is written, or why not. It ends with its input, so that none outlives who started it.
"""

from __future__ import annotations

import json
import mmap
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.untrusted import load_json
from rcbht_jax.errors import InputError
from sim_mjx.synthesis import shards
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.launch import last_line
from sim_mjx.synthesis.plan import check, job_of, manifest_of
from sim_mjx.synthesis.records import Arrays

MOST = 12  # shards that are written at the same time; each takes half a megabyte a trial
FEWEST = 4  # cores from which on there are processes for it
_ALIGNED = 64  # bytes
_KINDS = {"InputError": InputError, "OSError": OSError}  # errors that are the same on both sides


class Writers:
    """Writes shards of a store beside the simulation; a context that ends when all that was submitted is written.

    Args:
        draft: the store.
        apart: in processes; default: where there are cores for it.
    """

    def __init__(self, draft: Draft, apart: bool | None = None) -> None:
        cores = os.cpu_count() or 1
        missing = draft.shards - len(shards.finished(draft.folder))  # of a resumed job often few: none is begun in vain
        self.count = max(1, min(MOST, cores, missing))
        if apart is None:
            apart = cores >= FEWEST and missing >= FEWEST
        self._draft, self._idle = draft, SimpleQueue[_Process]()
        self._processes = [_Process(draft.folder) for _ in range(self.count if apart and _shares_memory() else 0)]
        for process in self._processes:
            self._idle.put(process)
        self._threads = ThreadPoolExecutor(self.count)

    def submit(self, shard: int, drawn: Any, rows: Arrays, labels: Arrays | None) -> Future[None]:
        """Write a shard; arguments as of :meth:`sim_mjx.synthesis.draft.Draft.write`."""
        return self._threads.submit(self._write, shard, drawn, rows, labels)

    def __enter__(self) -> Writers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._threads.shutdown(cancel_futures=error is not None)
        for process in self._processes:  # all at once: each takes a quarter of a second to end
            process.close()
        for process in self._processes:
            process.wait()

    def _write(self, shard: int, drawn: Any, rows: Arrays, labels: Arrays | None) -> None:
        if not self._processes:
            self._draft.write(shard, drawn, rows, labels)
            return
        process = self._idle.get()
        try:
            process.write(shard, rows, labels)
        finally:
            self._idle.put(process)


class _Process:
    """A process that writes one shard after the other."""

    def __init__(self, folder: Path) -> None:
        self._report = tempfile.TemporaryFile()  # noqa: SIM115  # closed in "wait"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "sim_mjx.synthesis.writers", str(folder)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._report, text=True,
            env={**os.environ, "JAX_PLATFORMS": "cpu"},
            start_new_session=True,  # Ctrl-C is for the simulation, which then ends this
        )  # fmt: skip

    def write(self, shard: int, rows: Arrays, labels: Arrays | None) -> None:
        source, sink = self._process.stdin, self._process.stdout
        assert source is not None
        assert sink is not None
        with _shared({"rows": rows} | ({} if labels is None else {"labels": labels})) as (place, arrays):
            try:
                source.write(json.dumps({"shard": shard, "memory": place, "arrays": arrays}) + "\n")
                source.flush()
                answer = sink.readline()
            except OSError:
                answer = ""
        if not answer:
            raise RuntimeError(
                f"a process that writes shards ended: {last_line(self._report) or 'it did not say why.'}"
            )
        error = json.loads(answer)
        if error is not None:
            raise _KINDS.get(error["kind"], RuntimeError)(error["reason"])

    def close(self) -> None:
        """Have it end."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):  # it has ended
                    stream.close()

    def wait(self) -> None:
        """Wait until it has ended."""
        self._process.wait()
        self._report.close()


def _shares_memory() -> bool:
    """Whether this system has memory that another process finds by name, and that vanishes with those who use it."""
    return hasattr(os, "memfd_create") and Path("/proc/self/fd").is_dir()


@contextmanager
def _shared(groups: Mapping[str, Arrays]) -> Iterator[tuple[str, dict[str, dict[str, Any]]]]:
    """Arrays in memory for another process: where it is, and dtype, shape and offset of each array in it."""
    places, size = dict[str, dict[str, Any]](), 0
    whole = {group: {name: _with_width(values) for name, values in arrays.items()} for group, arrays in groups.items()}
    for group, arrays in whole.items():
        places[group] = {}
        for name, values in arrays.items():
            places[group][name] = [values.dtype.str, values.shape, size]
            size += -(-values.nbytes // _ALIGNED) * _ALIGNED
    file = os.memfd_create("shard")
    try:
        os.ftruncate(file, max(size, 1))
        memory = mmap.mmap(file, max(size, 1))
        for group, arrays in whole.items():
            for name, values in arrays.items():
                np.copyto(_array(memory, *places[group][name]), values)
        yield f"/proc/{os.getpid()}/fd/{file}", places
    finally:
        os.close(file)


def _with_width(values: NDArray[Any]) -> NDArray[Any]:
    """Text of no letters has no bytes, which no array can be made from."""
    return values.astype("<U1") if values.dtype == np.dtype("<U0") else values


def _array(memory: mmap.mmap, dtype: str, shape: tuple[int, ...], offset: int) -> NDArray[Any]:
    return np.ndarray(tuple(shape), dtype, memory, offset)


def _received(message: Mapping[str, Any]) -> dict[str, Arrays]:
    """The arrays of a message, which share the memory of who sent it."""
    file = os.open(message["memory"], os.O_RDONLY)
    try:
        memory = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
    finally:
        os.close(file)
    return {
        group: {name: _array(memory, *place) for name, place in arrays.items()}
        for group, arrays in message["arrays"].items()
    }


def serve(folder: Path, source: IO[str], sink: IO[str]) -> None:
    """Write shards of a work folder as messages ask for it, until there are no more."""
    job = job_of(load_json(folder / shards.MANIFEST)["job"])
    manifest = manifest_of(job)
    shards.begin(folder, manifest)  # which refuses if the code has been edited since the simulation began
    draft = Draft(folder, job, check(job), manifest)
    for line in source:
        sink.write(json.dumps(_answer(draft, json.loads(line))) + "\n")
        sink.flush()


def _answer(draft: Draft, message: Mapping[str, Any]) -> dict[str, str] | None:
    """Write a shard; what went wrong."""
    shard = message["shard"]
    try:
        arrays = _received(message)
        draft.write(shard, draft.draw(shard), arrays["rows"], arrays.get("labels"))
    except Exception as error:
        kind = next((name for name, known in _KINDS.items() if isinstance(error, known)), "")
        return {"kind": kind, "reason": str(error) if kind else f"{type(error).__name__}: {error}"}
    return None


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    serve(Path(sys.argv[1]), sys.stdin, answers)
