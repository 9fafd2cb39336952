"""A live source of JSON lines: read in the background, so that silence can be told from a slow reader."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from rcbht_jax.errors import InputError
from rcbht_jax.io.messages import LineReader, Message, Silence, read_lines

_BACKLOG = 1000  # messages read ahead; beyond that the writer has to wait, and memory does not grow


def read_live(source: LineReader, silent: float = 1.0) -> Iterator[Message]:
    """Messages of ``source``, and :class:`Silence` each time nothing arrived for ``silent`` seconds.

    Raises:
        InputError: ``silent`` is not positive.
    """
    if not 0 < silent < float("inf"):
        raise InputError(f"silence cannot be {silent} s long; expected a positive number.")
    ready: queue.Queue[Message | BaseException | None] = queue.Queue(_BACKLOG)

    def read() -> None:
        try:
            for message in read_lines(source):
                ready.put(message)
            ready.put(None)
        except BaseException as error:  # handed over to the reader of the queue
            ready.put(error)

    threading.Thread(target=read, daemon=True).start()
    while True:
        try:
            message = ready.get(timeout=silent)
        except queue.Empty:
            yield Silence(silent)
            continue
        if message is None:
            return
        if isinstance(message, BaseException):
            raise message
        yield message
