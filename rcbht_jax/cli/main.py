"""The ``rcbht`` command: finds a command in the tables, parses its options, prints its result.

Exit status: 0 done; 1 the machine failed (disk full, output closed); 2 wrong input; 130 interrupted, 143 terminated.
"""

from __future__ import annotations

import _thread
import difflib
import importlib
import inspect
import io
import json
import logging
import os
import re
import shutil
import signal
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from functools import cache
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import rcbht_jax
from rcbht_jax._util.atomic import DISK_FULL, targets, without_draft
from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import printable
from rcbht_jax.cli import commands
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.cli.command import Command

GROUP = "rcbht.commands"  # entry points of other packages, each a table such as commands.COMMANDS
USAGE = "usage: rcbht COMMAND [options]; every command has --help, and --json for a machine-readable result"


LONGEST_ERROR = 2000  # letters of a sentence about what is wrong; the middle of a longer one is left out
AGAIN = 0.05  # s until a signal is sent again whose exception was lost: what loses one takes less


class Ended(KeyboardInterrupt):
    """SIGINT, SIGTERM or SIGHUP: each with a status of its own."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def endings() -> Iterator[None]:
    """Make SIGTERM and SIGHUP act as Ctrl-C, so that recordings are finished, unless another handler is set.

    Python discards what is raised in a destructor or in a callback of the garbage collector, of which JAX has one: a
    signal that came then is sent again. An error that escapes after a signal, as from the interrupted import of a C
    extension, does not change the exit status; the sentence of an InputError, as of a full disk, is added.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ctrl_c, other = signal.default_int_handler, signal.SIG_DFL
    defaults: dict[int, Any] = {signal.SIGINT: ctrl_c, signal.SIGTERM: other, signal.SIGHUP: other}
    ours = {number: default for number, default in defaults.items() if signal.getsignal(number) is default}
    came, lost, main_thread, report = list[int](), set[int](), threading.get_ident(), sys.unraisablehook

    def end(number: int, _: FrameType | None) -> None:
        lost.clear()  # a second exception would interrupt what the first one finishes
        came.append(number)
        raise Ended(number)

    def discarded(unraisable: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraisable.exc_value, Ended):
            report(unraisable)
            return
        lost.add(unraisable.exc_value.number)
        _thread.start_new_thread(again, (unraisable.exc_value.number,))  # a Timer takes locks, which may be held here

    def again(number: int) -> None:
        time.sleep(AGAIN)
        if number in lost:
            signal.pthread_kill(main_thread, number)  # wakes it, too

    for number in ours:
        signal.signal(number, end)
    sys.unraisablehook = discarded
    try:
        yield
    except Exception as error:
        if not came:
            raise
        ended = Ended(came[-1])
        if isinstance(error, InputError):
            ended.add_note(str(error).rstrip("."))
        raise ended from error
    finally:
        lost.clear()
        sys.unraisablehook = report
        for number, default in ours.items():
            signal.signal(number, default)


@cache
def all_commands() -> dict[str, tuple[str, str]]:
    """Words of every command -> (module:class, summary): this package's, then those of other packages."""
    from importlib.metadata import entry_points

    table = dict(commands.COMMANDS)
    for entry in sorted(entry_points(group=GROUP)):
        table = {**table, **entry.load(), **table}
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that the words after ``rcbht`` name, default ``sys.argv[1:]``; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):  # characters of names that the terminal does not know are spelled out
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # its remark that a home cannot be written to
    try:
        if not __debug__:
            raise InputError(
                "Python runs without assertions (-O), which the library of the stores needs; leave out -O."
            )
        with endings():
            return _dispatch(list(sys.argv[1:] if argv is None else argv))
    except InputError as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt as ending:
        status = 128 + (ending.number if isinstance(ending, Ended) else signal.SIGINT)
        return _fail("; ".join(["Interrupted", *getattr(ending, "__notes__", [])]) + ".", status)
    except BrokenPipeError:
        # The reader of our output has gone: the exit must not fail while flushing.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError as error:
        detail = f" ({str(error).splitlines()[0]})" if str(error) else ""
        return _fail(f"The memory does not suffice{detail}; use fewer or shorter recordings, or a larger machine.", 2)
    except UnicodeEncodeError as error:  # of a user's names or remarks that are written to a file
        return _fail(f"A text holds {error.object[error.start : error.end]!r}, which is not valid Unicode.", 2)
    except OSError as error:
        if error.errno in DISK_FULL:
            return _fail(
                "The disk is full, or a file reached the largest size that the system allows (ulimit -f). Free some "
                "space and try again; no file was replaced by an incomplete one, and the events of a stream end there.",
                1,
            )
        name = without_draft(str(error.filename or "A file"))
        return _fail(f"{name} cannot be used: {error.strerror or error}.", 2)


def _dispatch(words: list[str]) -> int:
    if words in ([], ["-h"], ["--help"]):
        print(overview())
        return 0 if words else 2
    if words == ["--version"]:
        print(rcbht_jax.__version__)
        return 0
    name = command_name(words)
    if name:
        return _run(name, words[name.count(" ") + 1 :])
    nested = [name for name in all_commands() if name.startswith(f"{words[0]} ")]
    if nested and words[1:] in ([], ["-h"], ["--help"]):
        print(overview(nested))
        return 0 if words[1:] else 2
    names = list(all_commands())
    typed = " ".join(words[:2])
    alike = words[0] if any(sign in typed for sign in "./") else typed  # the second word names a file
    close = [*_similar(alike, names), *(nested or _similar(words[0], names))]
    if len(words) > 1 and (auto := f"{words[0]} auto") in nested and os.path.exists(words[1]):
        close = [auto]  # no kind is named, but what to read
    raise InputError(f"rcbht has no command {typed!r}; {_suggestion(close, 'rcbht --help', 'the commands')}")


def command_name(words: Sequence[str]) -> str:
    """The command that the first words name, such as "plot map"; "" = none."""
    names = [" ".join(words[:count]) for count in range(len(words), 0, -1)]
    return next((name for name in names if name in all_commands()), "")


def overview(names: Sequence[str] = ()) -> str:
    """The list of commands, without importing any of them."""
    table = all_commands()
    names = names or list(table)
    width = max(len(name) for name in names)
    lines = [_wrapped(f"  {name:{width}}  {table[name][1]}", width + 4) for name in names]
    return "\n".join([_wrapped(USAGE), "", *lines, "", "example: rcbht info hiro.zarr"])


def command_class(name: str) -> type[Command]:
    """The class of a command, whose module is imported now."""
    module, _, attribute = all_commands()[name][0].partition(":")
    return getattr(importlib.import_module(module), attribute)


def _run(name: str, words: list[str]) -> int:
    """Parse the options of a command, run it and print its result."""
    as_json = "--json" in words
    command = parse(name, [word for word in words if word != "--json"])
    if command is None:
        return 0
    command.check_inputs()
    with needs_extra("all"), targets(command.outputs()):  # for what a module does not name itself
        try:
            result = command.run()
        except KeyboardInterrupt as ending:
            ending.add_note(command.interrupted())
            raise
    output = json.dumps(result, allow_nan=False) if as_json else command.text(result)
    if output:  # a command whose standard output is a stream of its own returns no text
        print(output if as_json else printable(output), flush=True)
    return command.exit_status(result)


def parse(name: str, words: list[str]) -> Command | None:
    """The command with its options filled in; None when only its help was asked for."""
    with needs_extra("all"):
        import tyro

        from rcbht_jax.cli.completion import COMMON, check_numbers, of_several_values, options_of
        from rcbht_jax.cli.constructors import RULES

        described: Any = command_class(name)
    words = _current_spelling(words, described.FORMER)
    known = [*options_of(described), *COMMON]
    several, given = of_several_values(described), set[str]()
    for word, following in zip(words, [*words[1:], "--"], strict=False):
        option, equals, _ = word.replace("_", "-").partition("=")
        if option in given and option in several:  # only the last would count
            raise InputError(f"{option} is given twice; write all its values after one {option}.")
        if option in several and not equals and re.match("--|-[a-z]$", following):  # it would count as left out
            raise InputError(f"{option} has no value; expected one or more.")
        given.add(option)
        if option.startswith("--") and option not in ("--", *known):
            close = _similar(option, known)
            raise InputError(
                f"rcbht {name} has no option {option}; {_suggestion(close, f'rcbht {name} --help', 'the options')}"
            )
    if {"-h", "--help"} & set(words):  # tyro would not wrap this
        about = [*inspect.cleandoc(described.__doc__).split("\n\n"), "--json prints the result as JSON on stdout."]
        print(*map(_wrapped, about), sep="\n\n", end="\n\n")
    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            command: Command = tyro.cli(
                described,
                args=words,
                prog=f"rcbht {name}",
                description="",
                config=(tyro.conf.FlagCreatePairsOff,),
                registry=RULES,
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        # only now: a word after numbers may be a positional one
        check_numbers(described, words, complaint.getvalue())
        print(complaint.getvalue(), end="", file=sys.stderr)
        below = [other.removeprefix(f"{name} ") for other in all_commands() if other.startswith(f"{name} ")]
        close = [f"{name} {word}" for word in _similar(words[0], below)] if words else []
        raise InputError(f"The options are wrong; {_suggestion(close, f'rcbht {name} --help', 'them')}") from None
    return command


def _wrapped(paragraph: str, indent: int = 0) -> str:
    """A paragraph of help for this terminal; an example stays on one line, to be copied."""
    width = 10_000 if paragraph.startswith("Example:") else shutil.get_terminal_size().columns
    return textwrap.fill(paragraph, width, subsequent_indent=" " * indent, break_on_hyphens=False)


def _current_spelling(words: list[str], former: dict[str, str]) -> list[str]:
    """The words with former spellings of options replaced by the present ones."""
    words = [part for word in words for part in (word.split("=", 1) if word.partition("=")[0] in former else [word])]
    for old, new in former.items():
        parts = old.split()
        for start in reversed(range(len(words) - len(parts) + 1)):
            if words[start : start + len(parts)] == parts:
                words = [*words[:start], *new.split(), *words[start + len(parts) :]]
    return words


def _similar(word: str, known: Sequence[str]) -> list[str]:
    return difflib.get_close_matches(word, known, n=3, cutoff=0.6)


def _suggestion(close: Sequence[str], command: str, what: str) -> str:
    if not close:
        return f'"{command}" lists {what}.'
    return f"did you mean {' or '.join(list(dict.fromkeys(close))[:3])}?"


def _fail(sentence: str, status: int) -> int:
    if len(sentence) > LONGEST_ERROR:  # it may quote values of a stranger's file
        sentence = f"{sentence[: LONGEST_ERROR // 2]} ... {sentence[-LONGEST_ERROR // 2 :]}"
    print(f"rcbht: {printable(sentence)}".replace("\n", "\\n"), file=sys.stderr)  # a name must not make lines
    return status


def _show(message: Warning | str, *_: object, **__: object) -> None:
    """A warning as a sentence, without the place in the code that gives it."""
    print(f"rcbht: {printable(str(message))}", file=sys.stderr)


def script() -> NoReturn:
    """Run one command and end the process with its status."""
    warnings.showwarning = _show
    warnings.filterwarnings("ignore", message="The codec `vlen-utf8`")  # zarr 3.1.0, of every store
    status = main()
    if status > 128:  # XLA's threads may be at what was interrupted, and crash when the interpreter ends beneath them
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    script()
