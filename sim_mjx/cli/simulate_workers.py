"""What ``rcbht simulate`` does besides simulating: start other workers, be one, show the progress of a job."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcbht_jax._util.devices import checked, wanted
from rcbht_jax._util.optional import require
from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from sim_mjx.cli.simulate import Simulate
    from sim_mjx.synthesis.pipeline import Helpers
    from sim_mjx.synthesis.plan import SynthesisConfig
    from sim_mjx.synthesis.workers import SynthesisProgress

MOST = 4096  # workers of one job
CORES = 4  # of a process with the native engine, whose threads share one interpreter
FEWEST = 256  # trials that are worth the start of a process
# Options that decide who works, not on what, and those that workers must not have.
_NOT_OF_THE_JOB = ("out", "overwrite", "processes", "devices", "launch", "launch_options", "worker", "status")


def words_of(command: Simulate) -> list[str]:
    """The arguments of ``rcbht`` that make a worker of the same job; paths are absolute, so that any folder will do."""
    words = ["simulate", str(command.out.absolute()), "--worker"]
    for field in fields(command):
        value = getattr(command, field.name)
        if field.name not in _NOT_OF_THE_JOB and value != field.default:
            text = value.absolute() if isinstance(value, Path) else value
            words += [f"--{field.name.replace('_', '-')}", str(text)]
    return words


def helpers(command: Simulate, notice: Callable[[str], None]) -> Helpers | None:
    """The function that starts the workers that the options ask for; None = this process simulates alone.

    Raises:
        InputError: impossible numbers of workers or devices, options that exclude each other or are none of Slurm's,
            or a package that is missing.
    """
    from sim_mjx.synthesis import launch

    count, gpus, words = command.processes, command.engine != "native", words_of(command)
    if count is not None and not 1 <= count <= MOST:
        raise InputError(f"--processes is {count}; expected 1 to {MOST}.")
    if command.devices is not None and (count is not None or command.launch):
        raise InputError("--devices starts a process for each GPU of this machine; leave --processes and --launch out.")
    options = _options(command.launch_options)
    if options and command.launch != "slurm":
        raise InputError("--launch-options belong to --launch slurm; add that, or leave them out.")
    if command.launch == "ray":
        require("ray", "ray")
        return lambda look: launch.ray(words, count, gpus, look, notice)
    if command.launch == "slurm":
        launch.check_slurm(gpus, options)
        logs = command.out.absolute().with_name(f"{command.out.name}.jobs")
        return lambda look: launch.slurm(words, count or 1, gpus, options, logs, look, notice)
    if command.devices is not None:
        checked(command.devices)
    if command.devices is not None and gpus:
        environments = _environments(command.devices)
    else:
        environments = [{}] * (count or (1 if gpus else default_processes(command.trials, command.shard)))
    if len(environments) < 2:
        return None
    if gpus and command.lanes is None:  # the first worker must not take all trials
        words += ["--lanes", str(-(-command.trials // len(environments) // command.shard) * command.shard)]
    return lambda look: launch.local(words, environments, look, notice)


def default_processes(trials: int, shard: int) -> int:
    """Processes of this machine that share trials of the native engine: one for four cores, each with enough to do.

    >>> default_processes(1, 256)
    1
    """
    return max(1, min((os.cpu_count() or 1) // CORES, trials // max(shard, FEWEST)))


def _options(words: tuple[str, ...]) -> dict[str, Any]:
    """KEY=VALUE as a dictionary; decimal numbers as such."""
    pairs = [word.partition("=") for word in words]
    wrong = next((word for word, (name, equals, _) in zip(words, pairs, strict=True) if not (name and equals)), None)
    if wrong is not None:
        raise InputError(f"--launch-options has {wrong!r}; expected KEY=VALUE, for example timeout_min=60.")
    return {name: _number(value) for name, _, value in pairs}


def _number(value: str) -> int | float | str:
    """A decimal number as such; other words, such as "nan" or "1e3", may be names."""
    if value.isdecimal():
        return int(value)
    return float(value) if value.replace(".", "", 1).isdecimal() else value


def _environments(devices: str) -> list[dict[str, str]]:
    """For each GPU to use the variables of its worker."""
    from sim_mjx.synthesis import launch

    present = launch.visible_devices()
    return [{launch.DEVICES: name} for name in present[: wanted(devices, len(present))]]


def be_worker(
    command: Simulate,
    job: SynthesisConfig,
    progress: Callable[[SynthesisProgress], None],
    notice: Callable[[str], None],
) -> dict[str, Any]:
    """Be one worker of the job."""
    from sim_mjx.synthesis.pipeline import work_on

    others = (command.processes, command.devices, command.launch)
    if any(value is not None for value in others) or command.launch_options or command.overwrite:
        raise InputError("--worker is one process of a job; leave --processes, --devices, --launch, --overwrite out.")
    simulated, complete = work_on(command.out, job, progress=progress, notice=notice, lanes=command.lanes)
    return {"store": str(command.out), "simulated": simulated, "complete": complete}


def worker_text(result: dict[str, Any]) -> str:
    """The result of :func:`be_worker` for people."""
    rest = "the store is complete" if result["complete"] else "another process completes it"
    return f"{plural(result['simulated'], 'trial')} of {result['store']} simulated here; {rest}"


def status(target: Path) -> dict[str, Any]:
    """The progress of a job, as JSON values."""
    from sim_mjx.synthesis.status import status_of

    return {"store": str(target), **asdict(status_of(target))}


def status_text(result: dict[str, Any]) -> str:
    """The result of :func:`status` for people."""
    if result["complete"]:
        return f"{result['store']} is complete: {plural(result['trials'], 'trial')}"
    share = 100 * result["done"] / result["trials"]
    lines = [
        f"{result['store']}: {result['done']} of {plural(result['trials'], 'trial')} ({share:.0f} %), "
        f"{result['shards_done']} of {plural(result['shards'], 'shard')}"
    ]
    if result["per_minute"] is not None:
        left = (result["trials"] - result["done"]) / result["per_minute"]
        lines.append(f"{result['per_minute']:.0f} trials/min, {left:.1f} min left at this rate")
    lines.append(f"workers: {len(result['workers']) or 'none; the same command without --status goes on'}")
    for one in result["workers"]:
        what = "completes the store, or begins" if one["shard"] is None else f"shard {one['shard']}"
        host = f"{one['host']} process {one['pid']}" if one["pid"] else "not known yet"
        lines.append(f"  {host}: {what}, last seen {one['seconds']:.0f} s ago")
    for one in result["failures"]:
        then = "left out" if one["left_out"] else "is tried again"
        lines.append(f"shard {one['shard']} failed {one['failed']} of {one['tries']} times and {then}: {one['reason']}")
    if result["killed"]:
        lines.append(f"shards whose worker died, to be taken over: {', '.join(map(str, result['killed']))}")
    return "\n".join(lines)
