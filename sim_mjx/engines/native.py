"""C MuJoCo, batched over threads: the source of truth."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout as mj_rollout
from numpy.typing import NDArray

from sim_mjx import task
from sim_mjx.engines.common import CPU_OPTIONS, SETTLING, collect, past_lips, sane
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.rollout import Program, Rollouts, as_float32, batch_size
from sim_mjx.scene import Scene

# Rows of the batch that were stepped, their states before [row, ...], references [row, substep, J] and sensor
# readings [row, substep, ...] of one control period.
Watch = Callable[[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], None]


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
        scene: what is simulated.
        params: batch of trials of the scene's program.
        threads: default all cores.
        progress: called with the number of control periods done since the last call, summed over trials.
        watch: called after the physics of each control period; see ``Watch``.
    """
    trials = batch_size(params)
    models = [model_of(scene, jax.tree.map(lambda leaf, i=i: leaf[i], params.parts)) for i in range(trials)]
    threads = threads or os.cpu_count() or 1
    datas = [mujoco.MjData(scene.model) for _ in range(threads)]
    state, readings = _first(scene, models, np.asarray(scene.program.home(params)))
    fast = as_float32(params)
    joints = state[:, 1 + scene.joints].astype(np.float32)
    begin, control = _compiled(scene.program)
    loop = begin(fast, jnp.asarray(_raw(scene, readings)))
    rows, phases = [], []
    share = (np.arange(1, scene.substeps + 1) / scene.substeps)[None, :, None]
    limit = int(np.ceil(np.max(scene.program.timeout(params)) / CONTROL_PERIOD)) + 1
    with mj_rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
        for _ in range(limit):
            loop, command, log = control(fast, loop, jnp.asarray(joints), jnp.asarray(_raw(scene, readings)))
            rows.append((np.asarray(log.wrench), np.asarray(log.joints)))
            phases.append(np.asarray(log.phase))
            if (phases[-1] == task.ENDED).all():
                break
            before, after = np.moveaxis(np.asarray(command, np.float64), 1, 0)
            wanted = before[:, None] + share * (after - before)[:, None]
            # an ended trial stays as it is, or its end would depend on how long the others last
            live = np.flatnonzero((phases[-1] < task.ENDED) & sane(readings))
            if len(live) > 0:
                mine = [models[i] for i in live]
                states, sensors = pool.rollout(mine, datas, state[live], wanted[live], nstep=scene.substeps)
                if watch is not None:
                    watch(live, state[live], wanted[live], sensors)
                state[live], readings[live] = states[:, -1], sensors[:, -1]
            joints = state[:, 1 + scene.joints].astype(np.float32)
            if progress is not None:
                progress(int((phases[-1] < task.ENDED).sum()))
    wrench, angles = (np.stack(column, 1) for column in zip(*rows, strict=True))
    seated = np.stack([tips_past_lips(scene, model, row) for model, row in zip(models, state, strict=True)])
    return collect(wrench, angles, np.stack(phases, 1), seated)


@lru_cache
def _compiled(program: Program) -> tuple[Callable[..., Any], ...]:
    """Begin and control of a batch."""
    begin = jax.jit(jax.vmap(program.begin), compiler_options=CPU_OPTIONS)
    return begin, jax.jit(jax.vmap(program.control), compiler_options=CPU_OPTIONS, donate_argnums=1)


def model_of(scene: Scene, part: Any) -> mujoco.MjModel:
    """The compiled model with one trial's parts."""
    model = copy.copy(scene.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # it would hide a divergence
    for name, value in scene.fields(part).items():
        getattr(model, name)[:] = value
    return model


def _first(
    scene: Scene, models: list[mujoco.MjModel], home: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Full physics states [trial, ...] at rest in the home pose, and their sensor readings."""
    data = mujoco.MjData(scene.model)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.zeros((len(models), mujoco.mj_stateSize(scene.model, kind)))
    readings = np.zeros((len(models), scene.model.nsensordata))
    for row, model in enumerate(models):
        mujoco.mj_resetData(model, data)
        data.qpos[scene.joints] = home[row]
        data.ctrl[:] = home[row]
        for _ in range(SETTLING):
            mujoco.mj_step(model, data)
        data.time = 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_getState(model, data, states[row], kind)
        readings[row] = data.sensordata
    return states, readings


def _raw(scene: Scene, readings: NDArray[np.float64]) -> NDArray[np.float32]:
    """What the parts exert on the hands [trial, 6K]: the sensors report the opposite."""
    return -readings[:, (scene.forces[:, None] + np.arange(6)).ravel()].astype(np.float32)


def tips_past_lips(scene: Scene, model: mujoco.MjModel, state: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which tabs have snapped [tab] in a full physics state."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_kinematics(model, data)
    turns = data.geom_xmat[scene.lips].reshape(-1, 3, 3)
    return past_lips(data.geom_xpos[scene.tips], data.geom_xpos[scene.lips], turns)
