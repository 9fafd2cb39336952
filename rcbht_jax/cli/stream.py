"""``rcbht train-online``, ``stream``, ``serve`` and ``export-model``: beliefs from a stream of wrenches."""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections import Counter, deque
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import tyro

from rcbht_jax._util.arms import rows_of_arm
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, left_out, option, progress_bar, unset
from rcbht_jax.cli.rules import RuleCommand
from rcbht_jax.cli.source import Source
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.events import Event
    from rcbht_jax.introspection.model import IntrospectionModel
    from rcbht_jax.introspection.session import Session
    from rcbht_jax.introspection.training import HeadSpec
    from rcbht_jax.io.messages import Message
    from rcbht_jax.io.rosbags import McapWriter
    from rcbht_jax.learning.tasks import LabelledIntervals
    from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class TrainOnline(RuleCommand):
    """Train a model that computes beliefs from a stream: one classifier per task, calibrated on held-out trials.

    Example: rcbht train-online hiro.zarr --source REAL_HIRO_ONE_SA_SUCCESS -o states.model
    """

    store: common.Store
    """Store of recordings; label tracks are not needed."""
    task: Annotated[tuple[str, ...], option("Tasks, each with a classifier of its own.", common.ONLY_TRACK)] = ()
    detect: Flag = False
    """Also learn to detect when a sub-task of the first track in --task begins, for streams that do not say so."""
    false_alarms: Annotated[
        float,
        option(
            "Rate of false alarms per nominal trial that lasts no longer than those of the training (or their "
            "--first-seconds), for the task outcome, such as 0.02; 0 = alarm above the certainty of "
            '"rcbht stream --certainty".'
        ),
    ] = 0.0
    first_seconds: float = 0.0
    """Train on only the first seconds of each recording, this many, so that its length is no feature; 0 = on all."""
    source: common.Sources = ()
    session: common.Sessions = ()
    outcome: common.Outcomes = ()
    families: Annotated[tuple[common.StreamFamily, ...], unset()] = ()
    """Feature families; default those chosen for sub-tasks or for whole trials."""
    ranks: Flag = False
    """Replace every feature of a whole trial by its rank in the training set."""
    relative: Flag = False
    """Use only features that do not depend on absolute forces or times, such as the bias of the sensor."""
    weighing: common.Weighing = ()
    seed: int = 0
    """Seed of the folds."""
    out: common.OutModel = Path("online.model")

    FORMER: ClassVar[dict[str, str]] = {
        "--tasks": "--task", "--features relative": "--relative", "--features all": "",
    }  # fmt: skip

    def run(self) -> dict[str, Any]:
        from rcbht_jax.encoding.rules import made_by
        from rcbht_jax.introspection.model import save
        from rcbht_jax.introspection.training import train_model, training_items
        from rcbht_jax.io.store import read_recordings
        from rcbht_jax.learning.tasks import chosen_recordings

        recordings = read_recordings(self.store)
        specs = self._heads(recordings)
        config = self.config(recordings.dt)
        rows = np.flatnonzero(np.any([chosen_recordings(recordings, spec.task) for spec in specs], axis=0))
        training = recordings.take(rows) if len(rows) else recordings  # without any, training raises the error
        of_arm, remarks = rows_of_arm(training.arm, "")
        training = training.take(of_arm)
        limits = self.limits(config, self.read_limits(training, self.store)[0], training)
        with progress_bar("train", "snapshots") as bar:

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done)

            items = [training_items(recordings, spec, config, self.seed) for spec in specs]
            model = train_model(recordings, specs, config, limits, self.seed, progress, items)
        save(self.out, model)
        encoder, heads = made_by(config, limits)["config"], _summaries(recordings, items, model)
        how = {"encoder": encoder, "data_hash": model.data_hash, "remarks": remarks}
        return {"model": str(self.out), "heads": heads, **how}

    def _heads(self, recordings: Recordings) -> tuple[HeadSpec, ...]:
        """What is learned: a classifier per task, and one that detects when sub-tasks begin."""
        from rcbht_jax.introspection.training import HeadSpec
        from rcbht_jax.learning.task_choice import chosen_task
        from rcbht_jax.learning.tasks import TaskSpec, track_of

        if self.relative and self.families:
            raise InputError("--relative is a choice of feature families; leave it out, or leave out --families.")
        names = self.task or (chosen_task("", recordings),)
        filters = TaskSpec(
            "", sources=self.source, sessions=self.session, outcomes=self.outcome or None, seconds=self.first_seconds
        )
        tasks = [replace(filters, task=name) for name in names]
        phases = [task for task in tasks if track_of(recordings, task)][:1] if self.detect else []
        if self.detect and not phases:
            raise InputError(f"--detect needs a task that is a track of annotations, not {', '.join(names)}.")
        head = partial(
            HeadSpec,
            families=self.families,
            relative=self.relative,
            ranks=self.ranks,
            false_alarms=self.false_alarms,
            weighing=self.weighing,
        )
        return (*(head(task, phase=False) for task in tasks), *(head(task, phase=True) for task in phases))

    def text(self, result: dict[str, Any]) -> str:
        by = " of words by the fit rule" if result["encoder"]["rule"] == "fit" else ""
        lines = [f"{result['model']}: {plural(len(result['heads']), 'classifier')}{by}"]
        for name, head in result["heads"].items():
            classes = ", ".join(head["classes"])
            svm = f"{head['kernel']} kernel, C = {head['cost']:g}, {head['features']} features"
            lines.append(f"{name}: {classes}; {svm}")
            lines += [f"  {line}" for line in left_out(head["dropped"])]
            lines += [f"  confounds: {head['confounds']}"] * bool(head["confounds"])
        return "\n".join([*lines, *result["remarks"]])


@dataclass(frozen=True)
class Stream(Source):
    """Compute words, beliefs and events from a stream of wrenches, as JSON lines.

    Without --model, words are reported, for any axes; with a model, beliefs. INPUT is a store, the folder of one trial,
    a ROS 1 or ROS 2 bag, an MCAP file, or - for JSON lines on standard input: {"time": 0.005, "wrench": [Fx, Fy, Fz,
    Mx, My, Mz]}, for example, and {"begin": true} where a sub-task begins. Irregularities of the stream (gaps, repeated
    or late samples, NaN, jitter, silence) are reported as events.

    Example: rcbht stream hiro.zarr --trial 20121127-HIROSA-S-13 --model states.model --speed 1
    """

    out: Annotated[Path | None, unset(aliases=["-o"], metavar="EVENTS.jsonl")] = None
    """File for the events; it appears when the stream ends, but a pipe gets each at once. Default standard output."""
    mcap: Annotated[Path | None, unset(metavar="OUT.mcap")] = None
    """MCAP file for wrench, labels, words, beliefs and events, to open in Foxglove or PlotJuggler."""
    words: Flag = False
    """Report words as well as beliefs; without a model, words are always reported."""
    provisional: Flag = False
    """Also report unfinished words, from their second window on and whenever their label changes."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.atomic import atomic_lines
        from rcbht_jax.introspection.words import Revisions

        if self.mcap:
            from rcbht_jax.io.rosbags import McapWriter  # of the extra stream, which lines do not need

        session, messages = self.opened(self.words or self.provisional)
        window, revisions = session.introspector.config.window, Revisions()
        counts: Counter[str] = Counter()
        # A wrong source is refused before a file is touched, and before programs are compiled.
        timed = self.source == "-" or self.pace > 0
        first = [] if timed else list(itertools.islice(messages, 1))
        session.introspector.warm_up()
        first = first or list(itertools.islice(messages, 1))
        with ExitStack() as stack:
            out = stack.enter_context(atomic_lines(self.out)) if self.out else sys.stdout
            signal = session.introspector.axes, session.introspector.units
            mcap = stack.enter_context(McapWriter(self.mcap, *signal)) if self.mcap else None

            early: deque[Event] = deque(maxlen=100)  # for the MCAP: before the first reading, no clock is known

            def report(events: list[Event], message: Message | None = None, latest: float = 0.0) -> None:
                for event in events:
                    counts[type(event).__name__] += 1
                    out.write(json.dumps(event.to_json(), allow_nan=False) + "\n")
                if events:
                    out.flush()
                if session.counts["sample"] <= _left_out(session):
                    early.extend(events)
                elif mcap is not None:
                    stamped = [replace(event, time=session.time) for event in early]
                    early.clear()
                    _record(mcap, session, message, stamped + events, latest)

            try:
                for message in itertools.chain(first, messages):
                    before, left_out, latest = session.introspector.received, _left_out(session), session.time
                    events = session.feed(message)
                    report(events, message if _left_out(session) == left_out else None, latest)
                    received = session.introspector.received
                    if session.ended is not None:  # words that begin at the same sample are others
                        revisions = Revisions()
                    elif self.provisional and received // window != before // window:
                        report([*revisions.after_window(session.introspector.provisional())])
            except KeyboardInterrupt:  # also SIGTERM: the recording is finished first
                report(session.finish())
                raise
            report(session.finish())
        return {"source": self.source, "messages": dict(session.counts), "events": dict(counts)}

    def text(self, result: dict[str, Any]) -> str:
        # Standard output belongs to the events.
        read, made = _counts(result["messages"]), _counts(result["events"])
        print(f"{result['source']}: messages read: {read}; events: {made}", file=sys.stderr)
        return ""


@dataclass(frozen=True)
class Serve(Source):
    """Show a stream on a live web page: the wrench, its words and, with a model, the beliefs.

    Any number of axes is shown. INPUT is as for "rcbht stream". The page loads nothing from the network, accepts no
    input, and is reachable from this machine only, unless --host is given. Ctrl-C stops the server.

    Example: rcbht serve recording.bag --topic /wrench --robot auto
    """

    host: str = "127.0.0.1"
    """Address to serve at; 0.0.0.0 makes the page reachable from other machines."""
    port: int = 8080
    """Port; 0 = any free port."""
    stay: Flag = True
    """Exit when the input ends, instead of showing its end until Ctrl-C."""
    rule: Annotated[
        Literal["paper", "fit"],
        option(
            "Rule of the words shown, even if the beliefs of the model use other words: fit, whose words follow the "
            "signal and wait for at most a fraction of a second; or paper."
        ),
    ] = field(default="fit", kw_only=True)

    SPEED: ClassVar[float] = 1.0
    OWN_WORDS: ClassVar[bool] = True

    def run(self) -> dict[str, Any]:
        from rcbht_jax.report.live_frames import Frames
        from rcbht_jax.report.live_page import PageServer

        # What is wrong with the options is said before the page opens, and so is what is wrong with a recording.
        self.check()
        ready = None if self.waits() else self.opened(words=True)
        with PageServer(host=self.host, port=self.port) as server:
            print(f"Open {server.url} in a browser; Ctrl-C stops the server.", file=sys.stderr, flush=True)
            server.status("waiting for the first readings")
            session, messages = ready or self.opened(words=True, say=server.status)
            server.show(session)
            server.status("compiling the encoder, a few seconds")
            session.introspector.warm_up()
            server.status("")
            frames = Frames(session, server.broadcast)
            for message in messages:
                frames.feed(message)
            frames.finish()
            if self.stay:
                server.status("the input has ended")
            while self.stay:
                time.sleep(0.5)
        return {"source": self.source, "messages": dict(session.counts)}

    def text(self, result: dict[str, Any]) -> str:
        return f"{result['source']}: messages read: {_counts(result['messages'])}"


@dataclass(frozen=True)
class ExportModel(Command):
    """Write the whole chain of a model, from wrench to beliefs, as StableHLO that runs with JAX alone.

    The file examples/run_chain.py of the sources runs it without rcbht-jax.

    Example: rcbht export-model states.model -o states.chain
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL"), common.ONLINE_MODEL]
    """Model file of "rcbht train-online"."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="CHAIN")] = Path("online.chain")
    """File to write: a zip archive of StableHLO, the initial state and a description."""
    platforms: tuple[Literal["cpu", "cuda", "rocm", "tpu"], ...] = ("cpu", "cuda")
    """Platforms to compile for."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.introspection.model import load
        from rcbht_jax.introspection.stablehlo import write_chain

        meta = write_chain(self.out, load(self.model), self.platforms)
        return {"chain": str(self.out), "bytes": self.out.stat().st_size, **meta}

    def text(self, result: dict[str, Any]) -> str:
        heads = ", ".join(head["name"] for head in result["heads"])
        platforms = " and ".join(result["platforms"])
        return f"{result['chain']}: {heads} for {platforms}, {result['bytes'] / 1e6:.1f} MB"


def _summaries(recordings: Recordings, items: list[LabelledIntervals], model: IntrospectionModel) -> dict[str, Any]:
    """What was learned, by classifier: classes, machine, classes left out, and what else predicts the class."""
    from rcbht_jax.learning.confounds import confounds
    from rcbht_jax.learning.wrench_facts import WrenchFacts

    facts = WrenchFacts.of(recordings)
    return {
        head.name: {
            "classes": list(head.classes),
            "kernel": head.machine.svm.spec.kernel,
            "cost": head.machine.svm.spec.cost,
            "features": int(head.machine.svm.center.size),
            "dropped": learnt.dropped,
            "confounds": " ".join(confounds(learnt, facts)),
        }
        for learnt, head in zip(items, model.heads, strict=True)
    }


def _left_out(session: Session) -> int:
    """How many readings were not used so far."""
    return sum(session.counts[kind] for kind in ("not-finite", "late", "repeated"))


def _record(mcap: McapWriter, session: Session, message: Message | None, events: list[Event], latest: float) -> None:
    """Write one message's part of the MCAP; a reading has the time of its own stamp, the one before that of latest."""
    from rcbht_jax.events import Belief, TrialStarted, Word
    from rcbht_jax.introspection.resampling import CLOCK_JUMP
    from rcbht_jax.io.messages import Sample

    if isinstance(message, Sample) and session.time < latest - CLOCK_JUMP:  # words that end are of the time before
        for event in events:
            if event.time > session.time:
                mcap.event(event)
        events = [event for event in events if event.time <= session.time]
        mcap.trial(session.time)
    for event in events:
        if isinstance(event, TrialStarted):
            mcap.trial(event.time)
    if isinstance(message, Sample) and len(message.wrench) == len(session.introspector.axes):
        mcap.wrench(session.time if message.time is None else message.time, message.wrench)
    for event in events:
        mcap.event(event)
    if any(isinstance(event, Belief | Word) for event in events):
        mcap.labels(session.time, session.introspector.labels[:, 0])


def _counts(numbers: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in numbers.items()) or "nothing"
