"""MJX, with JAX's or Warp's kernels: whole rollouts on the device, without a word to the host every period.

All trials of a batch run until the last has ended. One compiled program does a stretch of control periods:
sensor, state machine, controller and physics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx
from numpy.typing import NDArray

from sim_mjx import task
from sim_mjx.engines.common import CPU_OPTIONS, SETTLING, collect, past_lips
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.rollout import Program, Reading, Rollouts, as_float32, batch_size
from sim_mjx.scene import Scene

Array = Any
STRETCH = 200  # control periods that run without asking whether all trials have ended


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
class _Fixed:
    """What stays the same during the trials."""

    model: mjx.Model
    fields: dict[str, Array]  # of the model, [trial, ...]
    params: Any  # of the scene's program, [trial, ...]
    empty: mjx.Data  # of one trial


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Body:
    """What the physics remembers between steps [trial, ...]; named as in ``mjx.Data``.

    Warp's kernels write into the buffers of a whole ``mjx.Data``, which then takes the place of this.
    """

    qpos: Array
    qvel: Array
    qacc_warmstart: Array  # the solver's first guess
    sensordata: Array


@dataclass(frozen=True)
class Outcome:
    """A batch of trials that all have ended, on the device."""

    log: Reading  # [time, trial, ...]
    seated: Array  # [trial, tab]


def simulate(scene: Scene, params: Any, impl: str, *, progress: Callable[[int], None] | None = None) -> Rollouts:
    """Simulate a batch of trials until all have ended, in single precision on JAX's default device.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        impl: "jax" or "warp".
        progress: called with the number of control periods done since the last call, summed over trials.
    """
    out = run(scene, params, impl, progress=progress)
    log: Reading = jax.device_get(out.log)
    wrench, joints, phase = (np.moveaxis(column, 0, 1) for column in (log.wrench, log.joints, log.phase))
    return collect(wrench, joints, phase, np.asarray(out.seated))


def run(scene: Scene, params: Any, impl: str, *, progress: Callable[[int], None] | None = None) -> Outcome:
    """As :func:`simulate`, but what comes out stays on the device."""
    layout, fixed = _layout(scene), _fixed(scene, params, impl)
    start, stretch, seated = _programs(jax.default_backend())
    body, loop = start(layout, fixed)
    logs: list[Reading] = []
    limit = int(np.ceil(np.max(scene.program.timeout(params)) / CONTROL_PERIOD)) + 1
    for _ in range(-(-limit // STRETCH)):
        body, loop, log = stretch(layout, fixed, body, loop)
        logs.append(log)
        last = np.asarray(log.phase[-1])
        if progress is not None:
            progress(int((np.asarray(log.phase) < task.ENDED).sum()))
        if (last == task.ENDED).all():
            break
    whole: Reading = jax.tree.map(lambda *pieces: jnp.concatenate(pieces), *logs)
    return Outcome(whole, seated(layout, fixed, body))


@lru_cache
def _programs(backend: str) -> tuple[Callable[..., Any], ...]:
    """Compiled functions of a backend: start, stretch, seated."""
    jit = partial(jax.jit, static_argnums=0, compiler_options=CPU_OPTIONS if backend == "cpu" else None)
    return jit(_start), jit(_stretch, donate_argnums=(2, 3)), jit(_seated)


def _layout(scene: Scene) -> _Layout:
    readings = (scene.forces[:, None] + np.arange(6)).ravel()
    joints, seen, tips, lips = (
        tuple(int(i) for i in column) for column in (scene.joints, readings, scene.tips, scene.lips)
    )
    return _Layout(scene.program, joints, seen, tips, lips, scene.substeps)


def _fixed(scene: Scene, params: Any, impl: str) -> _Fixed:
    count = batch_size(params)
    sizes = {"naconmax": count * scene.model.npair, "njmax": _most_rows(scene.model)} if impl == "warp" else {}
    model, empty = mjx.put_model(scene.model, impl=impl), mjx.make_data(scene.model, impl=impl, **sizes)
    return _Fixed(model, _fields(scene, params), as_float32(params), empty)


def _fields(scene: Scene, params: Any) -> dict[str, NDArray[np.float32]]:
    """Model fields of all trials, each [trial, ...]."""
    rows = [scene.fields(jax.tree.map(lambda leaf, i=i: leaf[i], params.parts)) for i in range(batch_size(params))]
    return {name: np.stack([row[name] for row in rows]).astype(np.float32) for name in rows[0]}


def _most_rows(model: mujoco.MjModel) -> int:
    """Most constraint rows at a time: all pairs in contact, at both limits of no joint."""
    elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    contacts = model.pair_dim if elliptic else np.maximum(2 * (model.pair_dim - 1), 1)
    return int(contacts.sum() + model.jnt_limited.sum())


def _start(layout: _Layout, fixed: _Fixed) -> tuple[Any, Any]:
    """Bodies at rest in the home pose, and the loops with the sensor reading of that moment."""
    home = layout.program.home(fixed.params)
    body = jax.vmap(lambda q: fixed.empty.replace(qpos=fixed.empty.qpos.at[jnp.array(layout.joints)].set(q)))(home)
    if fixed.model.impl == mjx.Impl.JAX:
        body = _Body(body.qpos, body.qvel, body.qacc_warmstart, body.sensordata)
    body = jax.lax.fori_loop(0, SETTLING, lambda _, at: _step(fixed, at, home), body)
    # a step's reading is that of its start: one more step reads the settled state and is not kept
    seen = _step(fixed, body, home).sensordata
    body = dataclasses.replace(body, sensordata=seen)
    return body, jax.vmap(layout.program.begin)(fixed.params, _raw(layout, body))


def _stretch(layout: _Layout, fixed: _Fixed, body: Any, loop: Any) -> tuple[Any, Any, Reading]:
    """``STRETCH`` control periods; the log leads with time."""

    def period(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Reading]:
        body, loop = carry
        raw = _raw(layout, body)
        loop, ends, log = jax.vmap(layout.program.control)(
            fixed.params, loop, body.qpos[:, jnp.array(layout.joints)], raw
        )
        before, after = ends[:, 0], ends[:, 1]
        moved = body
        for share in np.arange(1, layout.substeps + 1, dtype=np.float32) / np.float32(layout.substeps):
            moved = _step(fixed, moved, before + share * (after - before))
        return (_kept(body, moved, log.phase == task.ENDED), loop), log

    (body, loop), log = jax.lax.scan(period, (body, loop), length=STRETCH)
    return body, loop, log


def _step(fixed: _Fixed, body: Any, wanted: Array) -> Any:
    """One physics step of all trials."""

    def one(fields: dict[str, Array], at: Any, ctrl: Array) -> Any:
        model = fixed.model.tree_replace(fields)
        if isinstance(at, mjx.Data):
            return mjx.step(model, at.replace(ctrl=ctrl))
        data = fixed.empty.replace(qpos=at.qpos, qvel=at.qvel, qacc_warmstart=at.qacc_warmstart, ctrl=ctrl)
        data = mjx.step(model, data)
        return _Body(data.qpos, data.qvel, data.qacc_warmstart, data.sensordata)

    return jax.vmap(one)(fixed.fields, body, wanted)


def _kept(old: Any, new: Any, still: Array) -> Any:
    """The new bodies, but the old ones where the trial keeps still [trial]."""
    names = [field.name for field in dataclasses.fields(_Body)]
    chosen = {name: jnp.where(still[:, None], getattr(old, name), getattr(new, name)) for name in names}
    return dataclasses.replace(new, **chosen)


def _raw(layout: _Layout, body: Any) -> Array:
    """What the parts exert on the hands [trial, 6K]: the sensors report the opposite."""
    return -body.sensordata[:, jnp.array(layout.readings)]


def _seated(layout: _Layout, fixed: _Fixed, body: Any) -> Array:
    def one(fields: dict[str, Array], qpos: Array) -> Array:
        data = mjx.kinematics(fixed.model.tree_replace(fields), fixed.empty.replace(qpos=qpos))
        tips, lips = jnp.array(layout.tips), jnp.array(layout.lips)
        return past_lips(data.geom_xpos[tips], data.geom_xpos[lips], data.geom_xmat[lips])

    return jax.vmap(one)(fixed.fields, body.qpos)
