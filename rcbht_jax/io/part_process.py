"""Processes that write parts of tables: threads of one process wait for each other's locks.

Each process is ``python -m rcbht_jax.io.part_process``. It is given a line of JSON that describes parts, and the bytes
of their arrays; a line on its standard output reports success or the error. It ends with its input, so that none
outlives its parent, and imports only what it needs, since there are many of them.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import last_line
from rcbht_jax.errors import InputError
from rcbht_jax.io.parts import Field, Layout, Part, put

_KINDS = {"InputError": InputError, "OSError": OSError}  # errors that are the same on both sides


class PartProcess:
    """A process that writes parts, one message after the other."""

    def __init__(self) -> None:
        self._report = tempfile.TemporaryFile()  # noqa: SIM115  # closed in "wait"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rcbht_jax.io.part_process"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._report,
            start_new_session=True,  # Ctrl-C is for the parent, which then ends this process
        )  # fmt: skip

    def send(self, path: Path, parts: Sequence[Part]) -> None:
        """Give it parts of tables below a folder to write; of their arrays nothing is kept here."""
        assert self._process.stdin is not None
        with suppress(OSError):  # it has ended: there will be no answer
            _send(self._process.stdin, path, parts)

    def wait_until_written(self) -> None:
        """Wait for the answer to what was sent.

        Raises:
            InputError, OSError: as of :func:`rcbht_jax.io.parts.put`.
            RuntimeError: anything else went wrong.
        """
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
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


def _send(sink: IO[bytes], path: Path, parts: Sequence[Part]) -> None:
    tables, arrays = list[Any](), list[NDArray[Any]]()
    for part in parts:
        own = {name: np.asarray(part.values[name]) for name in part.fields}
        kinds = {name: [values.dtype.str, values.shape] for name, values in own.items()}
        fields = {name: asdict(made) for name, made in part.fields.items()}
        tables.append([str(part.folder), asdict(part.layout), part.number, fields, kinds, part.hashed])
        arrays += own.values()
    sink.write(json.dumps([str(path), tables]).encode() + b"\n")
    for values in (values for values in arrays if values.nbytes):
        sink.write(np.ascontiguousarray(values).ravel().view(np.uint8).data)  # one that is contiguous is not copied
    sink.flush()


def _received(line: bytes, source: IO[bytes]) -> tuple[Path, list[Part]]:
    """The folder and the parts that :func:`_send` has written, after the first line."""
    path, tables = json.loads(line)
    parts = [
        Part(
            Path(folder), Layout(**layout), number, {name: _field(made) for name, made in fields.items()},
            {name: _array(source, np.dtype(dtype), tuple(shape)) for name, (dtype, shape) in kinds.items()},
            tuple(hashed),
        )
        for folder, layout, number, fields, kinds, hashed in tables
    ]  # fmt: skip
    return Path(path), parts


def _array(source: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    size = dtype.itemsize * math.prod(shape)
    return np.ndarray(shape, dtype, source.read(size)) if size else np.zeros(shape, dtype)


def _answer(path: Path, parts: Sequence[Part]) -> dict[str, str] | None:
    """Write parts; returns the error, None = none."""
    try:
        put(path, parts)
    except Exception as error:
        kind = next((name for name, known in _KINDS.items() if isinstance(error, known)), "")
        return {"kind": kind, "reason": str(error) if kind else f"{type(error).__name__}: {error}"}
    return None


def _field(made: Mapping[str, Any]) -> Field:
    return Field(**{**made, "dimensions": tuple(made["dimensions"]), "shape": tuple(made["shape"])})


def main() -> None:
    """Answer until there is no more input."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    while line := sys.stdin.buffer.readline():
        answers.write(json.dumps(_answer(*_received(line, sys.stdin.buffer))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
