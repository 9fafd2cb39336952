"""``rcbht stream``, and what it shares with ``rcbht serve``."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from rcbht_jax._util import compile_cache
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.session import Session, paced
from rcbht_jax.io.messages import Message, Sample, read_live
from rcbht_jax.io.playback import read_folder, read_store
from rcbht_jax.io.rosbags import McapWriter, is_bag, read_bag


@dataclass(frozen=True)
class Source(Command):
    """Options of the commands that read a stream."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """Where the wrenches come from."""
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"], metavar="MODEL")] = Path("online.model")
    """Model file made by "rcbht train-online"."""
    trial: tuple[str, ...] = ()
    """Trials of a store; default all, one after the other."""
    arm: Literal["R", "L"] = "R"
    """Arm of a recorded trial."""
    starts: Literal["harmonised", "recorded", "none", "detected"] = "harmonised"
    """Where the sub-tasks of a recorded trial begin; detected = the model finds out (train-online --detect)."""
    topic: str = ""
    """Topic of a bag, where several carry wrenches."""
    rate: float = 10.0
    """Beliefs per second; 0 = one per window."""
    k: float = 0.70
    """Probability above which a belief is certain."""
    speed: float = 0.0
    """Pace of a recording: 1 = as recorded, 0 = as fast as possible."""
    bridge: float = 0.05
    """Gaps up to this many seconds are bridged; after longer ones everything starts anew."""
    silent: float = 1.0
    """Report a live source that says nothing for so many seconds."""
    compile_cache: Path | None = None
    """Folder for the compiled chain, so that the next start is quick; default in your cache folder."""

    def opened(self) -> tuple[Session, Iterator[Message]]:
        """A session with its model compiled, and the messages for it.

        Raises:
            InputError: no such model, no such source, or options that make no sense.
        """
        if not 0 <= self.speed < float("inf"):
            raise InputError(f"A stream cannot be replayed at {self.speed} times its pace; give zero or more.")
        messages = self._messages()
        compile_cache.use(self.compile_cache)
        introspector = Introspector(load(self.model), self.rate or None, self.k, detect=self.starts == "detected")
        session = Session(introspector, self.bridge)
        introspector.warm_up()
        return session, messages

    def _messages(self) -> Iterator[Message]:
        if self.source == "-":
            return read_live(sys.stdin.buffer, self.silent)
        path = Path(self.source)
        starts = "none" if self.starts == "detected" else self.starts
        if is_bag(path):
            return read_bag(path, self.topic)
        if (path / "zarr.json").is_file():
            return read_store(path, self.trial, self.arm, starts)
        if path.is_dir():
            return read_folder(path, self.arm, starts)
        raise InputError(f"{path} is no store, trial, bag or MCAP file; give - to read JSON lines on standard input.")


@dataclass(frozen=True)
class Stream(Source):
    """Beliefs and events from a stream of wrenches, as JSON lines.

    SOURCE is a store, the folder of one trial, a ROS 1 or ROS 2 bag, an MCAP file, or - for JSON lines on standard
    input, such as {"time": 0.005, "wrench": [Fx, Fy, Fz, Mx, My, Mz]} and {"begin": true} where a sub-task begins.
    What is odd about the stream (gaps, repeated or late readings, NaN, jitter, silence) is told as events, too.

    Example: rcbht stream hiro.zarr --trial 20121127-HIROSA-S-13 --model states.model --speed 1
    """

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="EVENTS.jsonl")] = None
    """File for the events; default standard output."""
    mcap: Annotated[Path | None, tyro.conf.arg(metavar="OUT.mcap")] = None
    """Also write wrench, labels, beliefs and events as MCAP for Foxglove and PlotJuggler."""

    def run(self) -> dict[str, Any]:
        session, messages = self.opened()
        told: Counter[str] = Counter()
        with ExitStack() as stack:
            out = stack.enter_context(self.out.open("w")) if self.out else sys.stdout
            mcap = stack.enter_context(McapWriter(self.mcap)) if self.mcap else None
            for message in paced(messages, self.speed):
                events = session.feed(message)
                for event in events:
                    told[type(event).__name__] += 1
                    out.write(json.dumps(event.to_json(), allow_nan=False) + "\n")
                if events:
                    out.flush()
                if mcap is not None:
                    _record(mcap, session, message, events)
        return {"source": self.source, "messages": dict(session.counts), "events": dict(told)}

    def text(self, result: dict[str, Any]) -> str:
        # Standard output belongs to the events.
        words = ", ".join(f"{count} {name}" for name, count in (result["messages"] | result["events"]).items())
        print(f"{result['source']}: {words or 'nothing'}", file=sys.stderr)
        return ""


def _record(mcap: McapWriter, session: Session, message: Message, events: list[Event]) -> None:
    """Write one message's part of the MCAP."""
    if isinstance(message, Sample) and np.isfinite(message.wrench).all():
        mcap.wrench(session.time, message.wrench)
    for event in events:
        mcap.event(event)
    if any(isinstance(event, Belief) for event in events):
        mcap.labels(session.time, session.introspector.labels[:, 0])
