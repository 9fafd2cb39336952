"""What all commands of ``rcbht`` share: the base class, the words for options, the progress bar.

A command is a frozen dataclass derived from :class:`Command`; its fields are the options, its docstring is the help
text and holds an example. Its module imports nothing heavy: ``run`` and ``text`` import what they need, so that help
and shell completion are quick. A table of commands (see :mod:`rcbht_jax.cli.commands`) names it. Options that several
commands have are in :mod:`rcbht_jax.cli.common`, those of commands that encode in :mod:`rcbht_jax.cli.rules`.
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
from typing import Annotated, Any, ClassVar, NamedTuple

import tyro

from rcbht_jax._util.atomic import is_stream
from rcbht_jax._util.printable import reasons_of
from rcbht_jax._util.url_path import as_path, url_of
from rcbht_jax.errors import InputError

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


def progress_bar(name: str, unit: str, total: int | None = None, **options: Any) -> Any:
    """A tqdm bar on standard error, off where that is not a terminal."""
    from tqdm import tqdm  # type: ignore[import-untyped]

    return tqdm(total=total, desc=name, unit=f" {unit}", file=sys.stderr, disable=None, **options)


def announce(step: int, steps: int, what: str) -> None:
    """Say on standard error which step of a long command begins."""
    print(f"[{step}/{steps}] {what}", file=sys.stderr, flush=True)


def left_out(dropped: dict[str, int]) -> list[str]:
    """A line for each reason why trials or intervals were left out."""
    return [f"left out: {what}, {reason}" for what, reason in reasons_of(dropped)]
