"""The ``rcbht`` command: finds the command in a table, parses its options, prints its result.

Exit status: 0 done; 1 the machine failed (disk full, output closed); 2 wrong input; 130 interrupted.
"""

from __future__ import annotations

import errno
import importlib
import inspect
import json
import os
import sys
from collections.abc import Sequence
from typing import Any

import rcbht_jax
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError

# Words of the command -> (module:class, one line for the overview). Modules are imported when called.
COMMANDS: dict[str, tuple[str, str]] = {
    "import hiro": ("rcbht_jax.cli.import_hiro:ImportHiro", "read the authors' trials into a store"),
    "bench": ("rcbht_jax.cli.bench:Bench", "measure the encoders on this machine"),
    "demo": ("sim_mjx.cli.demo:Demo", "the whole chain on simulated or recorded trials"),
    "encode": ("rcbht_jax.cli.encode:Encode", "label every recording of a store"),
    "calibrate": ("rcbht_jax.cli.calibrate:Calibrate", "find thresholds: by context, search or gradients"),
    "evaluate": ("rcbht_jax.cli.learning:Evaluate", "score the labels on a task, beside baselines"),
    "train": ("rcbht_jax.cli.learning:Train", "train a classifier and write it as a model file"),
    "classify": ("rcbht_jax.cli.classify:Classify", "ask a trained model about every sentence of a store"),
    "train-online": ("rcbht_jax.cli.train_online:TrainOnline", "train the beliefs of a stream"),
    "stream": ("rcbht_jax.cli.stream:Stream", "beliefs and events from a stream, as JSON lines"),
    "serve": ("rcbht_jax.cli.serve:Serve", "a live page of wrench, labels and beliefs"),
    "export-model": ("rcbht_jax.cli.export_model:ExportModel", "the chain of a model as StableHLO"),
    "simulate": ("sim_mjx.cli.simulate:Simulate", "simulate randomised trials into a store"),
    "fidelity": ("sim_mjx.cli.fidelity:Fidelity", "hold the simulation against solver, engines and recordings"),
    "fidelity fit": ("sim_mjx.cli.fidelity_fit:FidelityFit", "fit physical parameters to a recorded session"),
    "view": ("sim_mjx.cli.view:View", "look at a trial: viewer, pictures or film"),
    "export": ("rcbht_jax.cli.export:Export", "a store as Parquet, LeRobot, MCAP or CSV"),
    "report": ("rcbht_jax.cli.report:Report", "one HTML page: results, trials, words and beliefs"),
    "info": ("rcbht_jax.cli.info:Info", "summarise and check a store"),
    "plot trial": ("rcbht_jax.cli.plot:PlotTrial", "draw one trial with its labels"),
    "plot beliefs": ("rcbht_jax.cli.plot:PlotBeliefs", "draw what a stream believed about one trial"),
    "plot map": ("rcbht_jax.cli.plot:PlotMap", "draw the label map of a store"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the words after ``rcbht``; default ``sys.argv[1:]``.

    Returns:
        the exit status.
    """
    try:
        return _dispatch(list(sys.argv[1:] if argv is None else argv))
    except InputError as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt:
        return _fail("Interrupted; nothing half-written was kept.", 130)
    except BrokenPipeError:
        # Whoever read our output has gone: nothing to say, but the exit must not fail while flushing.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.errno == errno.ENOSPC:
            return _fail("The disk is full; nothing half-written was kept. Free some space and try again.", 1)
        return _fail(f"{error.filename or 'A file'} cannot be used: {error.strerror or error}.", 2)


def _dispatch(words: list[str]) -> int:
    if words in ([], ["-h"], ["--help"]):
        print(overview())
        return 0 if words else 2
    if words == ["--version"]:
        print(rcbht_jax.__version__)
        return 0
    for count in range(len(words), 0, -1):
        name = " ".join(words[:count])
        if name in COMMANDS:
            return _run(name, words[count:])
    nested = [name for name in COMMANDS if name.startswith(f"{words[0]} ")]
    if nested and words[1:] in ([], ["-h"], ["--help"]):
        print(overview(nested))
        return 0 if words[1:] else 2
    raise InputError(f"rcbht has no command {' '.join(words[:2])!r}; it has: {', '.join(COMMANDS)}.")


def overview(names: Sequence[str] = tuple(COMMANDS)) -> str:
    """The list of commands, without importing any of them."""
    width = max(len(name) for name in names)
    lines = [f"  {name:{width}}  {COMMANDS[name][1]}" for name in names]
    usage = "usage: rcbht COMMAND [options]; every command has --help, and --json for a machine-readable result"
    return "\n".join([usage, "", *lines, "", "example: rcbht info hiro.zarr"])


def _run(name: str, words: list[str]) -> int:
    """Parse the options of a command, run it and print what it found."""
    as_json = "--json" in words
    command = _parse(name, [word for word in words if word != "--json"])
    if command is None:
        return 0
    result = command.run()
    said = json.dumps(result, allow_nan=False) if as_json else command.text(result)
    if said:  # a command whose standard output is a stream of its own says nothing here
        print(said, flush=True)
    return 0


def _parse(name: str, words: list[str]) -> Command | None:
    """The command with its options filled in; None when only its help was asked for.

    Raises:
        InputError: the options are wrong.
    """
    module, _, kind = COMMANDS[name][0].partition(":")
    with needs_extra("all"):
        import tyro

        described: Any = getattr(importlib.import_module(module), kind)
    try:
        command: Command = tyro.cli(
            described,
            args=words,
            prog=f"rcbht {name}",
            description=f"{inspect.getdoc(described)}\n\n--json prints the result as JSON on stdout.",
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    except SystemExit as stop:
        if stop.code:
            raise InputError(f'The options are wrong; "rcbht {name} --help" lists them.') from None
        return None
    return command


def _fail(sentence: str, status: int) -> int:
    print(f"rcbht: {sentence}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
