"""MJX-JAX: the whole rollout on the device, one compiled program for a stretch of control periods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx
from numpy.typing import NDArray

from sim_mjx import task
from sim_mjx.engines.common import CPU_OPTIONS, SETTLING, collect, past_lips
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.rollout import Program, Reading, Rollouts, as_float32, batch_size
from sim_mjx.scene import Scene

Array = Any
CHUNK = 200  # control periods that run without asking whether all trials have ended


@dataclass(frozen=True)
class _Layout:
    """What a compiled program must know of its scene; hashable."""

    program: Program
    joints: tuple[int, ...]
    readings: tuple[int, ...]  # [6K] addresses in sensordata
    tips: tuple[int, ...]  # geoms
    lips: tuple[int, ...]
    substeps: int


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Trial:
    """What stays the same during a trial."""

    params: Any  # of the scene's program
    fields: dict[str, Array]  # of the model


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Body:
    """What the physics remembers between steps."""

    qpos: Array
    qvel: Array
    warmstart: Array  # accelerations, the solver's first guess
    sensors: Array


def simulate(scene: Scene, params: Any, *, progress: Callable[[int], None] | None = None) -> Rollouts:
    """Simulate a batch of trials until all have ended, in single precision on JAX's default device.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        progress: called with the number of control periods done since the last call, summed over trials.
    """
    model, layout = mjx.put_model(scene.model, impl="jax"), _layout(scene)
    trials = _Trial(as_float32(params), _fields(scene, params))
    settle, run, seated = _programs(jax.default_backend())
    body, loop = settle(layout, model, trials)
    logs: list[Reading] = []
    limit = int(np.ceil(np.max(scene.program.timeout(params)) / CONTROL_PERIOD)) + 1
    for _ in range(-(-limit // CHUNK)):
        body, loop, log = run(layout, model, trials, body, loop)
        logs.append(jax.device_get(log))
        if progress is not None:
            progress(int((logs[-1].phase < task.ENDED).sum()))
        if (logs[-1].phase[-1] == task.ENDED).all():
            break
    whole: Reading = jax.tree.map(lambda *pieces: np.moveaxis(np.concatenate(pieces), 0, 1), *logs)
    reached = np.asarray(seated(layout, model, trials, body))
    return collect(whole.wrench, whole.joints, whole.phase, reached)


@lru_cache
def _programs(backend: str) -> tuple[Callable[..., Any], ...]:
    """Compiled functions of a backend: settle, run, seated."""
    jit = partial(jax.jit, static_argnums=0, compiler_options=CPU_OPTIONS if backend == "cpu" else None)
    return jit(_settle), jit(_run, donate_argnums=(3, 4)), jit(_seated)


def _layout(scene: Scene) -> _Layout:
    readings = (scene.forces[:, None] + np.arange(6)).ravel()
    joints, seen, tips, lips = (
        tuple(int(i) for i in column) for column in (scene.joints, readings, scene.tips, scene.lips)
    )
    return _Layout(scene.program, joints, seen, tips, lips, scene.substeps)


def _fields(scene: Scene, params: Any) -> dict[str, NDArray[np.float32]]:
    """Model fields of all trials, each [trial, ...]."""
    rows = [scene.fields(jax.tree.map(lambda leaf, i=i: leaf[i], params.parts)) for i in range(batch_size(params))]
    return {name: np.stack([row[name] for row in rows]).astype(np.float32) for name in rows[0]}


def _settle(layout: _Layout, model: mjx.Model, trials: _Trial) -> tuple[_Body, Any]:
    """At rest in the home pose, with the sensor reading of that moment."""
    empty = mjx.make_data(model, impl="jax")

    def one(trial: _Trial) -> tuple[_Body, Any]:
        own, home = model.tree_replace(trial.fields), layout.program.home(trial.params)
        qpos = empty.qpos.at[jnp.array(layout.joints)].set(home)

        def step(body: _Body, last: Array) -> tuple[_Body, None]:
            new = _step(own, empty, body, home)
            # a step's reading is that of its start: one more step reads the settled state and is not kept
            seen = _Body(body.qpos, body.qvel, body.warmstart, new.sensors)
            return jax.tree.map(lambda at_last, moved: jnp.where(last, at_last, moved), seen, new), None

        body = _Body(qpos, empty.qvel, empty.qacc_warmstart, empty.sensordata)
        body, _ = jax.lax.scan(step, body, jnp.arange(SETTLING + 1) == SETTLING)
        return body, layout.program.begin(trial.params, _raw(layout, body))

    return jax.vmap(one)(trials)


def _run(layout: _Layout, model: mjx.Model, trials: _Trial, body: _Body, loop: Any) -> tuple[_Body, Any, Reading]:
    """``CHUNK`` control periods; the log leads with time."""
    empty = mjx.make_data(model, impl="jax")

    def one(trial: _Trial, body: _Body, loop: Any) -> tuple[_Body, Any, Reading]:
        joints = body.qpos[jnp.array(layout.joints)]
        loop, (before, after), log = layout.program.control(trial.params, loop, joints, _raw(layout, body))
        share = jnp.arange(1, layout.substeps + 1)[:, None] / layout.substeps
        own = model.tree_replace(trial.fields)

        def substep(at: _Body, wanted: Array) -> tuple[_Body, None]:
            return _step(own, empty, at, wanted), None

        moved, _ = jax.lax.scan(substep, body, before + share * (after - before))
        ended = log.phase == task.ENDED
        return jax.tree.map(lambda old, new: jnp.where(ended, old, new), body, moved), loop, log

    def period(carry: tuple[_Body, Any], _: None) -> tuple[tuple[_Body, Any], Reading]:
        body, loop, log = jax.vmap(one)(trials, *carry)
        return (body, loop), log

    (body, loop), log = jax.lax.scan(period, (body, loop), length=CHUNK)
    return body, loop, log


def _step(model: mjx.Model, empty: mjx.Data, body: _Body, wanted: Array) -> _Body:
    data = empty.replace(qpos=body.qpos, qvel=body.qvel, qacc_warmstart=body.warmstart, ctrl=wanted)
    data = mjx.step(model, data)
    return _Body(data.qpos, data.qvel, data.qacc_warmstart, data.sensordata)


def _raw(layout: _Layout, body: _Body) -> Array:
    """What the parts exert on the hands [6K]: the sensors report the opposite."""
    return -body.sensors[jnp.array(layout.readings)]


def _seated(layout: _Layout, model: mjx.Model, trials: _Trial, body: _Body) -> Array:
    empty = mjx.make_data(model, impl="jax")

    def one(trial: _Trial, body: _Body) -> Array:
        data = mjx.kinematics(model.tree_replace(trial.fields), empty.replace(qpos=body.qpos))
        tips, lips = jnp.array(layout.tips), jnp.array(layout.lips)
        return past_lips(data.geom_xpos[tips], data.geom_xpos[lips], data.geom_xmat[lips])

    return jax.vmap(one)(trials, body)
