"""The options that say where a stream comes from and how it is encoded."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
import tyro

from rcbht_jax._util.printable import plural, printable
from rcbht_jax._util.url_path import as_path, url_of
from rcbht_jax.cli import common
from rcbht_jax.cli.command import MadeBy, option, unset
from rcbht_jax.cli.monitor import MONITOR, FalseAlarms
from rcbht_jax.cli.readers import Reads, SnapSize, detector_of, readers_of
from rcbht_jax.cli.rules import RuleCommand, checked_tolerance
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.introspection.introspector import Introspector
    from rcbht_jax.introspection.model import IntrospectionModel
    from rcbht_jax.introspection.session import Session
    from rcbht_jax.introspection.together import Together
    from rcbht_jax.introspection.words import WordIntrospector
    from rcbht_jax.io.messages import LineReader, Message

    AnyIntrospector = Introspector | WordIntrospector | Together
    Messages = Iterator[Message]

SEGMENTER = MadeBy('"rcbht segment STORE.zarr --write-model {path}"')


@dataclass(frozen=True)
class Source(RuleCommand):
    """Options of the commands that read a stream."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="INPUT")]
    """Store, folder of one trial, ROS bag or MCAP file with wrenches; - = JSON lines on standard input."""
    model: Annotated[
        Path | None,
        unset("none: words only", aliases=["-m"], metavar="MODEL"),
        common.ONLINE_MODEL,
    ] = None
    """Model file of "rcbht train-online"."""
    trial: Annotated[tuple[str, ...], option("Trials of a store; default all, one after the other.", "")] = ()
    arm: Annotated[str, unset("that of the model, monitor or segmenter, else the last by name, as the right one")] = ""
    """Arm whose wrench to use, if the store has several."""
    starts: common.Starts = "harmonised"
    topic: Annotated[str, unset()] = ""
    """Topic of a bag, if several have wrenches."""
    axes: Annotated[
        tuple[str, ...],
        option(
            "Names of the axes, if no model is given. The last force or moment in a name, such as fx, force_x, mx or "
            "torque_x, decides which it is; without one, names that begin with M or T are moments. Default: Fx Fy Fz "
            "Mx My Mz if there are six.",
            "",
        ),
    ] = ()
    sampling_rate: Annotated[float | None, unset()] = None
    """Samples per second of the encoder, if no model is given; default that of the recording or its time stamps."""
    lead: Annotated[
        float,
        option(
            "Seconds at the beginning of a stream (not of a store) from which --robot auto finds the thresholds "
            "and --rule fit the tolerances."
        ),
    ] = 10.0
    rate: common.BeliefRate = None
    certainty: float = 0.70
    """Probability above which a belief counts as certain, from 0.55 to less than 1."""
    speed: Annotated[
        float | None,
        option(
            'Playback speed: 1 = real time, 0 = as fast as possible. Default 0, or 1 for a recording in "rcbht '
            'serve"; lines on standard input are read as they arrive.',
            "",
        ),
    ] = None
    snap: SnapSize = ()
    monitor: Annotated[Path | None, unset(metavar="MONITOR"), MONITOR] = None
    """File of "rcbht monitor fit", for scores and alarms beside words and beliefs."""
    false_alarms: FalseAlarms = 0.05
    segmenter: Annotated[Path | None, unset(metavar="SEGMENTER"), SEGMENTER] = None
    """File of "rcbht segment --write-model", for a label of the newest sample."""
    max_gap: Annotated[float | None, unset()] = None
    """Longest gap, s, that is filled by interpolation; a longer one resets the encoder. Default 0.05, or 4 samples."""
    tare: Annotated[
        float,
        option(
            "Subtract the mean of this many seconds at the beginning of each trial; beliefs of these seconds come "
            'at their end. Give the value of --tare of "rcbht import" or "rcbht join" for the training trials.'
        ),
    ] = 0.0
    timeout: float = 1.0
    """Report a live source that is silent for this many seconds."""
    compile_cache: common.CompileCache = None

    FORMER: ClassVar[dict[str, str]] = {"--k": "--certainty", "--bridge": "--max-gap", "--silent": "--timeout"}
    SPEED: ClassVar[float] = 0.0  # of a recording, where none is chosen
    OWN_WORDS: ClassVar[bool] = False  # whether --rule is about words that are shown beside a model's beliefs

    def opened(self, words: bool = False, say: Callable[[str], None] = lambda _: None) -> tuple[Session, Messages]:
        """A session, and the messages for it; without a model, the beginning of the stream has been read.

        Args:
            words: with a model, report words besides beliefs.
            say: called with what is being waited for.
        """
        from rcbht_jax._util import compile_cache
        from rcbht_jax.introspection.introspector import Introspector
        from rcbht_jax.introspection.model import load
        from rcbht_jax.introspection.session import Session, paced
        from rcbht_jax.introspection.together import Together

        self.check()
        model = None if self.model is None else load(self.model)
        readers, read = readers_of(self.segmenter, self.monitor, self.certainty, self.false_alarms)
        arms = [one.arm for one in (model, *read) if one is not None]
        live, messages = self.source == "-", self._messages(model, arms)
        compile_cache.use(self.compile_cache)
        if live:  # its beginning must not be read faster than it is played
            messages = paced(messages, self.pace)
        introspector: AnyIntrospector
        if model is None:
            introspector, messages = self._words(messages, say, read[-1] if read else None)
        else:
            detect = self.starts == "detected"
            beside = self._beside(model)
            introspector = Introspector(
                model, common.belief_rate(self.rate), self.certainty, detect=detect, words=words and not beside
            )
            if beside:
                learned = Reads(model.axes, model.units, 1 / model.encoder.dt)
                others, messages = self._words(messages, say, learned)
                introspector = Together(introspector, others)
        if snaps := detector_of(self.snap, 1 / introspector.config.dt):
            introspector = Together(introspector, readers=[snaps])
        if readers:
            introspector = Together(introspector, readers=readers)
        return Session(introspector, self.max_gap, self.tare), messages if live else paced(messages, self.pace)

    @property
    def pace(self) -> float:
        """Playback speed; a live source has its own, and would stay late for as long as it waited at the start."""
        if self.speed is not None:
            return self.speed
        return 0.0 if self.source == "-" else self.SPEED

    def waits(self) -> bool:
        """Whether the beginning of a live stream decides how it is encoded, so that :meth:`opened` waits for it."""
        from rcbht_jax.introspection.model import load

        return self.source == "-" and (self.model is None or self._beside(load(self.model)))

    def _beside(self, model: IntrospectionModel) -> bool:
        """Whether words are shown that the model does not read."""
        from rcbht_jax.encoding.rules import config_fields

        return self.OWN_WORDS and config_fields(model.encoder)["rule"] != self.rule

    def check(self) -> None:
        """Refuse options that contradict each other, or are out of range."""
        if not 0 <= self.pace < float("inf"):
            raise InputError(f"The playback speed is {self.pace}; expected zero or more.")
        if self.model is not None:
            own = ("robot", "thresholds", "window", "axes", "sampling_rate")
            words = () if self.OWN_WORDS else ("rule", "tolerance")
            why = "has no effect with --model, which has axes, window, rate, rule and thresholds; leave it out."
            self.refuse((*own, *words), why)
        checked_tolerance(self.rule, self.tolerance)
        if self.model is None and self.starts == "detected":
            raise InputError("Only a model detects sub-tasks; name one with --model, or leave out --starts detected.")
        if self.sampling_rate is not None:
            from rcbht_jax.io.importing.conform import checked_rate

            checked_rate(self.sampling_rate, "--sampling-rate")
        if not 0 <= self.lead <= 600:
            raise InputError(f"--lead is {self.lead}; expected 0 to 600 s.")
        self._check_used()
        if not 0.55 <= self.certainty < 1:
            raise InputError(f"--certainty is {self.certainty}; expected 0.55 to less than 1.")

    def _check_used(self) -> None:
        """Refuse options that would be ignored, for want of what they are about."""
        from rcbht_jax.io.messages import is_bag

        path, live = as_path(self.source), self.source == "-"
        store, known = _is_store(path), live or path.exists()  # a source that does not exist is refused as such
        bag = is_bag(path)
        recorded = store or not known or (path.is_dir() and not bag)
        needs = {
            "false_alarms": (self.monitor is not None, "--monitor"),
            "certainty": (self.model is not None or self.segmenter is not None, "--model or --segmenter"),
            "rate": (self.model is not None, "--model"),
            "trial": (store or not known, "a store"),
            "arm": (recorded, "a store or the folder of a trial"),
            "starts": (recorded or self.starts == "detected", "a store or the folder of a trial"),
            "lead": (not store, "lines, a bag or the folder of a trial"),
            "topic": (not known or bag, "a bag or MCAP file"),
            "timeout": (live or not known, "lines on standard input"),
        }
        for name, (used, what) in needs.items():
            if not used:
                self.refuse((name,), f"has no effect without {what}; leave it out.")

    def _words(
        self, messages: Messages, say: Callable[[str], None], reads: Reads | None = None
    ) -> tuple[WordIntrospector, Messages]:
        """What reports words of its own, with the thresholds of the options, and the messages for it.

        Args:
            messages: the stream.
            say: called with what is being waited for.
            reads: what the model or monitor reads beside which the words are shown; without, from the stream.
        """
        from rcbht_jax.calibration.rest import auto_thresholds
        from rcbht_jax.encoding.limit_files import taken_from_start
        from rcbht_jax.introspection.opening import read_opening
        from rcbht_jax.introspection.resampling import resampled
        from rcbht_jax.introspection.words import WordIntrospector
        from rcbht_jax.io.messages import is_bag
        from rcbht_jax.io.store import read_recordings
        from rcbht_jax.labels import UNITS

        path, known = as_path(self.source), self.sampling_rate or (reads and reads.rate)
        if _is_store(path):
            recordings = read_recordings(path)
            rate = known or 1 / recordings.dt
            recordings = resampled(recordings, rate)
            if self.axes:
                axes, units = self._signal(recordings.axes, recordings.units)
                recordings = replace(recordings, axes=axes, units=units)
        else:
            robot = self.robot or ("hiro" if path.is_dir() and not is_bag(path) else "auto")
            taken = taken_from_start(self.rule, robot, self.thresholds, self.tolerance)
            if taken:
                say(f"taking the {' and '.join(taken)} from the first {self.lead:g} s")
            opening = read_opening(messages, self.lead if taken else 0.0, known)
            messages, rate = opening.messages, known or opening.rate()
            stated = ("",) * len(opening.axes) if self.source == "-" else UNITS
            recordings = opening.recordings(rate, *self._signal(opening.axes, stated, reads), self.max_gap)
        if _is_store(path):
            thresholds, _ = self.read_limits(recordings, path)
        elif "thresholds" in taken:
            thresholds = auto_thresholds(recordings, self.window, self.rule)
        else:
            thresholds, _ = replace(self, robot=robot).read_limits(recordings, path)
        config = self.config(1 / rate)
        limits = self.limits(config, thresholds, recordings)
        return WordIntrospector(config, limits, recordings.axes, recordings.units), messages

    def _signal(
        self, axes: tuple[str, ...], stated: tuple[str, ...], reads: Reads | None = None
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names and units of a stream's axes. Lines have neither: they are what a reader or the thresholds are for.

        Args:
            axes: their names where nobody names them.
            stated: their units, as of a wrench in a bag or a folder, in N and Nm; "" = not stated.
            reads: what is read beside the words, which may name a wrench otherwise.
        """
        from rcbht_jax._util.signals import distinct
        from rcbht_jax.encoding.thresholds import units_in
        from rcbht_jax.labels import UNIT_OF

        known, named = {} if self.thresholds is None else units_in(self.thresholds), self.axes or axes
        units = UNIT_OF | {axis: unit for axis, unit in known.items() if unit}
        if len(named) != len(axes):
            raise InputError(f"--axes names {plural(len(named), 'axis', 'axes')}; the stream has {len(axes)}.")
        its = reads is not None and not self.axes and len(reads.axes) == len(axes)
        if reads and its and not (any(stated) and set(reads.axes) == set(axes)):
            named = reads.axes
            units = UNIT_OF | dict(zip(reads.axes, reads.units, strict=False))  # old monitors have none
        elif known and not self.axes and not set(axes) <= set(known):
            if len(known) != len(axes):
                count = plural(len(axes), "axis", "axes")
                raise InputError(
                    f"{self.thresholds} has thresholds for {', '.join(known)}, and the stream has {count}; name "
                    f"{'it' if len(axes) == 1 else 'them'} with --axes."
                )
            named = tuple(known)
        return distinct(named), tuple(unit or units.get(axis, "") for unit, axis in zip(stated, named, strict=True))

    def _messages(self, model: IntrospectionModel | None, arms: list[str]) -> Messages:
        from rcbht_jax._util.arms import common_arm, rows_of_arm
        from rcbht_jax.io.hiro.trial import ARMS
        from rcbht_jax.io.importing.find import kind_of
        from rcbht_jax.io.messages import is_bag, read_live
        from rcbht_jax.io.playback import play, read_folder
        from rcbht_jax.io.store import read_recordings

        if self.source == "-":
            return read_live(_standard_input(), self.timeout)
        path = as_path(self.source)
        starts = "none" if self.starts == "detected" else self.starts
        learnt = model.subtasks if model else ""
        if model is not None and not _is_store(path):  # of ROS, or of a trial in HIRO's layout
            model.check_wrench(str(path))
        if is_bag(path):
            from rcbht_jax.io.rosbags import read_bag  # of the extra stream, which stores and lines do not need

            return read_bag(path, self.topic)
        if _is_store(path):
            recordings = read_recordings(path)
            if model is not None:
                model.check_axes(recordings.axes, recordings.units, str(path))
            arm = self.arm or common_arm(recordings.arm.tolist(), arms)
            remarks = rows_of_arm(recordings.arm, arm)[1]
            played = np.isin(recordings.trial, self.trial) if self.trial else np.full(len(recordings), True)
            if len(np.unique(recordings.arm[played])) > 1:
                print(*map(printable, remarks), sep="\n", file=sys.stderr, flush=True)
            return play(recordings, self.trial, arm, starts, str(path), learnt)
        if path.is_dir():
            return read_folder(path, self.arm or common_arm(ARMS, arms), starts, learnt)
        if path.is_file():
            kind = kind_of(path.name) or "csv"
            lines = f' Lines of wrenches can also be piped: "- < {path}".' if kind == "jsonl" else ""
            raise InputError(
                f"{path} is not a store, trial, bag or MCAP file; import it first, "
                f"for example: rcbht import {kind} {path} {path.stem}.zarr.{lines}"
            )
        raise InputError(f"{path} is not a store, trial, bag or MCAP file; for JSON lines on standard input, write -.")


def _standard_input() -> LineReader:
    """Standard input through a buffer of its own: Python closes that of ``sys.stdin`` at exit, while it is read."""
    if sys.stdin is None:
        raise InputError("Standard input is closed; - reads JSON lines from it.")
    try:
        return os.fdopen(os.dup(sys.stdin.fileno()), "rb")
    except (AttributeError, io.UnsupportedOperation):  # it was replaced by an object without a file
        return sys.stdin.buffer


def _is_store(path: Path) -> bool:
    return url_of(path) is not None or (path / "zarr.json").is_file()
