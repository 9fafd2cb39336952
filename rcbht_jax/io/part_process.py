"""Processes that write parts of tables: threads of one process wait for each other's locks.

The arrays are passed in shared memory. Each process is ``python -m rcbht_jax.io.part_process``: a line of JSON on
standard input names the parts, a line on standard output reports success or the error. It ends with its input, so that
none outlives its parent, and imports only what it needs, since there are many of them.
"""

from __future__ import annotations

import json
import mmap
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import last_line
from rcbht_jax.errors import InputError
from rcbht_jax.io.parts import Field, Layout, Part, put

_ALIGNED = 64  # bytes
_KINDS = {"InputError": InputError, "OSError": OSError}  # errors that are the same on both sides


def available() -> bool:
    """Whether this system has shared memory that another process opens by name and that is freed with its users."""
    return hasattr(os, "memfd_create") and Path("/proc/self/fd").is_dir()


@dataclass(frozen=True)
class Shared:
    """Parts of tables below a folder in memory for another process.

    Attributes:
        message: to that process, JSON values.
        file: descriptor of the memory, which :meth:`close` gives back.
    """

    message: Mapping[str, Any]
    file: int

    def close(self) -> None:
        """Give back the memory."""
        os.close(self.file)


def shared(path: Path, parts: Sequence[Part]) -> Shared:
    """Copy parts of tables below a folder to memory for another process."""
    size, tables, pieces = 0, list[Any](), list[tuple[NDArray[Any], int]]()
    for part in parts:
        arrays = {}
        for name in part.fields:
            values = np.asarray(part.values[name])
            if values.dtype == np.dtype("<U0"):  # an array of empty text has no bytes to share
                values = values.astype("<U1")
            arrays[name] = [values.dtype.str, values.shape, size]
            pieces.append((values, size))
            size += -(-values.nbytes // _ALIGNED) * _ALIGNED
        fields = {name: asdict(made) for name, made in part.fields.items()}
        tables.append([str(part.folder), asdict(part.layout), part.number, fields, arrays, part.hashed])
    file = os.memfd_create("parts")
    try:
        os.ftruncate(file, max(size, 1))
        memory = mmap.mmap(file, max(size, 1))
        for values, offset in pieces:
            np.copyto(np.ndarray(values.shape, values.dtype, memory, offset), values)
    except BaseException:
        os.close(file)
        raise
    return Shared({"path": str(path), "memory": f"/proc/{os.getpid()}/fd/{file}", "tables": tables}, file)


class PartProcess:
    """A process that writes parts, one message after the other."""

    def __init__(self) -> None:
        self._report = tempfile.TemporaryFile()  # noqa: SIM115  # closed in "wait"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rcbht_jax.io.part_process"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._report, text=True,
            start_new_session=True,  # Ctrl-C is for the parent, which then ends this process
        )  # fmt: skip

    def write(self, given: Shared) -> None:
        """Write parts.

        Raises:
            InputError, OSError: as of :func:`rcbht_jax.io.parts.put`.
            RuntimeError: anything else went wrong.
        """
        source, sink = self._process.stdin, self._process.stdout
        assert source is not None
        assert sink is not None
        try:
            source.write(json.dumps(given.message) + "\n")
            source.flush()
            answer = sink.readline()
        except OSError:
            answer = ""
        if not answer:
            raise RuntimeError(f"a process that writes parts ended: {last_line(self._report) or 'no reason given.'}")
        error = json.loads(answer)
        if error is not None:
            raise _KINDS.get(error["kind"], RuntimeError)(error["reason"])

    def close(self) -> None:
        """End the process."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):  # it has ended
                    stream.close()

    def wait(self) -> None:
        """Wait until it has ended."""
        self._process.wait()
        self._report.close()


def _answer(message: Mapping[str, Any]) -> dict[str, str] | None:
    """Write parts; returns the error, None = none."""
    try:
        put(Path(message["path"]), _received(message))
    except Exception as error:
        kind = next((name for name, known in _KINDS.items() if isinstance(error, known)), "")
        return {"kind": kind, "reason": str(error) if kind else f"{type(error).__name__}: {error}"}
    return None


def _received(message: Mapping[str, Any]) -> list[Part]:
    """The parts of a message, whose arrays share the sender's memory."""
    file = os.open(message["memory"], os.O_RDONLY)
    try:
        memory = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
    finally:
        os.close(file)
    return [
        Part(
            Path(folder), Layout(**layout), number, {name: _field(made) for name, made in fields.items()},
            {name: np.ndarray(tuple(shape), dtype, memory, at) for name, (dtype, shape, at) in arrays.items()},
            tuple(hashed),
        )
        for folder, layout, number, fields, arrays, hashed in message["tables"]
    ]  # fmt: skip


def _field(made: Mapping[str, Any]) -> Field:
    return Field(**{**made, "dimensions": tuple(made["dimensions"]), "shape": tuple(made["shape"])})


def main() -> None:
    """Answer messages until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        answers.write(json.dumps(_answer(json.loads(line))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
