"""Decoders of other libraries in a separate process: a crash, hang or excess of memory becomes one error message.

A damaged file can end the process that decodes it (scipy, Arrow) or keep it busy without end (HDF5). The child is begun
with the first file (about a second for MATLAB, half of one for the others), serves the files that follow, and is begun
again after a crash. Arrays come back as NPY files, everything else as JSON; nothing is pickled.
"""

from __future__ import annotations

import atexit
import importlib
import inspect
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from threading import Event, Lock, Timer
from typing import Any

import numpy as np

from rcbht_jax._util.optional import MissingPackage
from rcbht_jax._util.untrusted import DECODER_PATIENCE, check_file, decoder_limits
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.table import Table

# Reserve no memory ahead, which the limit would count.
_SPARING = {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1"}
_STOPPED = (-signal.SIGKILL, -getattr(signal, "SIGXCPU", signal.SIGKILL))
Decode = Callable[[Path, str], Iterable[Table]]


def apart(*libraries: str) -> Callable[[Decode], Callable[[Path, str], Iterator[Table]]]:
    """Let a reader of a module read every file in another process; see :func:`isolated`.

    Its attribute ``__wrapped__`` is the reader itself, which a damaged file can crash or keep busy without end.

    >>> @apart("h5py")
    ... def read(path: Path, name: str) -> Iterator[Table]:
    ...     yield Table(name, {})
    >>> [table.name for table in read.__wrapped__(Path("run.h5"), "run.h5")]
    ['run.h5']
    """

    def decorated(decode: Decode) -> Callable[[Path, str], Iterator[Table]]:
        @wraps(decode)
        def read(path: Path, name: str) -> Iterator[Table]:
            return isolated(decode, path, name, *libraries)

        return read

    return decorated


def isolated(decode: Decode, path: Path, name: str, *libraries: str) -> Iterator[Table]:
    """Tables that a function makes of a file, made in another process with limits of memory and time.

    >>> from rcbht_jax.io.importing.arrays import hdf5_tables
    >>> [table.name for table in isolated(hdf5_tables, Path("run.h5"), "run.h5", "h5py")]
    ['run.h5']

    Args:
        decode: a function of a module, of the arguments that follow.
        path: the file, or a folder that is one recording or data set.
        name: relative to the source.
        libraries: what it may import, such as "h5py": importing them takes none of the file's time and memory.

    Raises:
        InputError: that of ``decode``; or it crashed, took too long, or wanted more memory than the file can hold.
    """
    memory, seconds = decoder_limits(bytes_of(path))
    with tempfile.TemporaryDirectory() as folder:
        request = {
            "decode": f"{decode.__module__}:{decode.__qualname__}", "path": os.path.abspath(path), "shown": str(path),
            "name": name, "out": folder, "libraries": libraries, "memory": memory, "seconds": seconds,
        }  # fmt: skip
        answer = _decoder(os.getpid()).ask(path, request, seconds)
        if "missing" in answer:
            raise MissingPackage(*answer["missing"])
        if "error" in answer:
            raise InputError(answer["error"])
        for number, table in enumerate(answer["tables"]):
            files = {key: Path(folder, f"{number}-{k}.npy") for k, key in enumerate(table["columns"])}
            columns = {key: np.load(file, allow_pickle=False) for key, file in files.items()}
            intervals = tuple(map(tuple, table["intervals"]))
            tuples = {key: tuple(table[key]) for key in ("notes", "others", "lines", "faults")}
            yield Table(**{**table, "columns": columns, "intervals": intervals, **tuples})


def bytes_of(path: Path) -> int:
    """Bytes of a regular file, or of all files in a folder.

    >>> bytes_of(Path("run.h5")) > 0
    True

    Raises:
        InputError: it is neither.
    """
    if not path.is_dir():
        return check_file(path)
    return sum(os.lstat(Path(folder, name)).st_size for folder, _, files in os.walk(path) for name in files)


class _Decoder:
    """A child that decodes one file after another; it ends when its standard input does."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._child: subprocess.Popen[bytes] | None = None

    def ask(self, path: Path, request: dict[str, Any], seconds: float) -> dict[str, Any]:
        """The child's answer; InputError: it ended at this file."""
        with self._lock:
            child = self._child = self._child or _begun()
            assert child.stdin
            assert child.stdout
            patience, late = max(10 * seconds, DECODER_PATIENCE), Event()

            def give_up() -> None:
                late.set()
                child.kill()

            timer = Timer(patience, give_up)
            timer.start()
            try:
                with suppress(BrokenPipeError):
                    child.stdin.write(json.dumps(request).encode() + b"\n")
                    child.stdin.flush()
                line = child.stdout.readline()
            except BaseException:  # an interruption: nobody will read the answer
                self._end()
                raise
            finally:
                timer.cancel()
            if line.endswith(b"\n"):
                return json.loads(line)
            with suppress(subprocess.TimeoutExpired):  # its own exit status tells more than that of a kill
                child.wait(patience)
            status = self._end()
            if late.is_set():  # the processor had time left: the file need not be at fault
                raise InputError(f"{path} was not decoded within {patience:.0f} s; try again when the machine is idle.")
            how = f"was stopped after {seconds:.0f} s" if status in _STOPPED else f"crashed (status {status})"
            raise InputError(f"{path} is damaged: what decodes such files {how}.")

    def close(self) -> None:
        """End the child."""
        with self._lock:
            self._end()

    def _end(self) -> int:
        child, self._child = self._child, None
        if child is None:
            return 0
        child.kill()  # nothing, if it has crashed
        with suppress(BrokenPipeError):  # what it was not given any more
            child.communicate()
        return child.returncode


@cache
def _decoder(process: int) -> _Decoder:
    """The decoder of this process; after a fork another one, since two processes would mix their answers."""
    decoder = _Decoder()
    atexit.register(decoder.close)
    return decoder


def _begun() -> subprocess.Popen[bytes]:
    known = os.pathsep.join(dict.fromkeys(map(os.path.abspath, sys.path)))
    return subprocess.Popen(
        [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | _SPARING | {"PYTHONPATH": known},
        start_new_session=True,  # Ctrl-C is for the parent, which ends this one
    )


def serve() -> None:
    """Answer requests on standard input until it ends; the main function of the child."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a decoder prints is no answer
    for line in sys.stdin.buffer:
        answers.write(json.dumps(_answer(json.loads(line))).encode() + b"\n")
        answers.flush()


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    module, _, function = request["decode"].partition(":")
    try:
        _unlimit()  # imports are not limited as the last file was
        decode: Decode = inspect.unwrap(getattr(importlib.import_module(module), function))
        for library in request["libraries"]:
            with suppress(ImportError):  # the decoder names the missing one, if this file needs it
                importlib.import_module(library)
        _limit(request["memory"], request["seconds"])
        return {"tables": list(_saved(decode(Path(request["path"]), request["name"]), Path(request["out"])))}
    except MissingPackage as error:
        return {"missing": [error.package, error.extra]}
    except (InputError, OSError) as error:
        return {"error": str(error).replace(request["path"], request["shown"])}
    except (MemoryError, RecursionError) as error:
        return {
            "error": f"{request['shown']} is damaged: it asks for more memory than there is ({type(error).__name__})."
        }


def _saved(tables: Iterable[Table], folder: Path) -> Iterator[dict[str, Any]]:
    """Tables without their columns, which are saved in a folder."""
    for number, table in enumerate(tables):
        for k, column in enumerate(table.columns.values()):
            np.save(folder / f"{number}-{k}.npy", column, allow_pickle=False)
        fields = {key: getattr(table, key) for key in table.__dataclass_fields__}
        yield {**fields, "columns": list(table.columns), "units": dict(table.units), "facts": dict(table.facts)}


def _unlimit() -> None:
    """Remove the limits of memory and work of this process."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        for kind in (resource.RLIMIT_CPU, resource.RLIMIT_AS):
            most = resource.getrlimit(kind)[1]
            resource.setrlimit(kind, (most, most))


def _limit(memory: int, seconds: float) -> None:
    """Bound memory and work of this process from now on, where the system can."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        done = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(done + seconds), resource.getrlimit(resource.RLIMIT_CPU)[1]))
        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + memory, resource.getrlimit(resource.RLIMIT_AS)[1]))
