"""Start workers in other processes: of this machine, as Ray tasks, or as an array of Slurm jobs.

A worker is ``rcbht simulate STORE ... --worker``, however it is started: claims in the work folder, which all workers
must see under the same name, decide which shard it takes. The functions here only pass on these arguments.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.printable import last_line
from rcbht_jax.errors import InputError

_LOOK = 0.2  # s between two checks of the workers
_GRACE = 20.0  # s for workers to give back their claims
DEVICES = "CUDA_VISIBLE_DEVICES"
# XLA's allocator keeps 8 bytes of the host's memory for each 256 that it takes of a GPU's: 2 GB for 64. (CUDA's own
# allocator keeps none, but what another thread frees on the stream breaks the graphs that Warp captures there.)
AS_NEEDED = ("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
# Asked of another process: this one must not take the devices' memory away from its workers.
_COUNT = "import jax; print(len([d for d in jax.local_devices() if d.platform == 'gpu']))"


def visible_devices() -> list[str]:
    """The value of ``CUDA_VISIBLE_DEVICES`` that selects each GPU that this process may use; empty = none.

    Raises:
        InputError: JAX does not start.
    """
    env = {**os.environ, AS_NEEDED[0]: AS_NEEDED[1]}
    done = subprocess.run([sys.executable, "-c", _COUNT], env=env, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise InputError(f"The devices of this machine cannot be counted: {reason}")
    count = int(done.stdout)
    named = [name.strip() for name in os.environ.get(DEVICES, "").split(",") if name.strip()]
    return (named or [str(number) for number in range(count)])[:count]


def local(
    words: Sequence[str],
    environments: Sequence[Mapping[str, str]],
    look: Callable[[], None],
    notice: Callable[[str], None],
) -> None:
    """Run a worker in a process of its own for each environment, until all have ended.

    Args:
        words: of the worker, after ``rcbht``.
        environments: variables of each in addition to those of this process.
        look: called several times a second while workers run.
        notice: called with a sentence on each worker that ended before its work was done.
    """
    with ExitStack() as files:
        reports = [files.enter_context(tempfile.TemporaryFile()) for _ in environments]
        workers = [
            _started(words, file, env={**os.environ, **env}) for env, file in zip(environments, reports, strict=True)
        ]
        try:
            while any(worker.poll() is None for worker in workers):
                time.sleep(_LOOK)
                look()
        except BaseException:
            _stop(workers)
            raise
        for number, (worker, file) in enumerate(zip(workers, reports, strict=True)):
            if worker.returncode != 0:
                notice(f"Worker {number + 1} of {len(workers)} ended early: {_ending(worker.returncode, file)}")


def run_worker(words: Sequence[str], folder: str) -> str:
    """Run one worker in a process of its own that starts in a folder; called by the tasks of a cluster.

    Returns:
        why it ended before its work was done; "" = it did not.
    """
    with tempfile.TemporaryFile() as report:
        worker = _started(words, report, cwd=folder)
        try:
            worker.wait()
        except BaseException:
            _stop([worker])
            raise
        return "" if worker.returncode == 0 else _ending(worker.returncode, report)


def ray(
    words: Sequence[str], count: int | None, gpus: bool, look: Callable[[], None], notice: Callable[[str], None]
) -> None:
    """Run workers as tasks of a Ray cluster: that of ``RAY_ADDRESS``, a running one, or a new one on this machine.

    Args:
        words: of the worker, after ``rcbht``.
        count: workers; None = one for each GPU, or for each node where none is needed.
        gpus: whether a worker needs a GPU of its own, which Ray then chooses.
        look: called several times a second while workers run.
        notice: called with a sentence on each worker that ended before its work was done.

    Raises:
        InputError: Ray is not installed, cannot be reached, or has no GPU.
    """
    with needs_extra("ray"):
        import ray as cluster

    ours = not cluster.is_initialized()
    try:
        if ours:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # of JAX, of forks that become Ray's processes at once
                cluster.init(log_to_driver=False)
        nodes = [node for node in cluster.nodes() if node["Alive"]]
        present = int(cluster.cluster_resources().get("GPU", 0)) if gpus else len(nodes)
        if not present:
            raise InputError("The Ray cluster has no GPU; start one on a machine that has, or use --engine native.")
        task = cluster.remote(run_worker).options(
            num_cpus=1, num_gpus=int(gpus), max_retries=0, scheduling_strategy="SPREAD"
        )
        waiting = [task.remote(list(words), os.getcwd()) for _ in range(count or present)]
        while waiting:
            ended, waiting = cluster.wait(waiting, timeout=_LOOK)
            look()
            for one in ended:
                _report_ending(partial(cluster.get, one), notice)
    except (ConnectionError, cluster.exceptions.RayError) as error:
        raise InputError(
            f"Ray failed: {_first_line(error)} What was simulated is kept; run the same command again."
        ) from error
    finally:
        if ours:
            cluster.shutdown()


def check_slurm(gpus: bool, options: Mapping[str, Any]) -> None:
    """Refuse options of Slurm jobs before anything is begun; errors as of :func:`slurm`."""
    with tempfile.TemporaryDirectory() as folder:  # the executor makes one
        _executor(Path(folder), gpus, options)


def _executor(folder: Path, gpus: bool, options: Mapping[str, Any]) -> Any:
    with needs_extra("slurm"):
        import submitit

    executor = submitit.AutoExecutor(folder=folder)
    try:
        executor.update_parameters(
            **({"timeout_min": 24 * 60} | ({"gpus_per_node": 1} if gpus else {}) | dict(options))
        )
    except (AssertionError, NameError, TypeError, ValueError) as error:
        raise InputError(f"The options of the Slurm jobs are wrong (--launch-options): {_first_line(error)}") from error
    return executor


def slurm(
    words: Sequence[str],
    count: int,
    gpus: bool,
    options: Mapping[str, Any],
    folder: Path,
    look: Callable[[], None],
    notice: Callable[[str], None],
) -> None:
    """Run workers as an array of Slurm jobs, or as processes of this machine where there is no Slurm.

    Args:
        words: of the worker, after ``rcbht``.
        count: workers, one a job of the array.
        gpus: whether a worker needs a GPU of its own.
        options: of the jobs, as submitit names them: timeout_min, slurm_partition and so on.
        folder: for the jobs' logs, shared by all nodes; deleted if all went well, or if no job began.
        look: called several times a second while workers run.
        notice: called with a sentence on where the jobs run, and on each that ended before its work was done.

    Raises:
        InputError: submitit is not installed, an option is not one of its, or Slurm takes no job.
    """
    earlier = folder.exists()  # with logs of jobs that failed
    executor = _executor(folder, gpus, options)
    if executor.cluster != "slurm":
        notice("There is no Slurm here; the jobs run on this machine.")
    try:
        jobs = executor.map_array(run_worker, [list(words)] * count, [os.getcwd()] * count)
    except Exception as error:  # whatever submitit makes of what Slurm says
        if not earlier:
            shutil.rmtree(folder, ignore_errors=True)
        raise InputError(f"Slurm takes no jobs: {_first_line(error)}") from error
    try:
        while not all(job.done() for job in jobs):
            time.sleep(_LOOK)
            look()
    except BaseException:
        for job in jobs:
            job.cancel()
        raise
    well = [_report_ending(job.result, notice) for job in jobs]
    if all(well):
        shutil.rmtree(folder, ignore_errors=True)


def _report_ending(result: Callable[[], str], notice: Callable[[str], None]) -> bool:
    """Report why a worker ended early, if it did; a cluster may have killed it. True = it did not."""
    try:
        reason = result()
    except Exception as error:  # whatever a cluster does with a task that is gone
        reason = _first_line(error)
    if reason:
        notice(f"A worker ended early: {reason}")
    return not reason


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0].rstrip(".") + "."


def _command(words: Sequence[str]) -> list[str]:
    return [sys.executable, "-m", "rcbht_jax", *words]


def _started(words: Sequence[str], report: Any, **where: Any) -> subprocess.Popen[bytes]:
    nothing = subprocess.DEVNULL
    return subprocess.Popen(_command(words), stdin=nothing, stdout=nothing, stderr=report, **where)


def _ending(status: int, report: Any) -> str:
    """Why a worker ended: its last line of output, or the signal that ended it."""
    if status < 0:
        return f"it was ended by {signal.Signals(-status).name}."
    return last_line(report).removeprefix("rcbht: ") or f"exit status {status}."


def _stop(workers: Sequence[subprocess.Popen[bytes]]) -> None:
    """End workers as Ctrl-C does, so that they give back their claims; those that do not are killed."""
    for worker in workers:
        if worker.poll() is None:
            worker.send_signal(signal.SIGINT)
    end = time.monotonic() + _GRACE
    for worker in workers:
        try:
            worker.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            worker.kill()
            worker.wait()
