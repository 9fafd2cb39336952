"""What the commands of ``rcbht`` share: the base class, the types of common options, the progress bar.

A command is a frozen dataclass derived from :class:`Command`; its fields are the options, its docstring is the help
text and holds an example. Its module imports nothing heavy: ``run`` and ``text`` import what they need, so that help
and shell completion are quick. A table of commands (see :mod:`rcbht_jax.cli.commands`) names it.
"""

from __future__ import annotations

import itertools
import os
import sys
import typing
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import tyro

from rcbht_jax._util.atomic import is_stream
from rcbht_jax._util.printable import reasons_of
from rcbht_jax._util.url_path import as_path, url_of
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
    from rcbht_jax.types import Recordings


OUTPUTS = ("out", "mcap", "plot", "checkpoint", "write_map", "write_model")  # options that name what is written


class MadeBy(NamedTuple):
    """Mark of an option that names an existing file or folder: the command that makes it, for {path}."""

    command: str


class Folder(NamedTuple):
    """Mark of an output that is a folder."""

    grows: bool = False  # results are added to what is there, and the folders above it are made


def option(text: str, default: str | None = None, **more: Any) -> Any:
    """An option's help, where a docstring of one line is too short, and what stands for its default value there."""
    return tyro.conf.arg(help=text, **more) if default is None else unset(default, help=text, **more)


def unset(default: str = "", **more: Any) -> Any:
    """What stands for the default value of an option that has none, in the help that its field's docstring gives."""
    return tyro.conf.arg(help_behavior_hint=default and f"(default: {default})", **more)


# Options that several commands have; one without a text is described by the docstring of its field.
STORE = MadeBy('"rcbht simulate {path}", or from files of yours with "rcbht import auto FOLDER {path}"')
ONLINE_MODEL = MadeBy('"rcbht train-online STORE.zarr -o {path}"')
Store = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STORE.zarr"), STORE]
Stores = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    option("Stores to read, two or more.", "", metavar="STORE.zarr STORE.zarr"),
    STORE,
]
LabelledStore = Annotated[
    Path,
    tyro.conf.Positional,
    option('Store with label tracks, made by "rcbht encode".', metavar="STORE.zarr"),
    STORE,
]
OutStore = Annotated[Path, tyro.conf.Positional, option("Store to create.", metavar="STORE.zarr"), Folder()]
Trial = Annotated[str, tyro.conf.Positional, option("Name of the trial.", metavar="TRIAL")]
Tracks = Annotated[str, option("Label tracks to use, if the store has several.", "")]
Sources = Annotated[tuple[str, ...], option("Data sets to use.", "all")]
SourcePrefix = Annotated[str, option("Data set, or the start of its name, if several have a trial of this name.", "")]
Sessions = Annotated[tuple[str, ...], option("Recording sessions to use, for example A B.", "all")]
Outcomes = Annotated[
    tuple[str, ...], option("Outcomes to use.", "for a track, successes if there are any; for a column, all")
]
Arm = Annotated[str, option("Arm whose wrench to use, if the store has several.", "the last by name, as the right one")]
RobotName = Literal["auto", "hiro", "baxter", "pa10"]  # whose preset gives thresholds
ONLY_TRACK = "the only track of the store, else states; the outcome if there is nothing else"
Task = Annotated[str, option("Track of annotations, or column, whose classes to distinguish.", ONLY_TRACK)]
Boundaries = Annotated[
    str,
    option(
        "Variant of the track, for example of states: merged = states-merged; recorded = states itself, which is also "
        "used if there is no states-harmonised."
    ),
]
NewWindow = Annotated[
    int | None, option("Encode now with this many samples per linear fit.", "use the stored labels", metavar="INT")
]
Model = Annotated[Path, option('Model file of "rcbht train-online".', aliases=["-m"], metavar="MODEL"), ONLINE_MODEL]
OnlineModel = Annotated[
    Path | None,
    option('Model file of "rcbht train-online".', "none: words only", aliases=["-m"], metavar="MODEL"),
    ONLINE_MODEL,
]
OutModel = Annotated[Path, option("Model file to write: arrays and JSON, no code.", aliases=["-o"], metavar="MODEL")]
OutFigure = Annotated[
    Path,
    option("Figure to write: .png, .svg or .pdf; an existing one is replaced.", aliases=["-o"], metavar="OUT.png"),
]
CompileCache = Annotated[
    Path | None, option("Folder for compiled programs, which shortens the next start.", "user's cache", metavar="DIR")
]
Starts = Annotated[
    str,
    option(
        "Track of annotations whose intervals begin the sub-tasks of a recorded trial; recorded = that of the model's "
        "task, or the first track, harmonised = its corrected variant if there is one, none = no sub-tasks, detected = "
        "found by the model (train-online --detect)."
    ),
]
OneArm = Annotated[str | None, option("Arm to show, if the trial has both.", "", metavar="STR")]
BeliefRate = Annotated[float | None, option("Beliefs per second; 0 = one per window.", "about 10")]
WordRule = Annotated[
    Literal["paper", "fit"],
    option("Rule of the words: paper; or fit, where a word is a run of windows that one straight line explains."),
]
_TOLERANCE = (
    "Largest root-mean-square difference of line and signal that --rule fit allows: one number in the unit of the "
    "axes, or one for each axis."
)
_AUTO_TOLERANCE = "1.5 % of an axis's usual range, or more if its noise requires it"
Tolerance = Annotated[tuple[float, ...], option(_TOLERANCE, _AUTO_TOLERANCE)]
Weighing = Annotated[
    tuple[Literal["count", "time", "change"], ...],
    option(
        "Weights of labels in the families histogram and ngram: 1 each, their duration, or their change of value.",
        "time and count in histogram, count in ngram",
    ),
]
StreamFamily = Literal[  # of features that a stream can keep up to date
    "histogram", "ngram", "duration", "attributes", "offset", "course", "edges", "parts", "spread", "together", "order",
    "levels", "elapsed",
]  # fmt: skip
Flag = Annotated[bool, unset()]


@dataclass(frozen=True)
class Command(ABC):
    """Base of all commands: ``run`` computes, ``text`` words the result for people."""

    # Former spellings of options, still accepted: the words of one -> the words that replace them.
    FORMER: ClassVar[dict[str, str]] = {}
    LARGEST_SEED: ClassVar[int] = 2**32 - 1  # that NumPy and scikit-learn take
    RESUMES: ClassVar[bool] = False  # the same command goes on where an interrupted one ended

    @abstractmethod
    def run(self) -> dict[str, Any]:
        """Do the work and return the result as JSON values.

        Raises:
            InputError: the input is wrong; its text is shown and the exit status is 2.
        """

    @abstractmethod
    def text(self, result: dict[str, Any]) -> str:
        """The result of :meth:`run` as text for the terminal."""

    def exit_status(self, result: dict[str, Any]) -> int:
        """The exit status for the result of :meth:`run`; 0 unless the command is about what is wrong."""
        return 0

    def interrupted(self) -> str:
        """What an interruption leaves, as the end of a sentence."""
        kept = "what is finished is kept, and the same command resumes"
        return kept if self.RESUMES else "no incomplete file was left, and what a stream had recorded is kept"

    def check_inputs(self) -> None:
        """Refuse missing inputs, outputs that cannot be made or are an input, and wrong seeds."""
        seed = vars(self).get("seed")
        if isinstance(seed, int) and not 0 <= seed <= self.LARGEST_SEED:
            raise InputError(f"--seed is {seed}; expected 0 to {self.LARGEST_SEED}.")
        paths = self._paths()
        for written, output in paths:
            for name, path in paths:
                if written in OUTPUTS and name != written and _harms(output, path):
                    raise InputError(f"{output} is to be written and is used as {name}; choose another name.")
        for name, hint in typing.get_type_hints(type(self), include_extras=True).items():
            value, marks = getattr(self, name), getattr(hint, "__metadata__", ())
            if name in OUTPUTS and isinstance(value, Path):
                check_place(value, next((mark for mark in marks if isinstance(mark, Folder)), None))
            for mark, path in itertools.product(marks, _each(value)):
                if isinstance(mark, MadeBy) and path is not None and not (path.exists() or url_of(path)):
                    raise InputError(f"{path} does not exist; make it with {mark.command.format(path=path)}.")

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Refuse options that would be ignored, if they are given: if they differ from their defaults."""
        for name in names:
            default = getattr(type(self), name)
            if getattr(self, name) != default:
                raise InputError(f"--{'no-' * (default is True)}{name.replace('_', '-')} {why}")

    def outputs(self) -> list[Path]:
        """The files and folders that this command writes."""
        return [path for name, path in self._paths() if name in OUTPUTS]

    def _paths(self) -> list[tuple[str, Path]]:
        """Options that name a file, the source of a stream among them; "-" is the file behind standard input."""
        paths = [(name, each) for name, value in vars(self).items() for each in _each(value) if isinstance(each, Path)]
        source = vars(self).get("source")
        if source and isinstance(source, str):
            paths.append(("source", as_path("/dev/stdin" if source == "-" else source)))
        return paths


def _each(value: Any) -> tuple[Any, ...]:
    """The values of an option that takes several, or the only one."""
    return value if isinstance(value, tuple) else (value,)


def _harms(output: Path, other: Path) -> bool:
    """Whether writing an output changes what is read, or another output: the same file, or a part of a data set."""
    try:
        if is_stream(other) or is_stream(output):
            return False
        if output.exists() and other.exists() and output.samefile(other):
            return True
        here, there = output.resolve(), other.resolve()
    except (OSError, ValueError, RuntimeError):  # no name of a file: opening it reports that
        return False
    return here == there or (_is_whole(there) and there in here.parents) or (_is_whole(here) and here in there.parents)


def check_place(path: Path, folder: Folder | None) -> None:
    """Refuse an output that cannot be made at its place, or that would be added to a store."""
    here = Path(os.path.realpath(path))  # behind a link the file that it points to
    grows = folder is not None and folder.grows
    store = next((place for place in (here, *here.parents)[not grows :] if (place / "zarr.json").is_file()), None)
    if store is not None and not url_of(path):
        raise InputError(f"{path} is in the store {store}, which holds nothing else; choose another folder.")
    if grows:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} is a file; expected a folder.")
    elif not (url_of(path) or is_stream(path) or here.parent.is_dir()):
        parent = here.parent if path.is_symlink() else path.parent
        raise InputError(f"{parent} is not a folder; create it first, or choose another.")
    elif folder is None and path.is_dir():
        raise InputError(f"{path} is a folder; choose a name for a file.")


def _is_whole(folder: Path) -> bool:
    """Whether a folder is one data set, whose files are not for others: a store, or a bag of ROS 2."""
    return (folder / "zarr.json").is_file() or (folder / "metadata.yaml").is_file()


@dataclass(frozen=True, kw_only=True)
class RuleCommand(Command):
    """Options of the commands that encode by either rule."""

    window: Annotated[int, option("Samples per linear fit.")] = 5
    robot: Annotated[
        RobotName | None,
        option(
            "Robot whose preset gives the gradient thresholds; auto = from rest and contacts in what is encoded.",
            "hiro for recordings of HIRO and simulated ones, else auto",
        ),
    ] = None
    thresholds: Annotated[
        Path | None,
        option(
            'File of "rcbht calibrate" to use instead of the preset: gradient thresholds and, if it was made for '
            "--rule fit, tolerances.",
            "",
            metavar="FILE.json",
        ),
        MadeBy('"rcbht calibrate STORE.zarr -o {path}"'),
    ] = None
    rule: WordRule = "paper"
    tolerance: Annotated[tuple[float, ...], option(_TOLERANCE, f"those of --thresholds; else {_AUTO_TOLERANCE}")] = ()

    def check_inputs(self) -> None:
        """Refuse two choices of thresholds as well."""
        super().check_inputs()
        if self.robot is not None and self.thresholds is not None:
            raise InputError("--robot and --thresholds both choose thresholds; leave out one of them.")

    def read_limits(self, recordings: Recordings, store: Path, scale: float = 1.0) -> tuple[AnyLimits, dict[str, Any]]:
        """The limits of the file, of a robot's preset or of these recordings, and where they come from.

        Args:
            recordings, store: what is encoded, and where it is stored.
            scale: factor on all gradient limits.

        Returns:
            gradient thresholds, or FitLimits of a file for the fit rule.

        Raises:
            InputError: the file is missing or damaged, or has no limits for an axis, or for its unit.
        """
        from rcbht_jax.calibration.rest import auto_thresholds
        from rcbht_jax.encoding.rules import scaled
        from rcbht_jax.encoding.thresholds import preset

        if self.thresholds:
            thresholds, source = self.limits_in_file(self.thresholds, recordings, store)
        elif (robot := self.robot or _robot(recordings, store)) == "auto":
            thresholds, source = auto_thresholds(recordings, self.window, self.rule), {"method": "auto"}
        else:
            thresholds, source = preset(robot, recordings.axes, recordings.units), {"method": "preset", "robot": robot}
        return (thresholds, source) if scale == 1 else (scaled(thresholds, scale), {**source, "scale": scale})

    def limits_in_file(self, file: Path, recordings: Recordings, store: Path) -> tuple[AnyLimits, dict[str, Any]]:
        """Limits of a file of ``rcbht calibrate``; arguments and errors as of :meth:`read_limits`."""
        from rcbht_jax.encoding.limit_files import read_limits

        return read_limits(file, recordings.axes, recordings.units, self.rule)

    def config(self, dt: float) -> AnyConfig:
        """The configuration of the rule for samples ``dt`` seconds apart."""
        from rcbht_jax.encoding.rules import config_of

        return config_of(self.rule, self.window, dt)

    def limits(self, config: AnyConfig, thresholds: AnyLimits, training: Recordings) -> AnyLimits:
        """The thresholds and, by the fit rule, the tolerances: those of the option, or of these recordings."""
        from rcbht_jax.encoding.rules import limits_for

        tolerance = checked_tolerance(self.rule, self.tolerance, len(training.axes))
        return limits_for(config, thresholds, tolerance, training.wrench, training.length)


def checked_tolerance(rule: str, tolerance: tuple[float, ...], axes: int | None = None) -> tuple[float, ...] | None:
    """The option --tolerance as :func:`rcbht_jax.encoding.rules.limits_for` takes it; None = from recordings.

    Args:
        rule: of the words.
        tolerance: the option.
        axes: how many there are; None = not known yet.
    """
    if tolerance and rule != "fit":
        raise InputError("--tolerance is for --rule fit; add that, or leave it out.")
    if axes is not None and len(tolerance) not in (0, 1, axes):
        raise InputError(f"--tolerance has {len(tolerance)} numbers; expected one, or {axes}, one for each axis.")
    return tolerance or None


def _robot(recordings: Recordings, store: Path) -> str:
    """HIRO where the store is an import of its trials or a simulation of them; else its limits are unknown."""
    from rcbht_jax.io.joining import importer_of
    from rcbht_jax.io.store import read_attrs
    from rcbht_jax.labels import AXES

    return "hiro" if recordings.axes == AXES and importer_of(read_attrs(store)) == "hiro" else "auto"


def progress_bar(name: str, unit: str, total: int | None = None, **options: Any) -> Any:
    """A tqdm bar on standard error, off where that is not a terminal."""
    from tqdm import tqdm  # type: ignore[import-untyped]

    return tqdm(total=total, desc=name, unit=f" {unit}", file=sys.stderr, disable=None, **options)


def announce(step: int, steps: int, what: str) -> None:
    """Say on standard error which step of a long command begins."""
    print(f"[{step}/{steps}] {what}", file=sys.stderr, flush=True)


def belief_rate(chosen: float | None) -> float | Literal["auto"] | None:
    """The rate of beliefs as an introspector takes it: of an option that is 0 for every window, None for about 10."""
    return "auto" if chosen is None else chosen or None


def left_out(dropped: dict[str, int]) -> list[str]:
    """A line for each reason why trials or intervals were left out."""
    return [f"left out: {what}, {reason}" for what, reason in reasons_of(dropped)]
