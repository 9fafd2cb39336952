"""Messages of a wrench source, and their form as JSON lines.

A line is one JSON object. ``{"wrench": [Fx, Fy, Fz, Mx, My, Mz], "time": 1.005}`` is a sample in N and Nm; ``time``
(s) is optional. A ROS ``Wrench`` or ``WrenchStamped`` as JSON (``{"force": {"x": ...}, "torque": ...}``, alone or
under ``wrench``, with ``header.stamp``) is a sample as well. With ``{"begin": true}`` a sub-task begins at the next
sample, with ``{"reset": true}`` a trial; a sample on the same line is that next one.
"""

from __future__ import annotations

import json
import math
import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rcbht_jax._util.untrusted import MAX_LINE
from rcbht_jax.errors import InputError

LONGEST_SILENCE = 1e9  # s: a thread cannot wait for more than some 9e9
_AXES = ("x", "y", "z")
BAGS = (".bag", ".mcap", ".db3")


@dataclass(frozen=True)
class Sample:
    """One reading; values and time may be NaN or infinite."""

    wrench: tuple[float, ...]  # one value for each axis, usually N and Nm
    time: float | None = None  # s


@dataclass(frozen=True)
class Begin:
    """A sub-task begins with the next sample."""

    label: str = ""  # its name, if it is known


@dataclass(frozen=True)
class Reset:
    """A trial begins with the next sample."""

    trial: str = ""  # its name, if it has one


@dataclass(frozen=True)
class Malformed:
    """Input that is not a message."""

    text: str  # what is wrong with it


@dataclass(frozen=True)
class Silence:
    """A live source has sent nothing for this many seconds."""

    seconds: float


Message = Sample | Begin | Reset | Malformed | Silence


@runtime_checkable
class LineReader(Protocol):
    """A binary file, as far as reading lines needs it."""

    def readline(self, size: int, /) -> bytes:
        """At most ``size`` bytes, up to and including the next line feed."""


def read_lines(source: LineReader) -> Iterator[Message]:
    """Messages of a binary file of JSON lines, in constant memory; empty lines are skipped.

    >>> import io
    >>> list(read_lines(io.BytesIO(b'{"begin": true}')))
    [Begin(label='')]
    """
    while raw := source.readline(MAX_LINE):
        if len(raw) == MAX_LINE and not raw.endswith(b"\n"):
            while raw and not raw.endswith(b"\n"):
                raw = source.readline(MAX_LINE)
            yield Malformed(f"a line is longer than {MAX_LINE} bytes")
        elif raw.strip():
            yield from _parsed(raw)


def parse(line: bytes | str) -> Message:
    """The message of a line that holds one; :class:`Malformed` if it holds none or several. Never raises.

    >>> parse('{"wrench": [0, 0, 5, 0, 0, 0.1], "time": 1.005}')
    Sample(wrench=(0.0, 0.0, 5.0, 0.0, 0.0, 0.1), time=1.005)
    """
    found = _parsed(line)
    return found[0] if len(found) == 1 else Malformed(f"a line has {len(found)} messages; expected one")


def _parsed(line: bytes | str) -> list[Message]:
    """The messages of one line, in their order: a reset, a begin, a reading."""
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return [Malformed("a line is not JSON that can be read")]
    try:
        return _messages(value)
    except (ValueError, OverflowError, TypeError) as error:
        return [Malformed(f"a line is not a message: {error}")]


def _messages(value: Any) -> list[Message]:
    if not isinstance(value, dict):
        raise TypeError("expected an object")
    found: list[Message] = [kind() for key, kind in (("reset", Reset), ("begin", Begin)) if value.get(key) is True]
    if not found or "wrench" in value or "force" in value:
        time = value.get("time", _stamp(value.get("header")))
        found.append(Sample(_values(value.get("wrench", value)), None if time is None else _number(time)))
    return found


def _values(wrench: Any) -> tuple[float, ...]:
    if isinstance(wrench, Mapping):
        parts = [part for part in map(wrench.get, ("force", "torque")) if isinstance(part, Mapping)]
        known = len(parts) == 2 and all(set(_AXES) <= set(part) for part in parts)
        wrench = [part[axis] for part in parts for axis in _AXES] if known else []
    if not isinstance(wrench, list) or not wrench:
        raise ValueError("expected wrench: a list of numbers, or force and torque with x, y and z")
    # JSON has no NaN; many sources write null.
    return tuple(math.nan if value is None else _number(value) for value in wrench)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("expected a number")
    return float(value)


def _stamp(header: Any) -> float | None:
    """Seconds of a ROS header: ``sec`` and ``nanosec`` (ROS 2) or ``secs`` and ``nsecs`` (ROS 1)."""
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping):
        return None
    for seconds, nanoseconds in (("sec", "nanosec"), ("secs", "nsecs")):
        if seconds in stamp:
            return _number(stamp[seconds]) + 1e-9 * _number(stamp.get(nanoseconds, 0))
    return None


def sample_of(message: Any, received: int = 0) -> Sample | Malformed:
    """The reading in a ROS message: anything with the fields of ``geometry_msgs/Wrench`` or ``WrenchStamped``.

    >>> from types import SimpleNamespace as Fields
    >>> sample_of(Fields(force=Fields(x=1, y=2, z=3), torque=Fields(x=4, y=5, z=6)), received=5_000_000_000)
    Sample(wrench=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), time=5.0)

    Args:
        message: of ROS 1, ROS 2, or read from a bag.
        received: ns, when it was received; its time where the header has no stamp.
    """
    try:
        wrench = getattr(message, "wrench", message)
        values = (getattr(part, axis) for part in (wrench.force, wrench.torque) for axis in _AXES)
        return Sample(tuple(float(v) for v in values), stamp_of(message, received))
    except Exception as error:  # a definition of its own in the bag
        return Malformed(f"a message cannot be read ({type(error).__name__}: {str(error)[:80]})")


def stamp_of(message: Any, received: int) -> float:
    """Seconds of the stamp in a message's header; of its receipt (ns) where there is no stamp above zero."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds, nanoseconds = (getattr(stamp, part, None) for part in ("sec", "nanosec"))
    if not isinstance(seconds, int | float) or not isinstance(nanoseconds, int | float):
        return received * 1e-9
    found = seconds + 1e-9 * nanoseconds
    return found if found > 0 else received * 1e-9


_BACKLOG = 1000  # messages read ahead; then the writer waits, so that memory stays bounded


def read_live(source: LineReader, silent: float = 1.0) -> Iterator[Message]:
    """Messages of ``source``, and :class:`Silence` each time nothing has arrived for ``silent`` seconds.

    Raises:
        InputError: ``silent`` is not positive, or longer than clocks count.
    """
    if not 0 < silent <= LONGEST_SILENCE:
        raise InputError(
            f"The silence is {silent} s; expected a positive number of seconds, at most {LONGEST_SILENCE:g}."
        )
    ready: queue.Queue[Message | BaseException | None] = queue.Queue(_BACKLOG)

    def read() -> None:
        try:
            for message in read_lines(source):
                ready.put(message)
            ready.put(None)
        except BaseException as error:  # raised again by the consumer of the queue
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


def is_bag(path: Path) -> bool:
    """Whether a path is named like a bag, or is a folder with the metadata of a ROS 2 bag."""
    return path.suffix in BAGS or (path / "metadata.yaml").is_file()
