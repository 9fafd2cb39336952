"""Shards are written beside the simulation: in processes where there are cores for them, else in threads."""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from types import TracebackType
from typing import Any

from rcbht_jax.io.part_process import PartProcess
from sim_mjx.synthesis import shards
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.records import Arrays

MOST = 3  # shards that are written at the same time; each takes a third of a megabyte of memory a trial
FEWEST = 4  # cores, and missing shards, from which on processes write


class Writers:
    """Writes shards of a store beside the simulation; leaving its context waits until all submitted ones are written.

    Args:
        draft: the store.
        apart: write in processes; default: only if there are cores for them.
    """

    def __init__(self, draft: Draft, apart: bool | None = None) -> None:
        cores = os.cpu_count() or 1
        missing = draft.shards - len(shards.finished(draft.folder))  # few of a resumed job: fewer processes
        self.count = max(1, min(MOST, cores, missing))
        if apart is None:
            apart = cores >= FEWEST and missing >= FEWEST
        self._draft, self._idle = draft, SimpleQueue[PartProcess]()
        self._processes = [PartProcess() for _ in range(self.count if apart else 0)]
        for process in self._processes:
            self._idle.put(process)
        self._threads = ThreadPoolExecutor(self.count)

    def submit(self, shard: int, drawn: Any, rows: Arrays, labels: Arrays | None) -> Future[None]:
        """Write a shard; arguments as of :meth:`sim_mjx.synthesis.draft.Draft.write`."""
        return self._threads.submit(self._write, shard, [(drawn, rows, labels)])

    def __enter__(self) -> Writers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._threads.shutdown(cancel_futures=error is not None)
        for process in self._processes:  # all at once: each takes a moment to end
            process.close()
        for process in self._processes:
            process.wait()

    def _write(self, shard: int, given: list[tuple[Any, Arrays, Arrays | None]]) -> None:
        """Write a shard, taken out of ``given`` so that its memory is free as soon as it has been sent."""
        if not self._processes:
            self._draft.write(shard, *given.pop())
            return
        process = self._idle.get()
        try:
            process.send(self._draft.path, self._draft.parts_of(shard, *given.pop()))
            process.wait_until_written()
        finally:
            self._idle.put(process)
