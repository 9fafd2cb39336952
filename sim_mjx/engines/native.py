"""C MuJoCo, batched over threads: the reference for the other engines.

Each thread steps a fixed number of lanes. A lane takes the next trial as soon as it has ended one, so that no
thread waits for another and none for the longest trial of a batch; and every trial goes through the same compiled
control program, whatever the size of its batch, so that its bytes do not depend on the others. The threads of a
process take turns at about a millisecond of Python each control period, so that many cores need several processes.
"""

from __future__ import annotations

import copy
import os
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float64, Int
from mujoco import rollout as mj_rollout
from numpy.typing import NDArray

from rcbht_jax._util.compiling import compiler_options
from sim_mjx.assembly.parts import from_lips
from sim_mjx.assembly.rollout import Program, Rollouts, as_float32, single_trials
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines.common import SETTLING, collect, sane, select_lanes, unwarned

LANES = 64  # of a thread; a program for more lanes costs a trial less time, but more where trials are few
THREADS = 8  # of a process; more would wait for each other for longer than their physics takes
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS

# One control period: trials that were stepped, their states before (which begin with the trial's time), references
# in rad, and sensor readings.
Rows = Int[np.ndarray, " row"]
States = Float64[np.ndarray, "row state"]
Steps = Float64[np.ndarray, "row substep _"]
Watch = Callable[[Rows, States, Steps, Steps], None]


def simulate(
    scene: Scene,
    params: Any,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    watch: Watch | None = None,
) -> Rollouts:
    """Simulate a batch of trials until all have ended.

    Args:
        scene, params, progress: as of :func:`sim_mjx.engines.simulate`.
        threads: default one for each core, at most ``THREADS``.
        watch: called after the physics of each control period of a thread's trials; see ``Watch``. Calls do not
            overlap; up to ``LANES`` trials are all in one thread and in step.
    """
    timeout = np.asarray(scene.program.timeout(params))
    job = _Job(scene, params, deque(np.argsort(-timeout, kind="stable").tolist()), watch, progress)
    workers = min(threads or min(os.cpu_count() or 1, THREADS), -(-len(timeout) // LANES))
    with unwarned(), ThreadPoolExecutor(workers) as pool:
        try:
            done = [future.result() for future in [pool.submit(job.work) for _ in range(workers)]]
        except BaseException:
            job.stopped.set()  # or the pool would wait for all trials to end
            raise
    return _gathered([run for runs in done for run in runs], scene.program)


class _Run(NamedTuple):
    """One trial as it was logged, up to and including the period in which it had ended."""

    trial: int
    columns: list[NDArray[Any]]  # wrench, joints, phase, past [period, ...]


def _gathered(runs: list[_Run], program: Program) -> Rollouts:
    """Trials in their order, padded to the longest."""
    runs = sorted(runs, key=lambda run: run.trial)
    periods, whole = max(len(run.columns[0]) for run in runs), []
    for column, blank in enumerate((0, 0, program.ended, False)):
        own = [run.columns[column] for run in runs]
        whole.append(np.full((len(runs), periods, *own[0].shape[1:]), blank, own[0].dtype))
        for row, rows in enumerate(own):
            whole[-1][row, : len(rows)] = rows
    return collect(whole[0], whole[1], whole[2], whole[3], program)


class _Job:
    """A batch of trials that threads share."""

    def __init__(
        self,
        scene: Scene,
        params: Any,
        waiting: deque[int],
        watch: Watch | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.scene, self.watch, self.progress = scene, watch, progress
        self.params = jax.tree.map(np.asarray, as_float32(params))  # to take rows of these compiles nothing
        self.home = np.asarray(scene.program.home(params), np.float64)
        self.parts = single_trials(params.parts)
        self.waiting = waiting  # longest first, so that no thread ends up alone with one
        self.stopped = threading.Event()
        self.lock = threading.Lock()

    def work(self) -> list[_Run]:
        """Take trials until none is left."""
        lanes, runs = _Lanes(self), []
        # where there is a GPU, the controllers still run beside the physics
        with mj_rollout.Rollout(nthread=0) as pool, jax.default_device(jax.devices("cpu")[0]):
            while not self.stopped.is_set():
                runs += lanes.finished()
                lanes.refill()
                if not lanes.busy.any():
                    break
                lanes.advance(pool)
        return runs


class _Log:
    """What all lanes logged, period by period; a block of memory that grows with the longest trial."""

    def __init__(self) -> None:
        self.count = 0  # periods kept
        self.columns: tuple[NDArray[Any], ...] = ()  # wrench, joints, phase, past [period, lane, ...]

    def add(self, *rows: NDArray[Any]) -> None:
        if not self.columns:
            self.columns = tuple(np.empty((1024, *row.shape), row.dtype) for row in rows)
        if self.count == len(self.columns[0]):
            self.columns = tuple(np.concatenate([column, np.empty_like(column)]) for column in self.columns)
        for column, row in zip(self.columns, rows, strict=True):
            column[self.count] = row
        self.count += 1

    def forget(self, periods: int) -> None:
        """Drop the oldest periods."""
        for column in self.columns:
            column[: self.count - periods] = column[periods : self.count]
        self.count -= periods

    def of(self, lane: int, begun: int) -> list[NDArray[Any]]:
        """Of one lane since a period: [period, ...]."""
        return [column[begun : self.count, lane].copy() for column in self.columns]


class _Lanes:
    """The trials that one thread steps."""

    def __init__(self, job: _Job) -> None:
        self.job, scene = job, job.scene
        self.trial = np.full(LANES, -1)
        self.begun = np.zeros(LANES, np.int64)  # period of the log in which the lane's trial began
        self.log = _Log()
        self.phase = np.full(LANES, scene.program.ended, np.int32)
        self.models = [scene.model] * LANES
        self.data = mujoco.MjData(scene.model)
        self.state = np.zeros((LANES, mujoco.mj_stateSize(scene.model, STATE)))
        self.readings = np.zeros((LANES, scene.model.nsensordata))
        self.begin, self.control = _compiled(scene.program)
        self.share = (np.arange(1, scene.substeps + 1) / scene.substeps)[None, :, None]
        self.places = scene.places[:, None] + np.arange(3)
        self.params: Any = None
        self.loop: Any = None

    @property
    def busy(self) -> NDArray[np.bool_]:
        return self.trial >= 0

    def finished(self) -> list[_Run]:
        """Trials that ended with the last period; their lanes are free again."""
        out = []
        for lane in np.flatnonzero(self.busy & (self.phase == self.job.scene.program.ended)).tolist():
            logs = self.log.of(lane, int(self.begun[lane]))
            mujoco.mj_setState(self.models[lane], self.data, self.state[lane], STATE)
            mujoco.mj_kinematics(self.models[lane], self.data)
            logs[-1][-1] = seated_tabs(self.job.scene, self.data)  # no step has followed
            out.append(_Run(int(self.trial[lane]), logs))
            self.trial[lane] = -1
        return out

    def refill(self) -> None:
        """Put waiting trials into free lanes, at rest in their home pose."""
        fresh = np.zeros(LANES, np.bool_)
        for lane in np.flatnonzero(~self.busy).tolist():
            with self.job.lock:
                if not self.job.waiting:
                    break
                self.trial[lane] = self.job.waiting.popleft()
            self._rest(lane)
            fresh[lane] = True
        if fresh.any():
            self.begun[fresh] = self.log.count
            oldest = int(self.begun[self.busy].min())
            if oldest > self.log.count // 2:  # seldom enough to be cheap
                self.log.forget(oldest)
                self.begun -= oldest
            rows = np.maximum(self.trial, 0)
            self.params = jax.tree.map(lambda leaf: jnp.asarray(leaf[rows]), self.job.params)
            self.loop = self.begin(self.params, self.loop, fresh, self._raw())

    def _rest(self, lane: int) -> None:
        """Settle a lane's trial; sets its full physics state and sensor reading."""
        scene, home = self.job.scene, self.job.home[self.trial[lane]]
        model = self.models[lane] = model_of(scene, self.job.parts[self.trial[lane]])
        mujoco.mj_resetData(model, self.data)
        settle(scene, model, self.data, home)
        self.data.time = 0.0
        mujoco.mj_forward(model, self.data)
        mujoco.mj_getState(model, self.data, self.state[lane], STATE)
        self.readings[lane] = self.data.sensordata

    def advance(self, pool: mj_rollout.Rollout) -> None:
        """One control period of all lanes."""
        joints = self.state[:, 1 + self.job.scene.joints].astype(np.float32)
        self.loop, command, log = self.control(self.params, self.loop, joints, self._raw())
        self.phase = np.asarray(log.phase)
        going = self.busy & (self.phase < self.job.scene.program.ended)
        command = np.asarray(command)
        self.readings[going & ~sane(command).all(-1)] = np.nan  # MuJoCo would take zero for a command that is NaN
        # a diverged trial stays as it is
        live = np.flatnonzero(going & sane(self.readings))
        past = np.zeros((LANES, len(self.places)), np.bool_)
        if len(live) > 0:
            past[live] = self._step(pool, live, command[live].astype(np.float64))
        self.log.add(np.asarray(log.wrench), np.asarray(log.joints), self.phase, past)
        if self.job.progress is not None:
            with self.job.lock:
                self.job.progress(int(going.sum()))

    def _step(
        self, pool: mj_rollout.Rollout, live: NDArray[np.intp], command: NDArray[np.float64]
    ) -> Bool[np.ndarray, "row tab"]:
        """The physics of one control period, and which tabs were past their lips at its beginning."""
        job, steps = self.job, self.job.scene.substeps
        before, after = command[:, :1], command[:, 1:]
        wanted = before + self.share * (after - before)
        old, states = self.state[live], np.empty((len(live), steps, self.state.shape[1]))
        readings = np.empty((len(live), steps, self.readings.shape[1]))
        # its checks would take a tenth of the time
        pool.rollout(
            [self.models[lane] for lane in live], [self.data], old, wanted,
            nstep=steps, state=states, sensordata=readings, skip_checks=True,
        )  # fmt: skip
        if job.watch is not None:
            with job.lock:
                job.watch(self.trial[live], old, wanted, readings)
        self.state[live], self.readings[live] = states[:, -1], readings[:, -1]
        return np.asarray(job.scene.seated(readings[:, 0, self.places]))  # a step leaves the places of its beginning

    def _raw(self) -> NDArray[np.float32]:
        """What the parts exert on the hands [lane, 6K]: the sensors report the opposite."""
        return -self.readings[:, (self.job.scene.forces[:, None] + np.arange(6)).ravel()].astype(np.float32)


@lru_cache
def _compiled(program: Program) -> tuple[Callable[..., Any], ...]:
    """The program's ``begin`` and ``control``, compiled for all lanes."""

    def begin(params: Any, loop: Any, fresh: Any, raw: Any) -> Any:
        started = jax.vmap(program.begin)(params, raw)
        return started if loop is None else select_lanes(fresh, started, loop)

    options = compiler_options("cpu")
    control = jax.jit(jax.vmap(program.control), compiler_options=options, donate_argnums=1)
    return jax.jit(begin, compiler_options=options), control


def model_of(scene: Scene, part: Any) -> mujoco.MjModel:
    """The compiled model with one trial's parts."""
    model = copy.copy(scene.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # it would hide a divergence
    # it looks for geoms where they were compiled, which a trial may move
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    for name, value in scene.fields(part).items():
        getattr(model, name)[:] = value
    return model


def settle(scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, home: Float64[np.ndarray, " joint"]) -> None:
    """Let a trial come to rest in its home pose; ``data`` is new or reset."""
    data.qpos[scene.joints] = home
    data.ctrl[:] = home
    mujoco.mj_step(model, data, SETTLING)


def seated_tabs(scene: Scene, data: mujoco.MjData) -> Bool[np.ndarray, " tab"]:
    """Which tabs are past their lips, by the places in ``data``."""
    turns = data.geom_xmat[scene.lips].reshape(-1, 3, 3)
    return np.asarray(scene.seated(from_lips(data.geom_xpos[scene.tips], data.geom_xpos[scene.lips], turns)))
