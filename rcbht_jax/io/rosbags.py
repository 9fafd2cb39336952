"""ROS 1 and ROS 2 bags and MCAP files: ``geometry_msgs/WrenchStamped`` in, events out, without ROS."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from rcbht_jax._util.atomic import atomic_write, draft_of
from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_BAG_BYTES, MAX_BAG_INFO_BYTES, check_file, check_inside
from rcbht_jax.errors import InputError
from rcbht_jax.events import LEVELS, AnomalyScore, Belief, Event, Word
from rcbht_jax.io.bag_chunks import bound_chunks, take_packed, unpacked_file, unpacked_message
from rcbht_jax.io.mcap_file import seal, sound
from rcbht_jax.io.messages import BAGS, Malformed, Message, sample_of
from rcbht_jax.labels import AXES, LAYERS, UNITS, name

with needs_extra("stream"):
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WRENCH = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
LATEST = 2.0**31 - 1  # s, the last stamp that ROS can hold
_MESSAGES = {  # of the package rcbht_msgs
    "Labels": """std_msgs/Header header
string[] axis
int32[] primitive
int32[] mc
int32[] llb
string[] primitive_name
string[] mc_name
string[] llb_name
""",
    "Signal": """std_msgs/Header header
string[] axis
float64[] value
""",
    "Belief": """std_msgs/Header header
string head
string label
int32 code
float64 probability
string level
int32 level_code
float64 certain_for
string[] classes
float64[] probabilities
""",
    "Word": """std_msgs/Header header
string layer
string axis
string label
int32 code
float64 start
float64 stop
""",
    "Score": """std_msgs/Header header
float64 score
float64 threshold
float64 p_value
""",
    "Event": """std_msgs/Header header
string event
string json
""",
}


def read_bag(path: Path, topic: str = "") -> Iterator[Message]:
    """Wrenches of one topic in N and Nm, timed by the stamp in their header (by receipt where it is zero).

    A message that cannot be read becomes :class:`Malformed`, and so does each problem of the file: of an MCAP file that
    is cut off or damaged, the intact parts are read.

    >>> for message in read_bag(Path("assembly.mcap"), "/wrench"):  # doctest: +SKIP
    ...     print(message)

    Args:
        path: ``.bag``, ``.mcap``, ``.db3``, or the folder of a ROS 2 bag.
        topic: needed if the bag has several topics of wrenches.

    Raises:
        InputError: the file is missing, not a bag, or has no such topic.
    """
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.msgtype in WRENCH]
        topics = sorted({c.topic for c in connections})
        if not topics and reader.problems:
            raise InputError(f"{path} is damaged ({reader.problems[0]}), and nothing is left of its wrenches.")
        if not topics:
            raise InputError(f"{path} has no wrenches; its topics are {reader.listed_topics()}")
        if topic and topic not in topics:
            raise InputError(f"{path} has no wrenches on {topic}; it has them on {', '.join(topics)}.")
        if not topic and len(topics) > 1:
            raise InputError(
                f"{path} has wrenches on {len(topics)} topics ({', '.join(topics)}); choose one with --topic."
            )
        for found in messages(reader, [c for c in connections if c.topic == (topic or topics[0])]):
            yield found if isinstance(found, Malformed) else sample_of(found[2], found[1])


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A reader of a bag.

    >>> with open_bag(Path("assembly.mcap")) as reader:  # doctest: +SKIP
    ...     print([connection.topic for connection in reader.connections])

    Raises:
        InputError: the file is missing, too large or not a bag.
    """
    if not path.exists():
        raise InputError(f"{path} does not exist; expected a bag or an MCAP file.")
    with ExitStack() as stack:
        sources, whole, problems, foreign = list[Path](), True, list[str](), False
        for part in _files(path):
            plain = part if part == path else stack.enter_context(unpacked_file(part))
            found, wrong = stack.enter_context(sound(plain))  # nothing for a file that is no MCAP
            sources += [found] if found.suffix == ".mcap" else []
            whole &= found == plain
            problems += wrong
            foreign |= found != plain and not wrong
        sources = [path] if whole else sources
        refused = InputError(
            f"{path} holds messages that are not of ROS 2, which alone are read of an MCAP file; save its topics of "
            "ROS 2 by themselves, or the wrench as CSV or JSON lines."
        )
        try:
            reader = Bag(sources, default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
            stack.callback(reader.close)
            bound_chunks(reader)
            take_packed(reader)
        except Exception as error:  # a damaged file fails in any way inside the reader
            text = str(error).replace(str(sources[0]), str(path)).rstrip(".") or type(error).__name__
            raise refused if foreign else InputError(f"{path} is not a readable bag: {text}.") from error
        if foreign and not reader.connections:
            raise refused
        reader.problems, reader.foreign = tuple(problems), foreign
        yield reader


class Bag(AnyReader):
    """A reader with the problems of its file, and whether messages that are not of ROS 2 are left out."""

    problems: tuple[str, ...] = ()
    foreign = False

    def listed_topics(self) -> str:
        """The end of a sentence about a topic that is not there."""
        topics = sorted({connection.topic for connection in self.connections})
        more = " Messages in other encodings than that of ROS 2 are not read." if self.foreign else ""
        return f"{', '.join(topics[:20]) or 'none'}.{more}"


def _files(path: Path) -> list[Path]:
    """The files of a bag, each of which is checked."""
    if not path.is_dir():
        check_file(path, MAX_BAG_BYTES)
        return [path]
    check_inside(path, path)
    parts = [part for part in sorted(path.iterdir()) if not part.is_dir()]  # the metadata may name any of them
    for part in parts:
        about = part.name == "metadata.yaml"
        check_file(part, MAX_BAG_INFO_BYTES if about else MAX_BAG_BYTES, empty=not (about or part.suffix in BAGS))
    return parts


def messages(reader: Bag, connections: Sequence[Any]) -> Iterator[tuple[Any, int, Any] | Malformed]:
    """Connection, time of receipt (ns) and content of every message of some connections, in order of receipt.

    A message that cannot be read becomes :class:`Malformed`, and so does each problem of the file.
    """
    for problem in reader.problems:
        yield Malformed(f"the bag is damaged ({problem}); what is whole of it is read")
    raw_messages = reader.messages(connections=connections)
    while True:
        try:
            connection, received, raw = next(raw_messages)
        except StopIteration:
            return
        except Exception as error:  # a truncated file
            yield Malformed(f"the bag ends early ({type(error).__name__}: {str(error)[:80]})")
            return
        try:
            plain = unpacked_message(raw) if reader.is2 else raw
            yield connection, received, reader.deserialize(plain, connection.msgtype)
        except Exception as error:
            yield Malformed(f"a message cannot be read ({type(error).__name__}: {str(error)[:80]})")


def is_wrench(axes: Sequence[str], units: Sequence[str] = ()) -> bool:
    """Whether axes are those of a wrench, in its order and its units, by the letters in their names or by their units.

    >>> is_wrench(["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]), is_wrench(["Fz", "Fx", "Fy", "Tz", "Tx", "Ty"])
    (True, False)
    >>> is_wrench(["F1", "F2", "F3", "T1", "T2", "T3"], ["N"] * 3 + ["Nm"] * 3), is_wrench(["F1", "F2", "F3", "T1"])
    (True, False)

    Args:
        axes: their names; without the letters x, y and z they are in order, and need units: fingers and thumbs begin
            with F and T as well.
        units: of the axes, "" = unknown; () = all unknown.
    """
    kinds = "".join(axis[:1] for axis in axes).upper()
    letters = "".join(next((letter for letter in axis[1:].lower() if letter in "xyz"), "") for axis in axes)
    right = all(unit in ("", own) for unit, own in zip(units, UNITS, strict=False))
    named = right if letters == "xyzxyz" else letters == "" and tuple(units) == UNITS
    return kinds in ("FFFMMM", "FFFTTT") and named


class McapWriter:
    """Context manager that writes a stream as an MCAP file for Foxglove and PlotJuggler.

    Topics: ``/wrench`` (``geometry_msgs/WrenchStamped``; ``/signal`` where axes or units are not those of one),
    ``/labels`` (codes and names per axis), ``/words`` (as they are published), ``/belief/HEAD``, ``/monitor`` (the
    scores of a nominal monitor) and ``/events`` (JSON). The file appears when the block ends; also when an error or an
    interruption ends it, with what was written until then, if anything was. A trial whose stamps do not continue those
    before begins a second after their end. Stamps of ROS begin in 1970 and end in 2038: if the first message lies
    outside, it is at time zero; single messages outside get the nearest stamp.

    Raises:
        InputError: the folder of the file does not exist.
    """

    def __init__(self, path: Path, axes: Sequence[str] = AXES, units: Sequence[str] = ()) -> None:
        if not path.parent.is_dir():
            raise InputError(f"{path.parent} is not a folder; create it first.")
        self._path, self._axes, self._is_wrench = path, list(axes), is_wrench(axes, units)
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for kind, text in _MESSAGES.items():
            self._store.register(get_types_from_msg(text, f"rcbht_msgs/msg/{kind}"))
        self._connections: dict[str, Any] = {}
        self._origin: float | None = None  # s, what is written as time zero
        self._latest = 0.0  # s, of what is written so far

    def __enter__(self) -> McapWriter:
        with ExitStack() as stack:
            draft = stack.enter_context(atomic_write(self._path, keep=True))
            folder = draft_of(draft)
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            # the writer makes a folder with a file of its name in it, and the file says what it is called
            bag = folder / self._path.stem
            self._writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
            stack.push(partial(self._finish, bag, draft))
            self._exit = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._exit.__exit__(*error)

    def _finish(self, bag: Path, draft: Path, kind: type[BaseException] | None, *_: object) -> None:
        self._writer.close()
        if kind is None or self._connections:  # an hour of recording is worth more than its missing end
            [file] = bag.glob("*.mcap")
            seal(file)
            os.replace(file, draft)

    def _write(self, topic: str, kind: str, time: float, **fields: Any) -> None:
        types = self._store.types
        if self._origin is None:
            self._origin = 0.0 if 0 <= time <= LATEST else time
        nanoseconds = round(min(max(time - self._origin, 0.0), LATEST) * 1e9)
        self._latest = max(self._latest, nanoseconds * 1e-9)
        stamp = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        raw = self._store.serialize_cdr(types[kind](header=header, **fields), kind)
        self._writer.write(self._connections[topic], nanoseconds, raw)

    def trial(self, start: float) -> None:
        """A trial begins at a stamp, before its first message: in the file it follows the one before."""
        if self._origin is not None and start - self._origin <= self._latest:
            self._origin = start - self._latest - 1.0

    def wrench(self, time: float, values: tuple[float, ...]) -> None:
        """One reading: N and Nm of a wrench, or the values of other axes as ``rcbht_msgs/Signal``."""
        if not self._is_wrench:
            self._write("/signal", "rcbht_msgs/msg/Signal", time, axis=self._axes, value=np.array(values))
            return
        vector = self._store.types["geometry_msgs/msg/Vector3"]
        force, torque = (vector(**dict(zip("xyz", part, strict=True))) for part in (values[:3], values[3:]))
        wrench = self._store.types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
        self._write("/wrench", WRENCH[0], time, wrench=wrench)

    def labels(self, time: float, codes: Int[np.ndarray, "3 axis"]) -> None:
        """Latest published label of every layer and axis, 0 = none yet."""
        fields: dict[str, Any] = {"axis": self._axes}
        for layer, row in zip(LAYERS, codes, strict=True):
            fields[layer] = row.astype(np.int32)
            fields[f"{layer}_name"] = [name(layer, int(code)) for code in row]
        self._write("/labels", "rcbht_msgs/msg/Labels", time, **fields)

    def interval(self, time: float, label: str, track: str, start: float, end: float | None) -> None:
        """An annotated interval, on ``/events``; start and end in s, None = not known."""
        text = json.dumps({"label": label, "track": track, "start": start, "end": end}, allow_nan=False)
        self._write("/events", "rcbht_msgs/msg/Event", time, event="Interval", json=text)

    def event(self, event: Event) -> None:
        """One event; words, the beliefs of every head, and the scores of a monitor have their own topics."""
        if isinstance(event, Word):
            fields = {key: getattr(event, key) for key in ("layer", "axis", "label", "code", "start", "stop")}
            self._write("/words", "rcbht_msgs/msg/Word", event.time, **fields)
            return
        if isinstance(event, AnomalyScore):
            fields = {key: getattr(event, key) for key in ("score", "threshold", "p_value")}
            self._write("/monitor", "rcbht_msgs/msg/Score", event.time, **fields)
            return
        if not isinstance(event, Belief):
            text = json.dumps(event.to_json(), allow_nan=False)
            self._write("/events", "rcbht_msgs/msg/Event", event.time, event=type(event).__name__, json=text)
            return
        self._write(
            f"/belief/{event.head.replace('-', '_')}", "rcbht_msgs/msg/Belief", event.time, head=event.head,
            label=event.label, code=event.classes.index(event.label), probability=event.probability,
            level=event.level, level_code=LEVELS.index(event.level), certain_for=event.certain_for,
            classes=list(event.classes), probabilities=np.array(event.probabilities),
        )  # fmt: skip
