"""Bags of ROS 1 and ROS 2 and MCAP files: a table per topic, recorded as it came."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_VALUES
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.json_lines import UNITS
from rcbht_jax.io.importing.table import Interval, Table
from rcbht_jax.io.messages import Malformed, stamp_of
from rcbht_jax.io.rosbags import WRENCH, messages, open_bag

MAX_ELEMENTS = 1024  # of an array in a message; longer ones are pictures and clouds of points
TEXT = "std_msgs/msg/String"
_UNITS = UNITS | {name.removeprefix("wrench."): unit for name, unit in UNITS.items()}


def read_bag_tables(path: Path, name: str, topic: str = "") -> Iterator[Table]:
    """A table per topic: ``stamp`` (s, of the header, of receipt where that is zero) and every number by its path.

    The header is that of the message, or of its first field that has one. Topics of texts become tracks of annotations:
    a text holds until the next one.

    Args:
        path: ``.bag``, ``.mcap``, ``.db3`` or the folder of a ROS 2 bag.
        name: relative to the source.
        topic: to read; "" = every topic of wrenches.

    Raises:
        InputError: not a bag, damaged at its beginning, too large, or it has no such topic.
    """
    with open_bag(path) as reader:
        chosen = [c for c in reader.connections if (c.topic == topic if topic else c.msgtype in WRENCH)]
        if not chosen:
            what = f"no topic {topic}" if topic else "no wrenches"
            raise InputError(f"{path} has {what}. Choose with --topic; its topics are {reader.listed_topics()}")
        texts = [c for c in reader.connections if c.msgtype == TEXT]
        topics = {c.topic: _Topic(c.msgtype) for c in chosen}
        spoken: dict[str, list[tuple[int, str]]] = {}
        problems: list[str] = []
        left = MAX_VALUES
        for found in messages(reader, [*chosen, *texts]):
            if isinstance(found, Malformed):
                problems.append(found.text)
                continue
            connection, received, message = found
            if connection.topic in topics:
                left -= topics[connection.topic].add(message, received)
                if left < 0:
                    raise InputError(f"{path} has more than {MAX_VALUES} numbers on {', '.join(topics)}; split it.")
            elif isinstance(text := getattr(message, "data", None), str):
                spoken.setdefault(connection.topic, []).append((received, text))
            else:  # the file defines the type otherwise
                problems.append(f"a text of {connection.topic} cannot be read")
    notes = tuple(dict.fromkeys(problem.split(" (")[0].replace(" ", "-") for problem in problems))
    for key, content in topics.items():
        if not content.received:
            raise InputError(f"{path} holds no readable message on {key}{': ' + problems[0] if problems else ''}.")
        table = content.table(name, spoken, notes)
        yield replace(table, name=f"{name}#{key}", part=key) if len(topics) > 1 else table


class _Topic:
    """Messages of one topic, as they come."""

    def __init__(self, msgtype: str) -> None:
        self._wrench = msgtype in WRENCH
        self._values = array("d")  # message after message
        self._names: tuple[str, ...] = ()
        self.received: list[int] = []
        self.other = 0  # messages of another shape than the first

    def add(self, message: Any, received: int) -> int:
        """Keep a message; returns its count of numbers."""
        numbers: dict[str, float] = {}
        _flatten("", message, numbers)
        if not self._names:
            self._names = tuple(numbers)
        if tuple(numbers) != self._names:
            self.other += 1
            return 0
        self._values.extend((stamp_of(_stamped(message), received), *numbers.values()))
        self.received.append(received)
        return len(numbers) + 1

    def table(self, name: str, spoken: dict[str, list[tuple[int, str]]], notes: tuple[str, ...]) -> Table:
        values = np.frombuffer(self._values).reshape(len(self.received), -1)
        columns = dict(zip(("stamp", *self._names), np.ascontiguousarray(values.T), strict=True))
        # a file may define the type with other fields, whose units are unknown
        units = {key: _UNITS[key] for key in self._names if key in _UNITS} if self._wrench else {}
        flags = (*notes, f"other-shape:{self.other}") if self.other else notes
        first, last = self.received[0], self.received[-1]
        return Table(name, columns, units=units, intervals=tuple(_spoken(spoken, first, last)), notes=flags)


def _stamped(message: Any) -> Any:
    """The message, or if it has no header the first of its fields that has one, as a wrench within others does."""
    fields = (getattr(message, field) for field in getattr(message, "__dataclass_fields__", ()))
    return next((one for one in (message, *fields) if hasattr(one, "header")), message)


def _spoken(spoken: dict[str, list[tuple[int, str]]], first: int, last: int) -> Iterator[Interval]:
    """Texts as intervals: from each one, or the first sample, until the next, or the end of the recording."""
    for topic, texts in spoken.items():
        ends = [*(time for time, _ in texts[1:]), math.inf]
        for (start, label), end in zip(texts, ends, strict=True):
            if label and end > first and start <= last:
                yield topic.strip("/") or "text", label, max(start - first, 0) * 1e-9, (end - first) * 1e-9


def _flatten(path: str, value: Any, into: dict[str, float]) -> None:
    """Numbers of a message by their path, but for its header."""
    if isinstance(value, bool | int | float | np.number):
        into[path] = float(value)
    elif isinstance(value, np.ndarray):
        if value.size <= MAX_ELEMENTS and value.dtype.kind in "fiub":
            into.update({f"{path}_{number}": float(one) for number, one in enumerate(value.ravel().tolist())})
    elif hasattr(value, "__dataclass_fields__") and len(into) < MAX_COLUMNS:
        for field in value.__dataclass_fields__:
            if field not in ("header", "__msgtype__"):
                _flatten(f"{path}.{field}" if path else field, getattr(value, field), into)
