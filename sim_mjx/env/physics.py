"""One trial's physics on the device, which an environment steps and its user maps over trials."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import single_trials, stack
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines import device, native
from sim_mjx.engines.common import unwarned
from sim_mjx.engines.device import Body, Layout
from sim_mjx.engines.quiet import mjx

Fields = dict[str, Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Glance:
    """What an environment reads of a scene besides joints and wrenches."""

    seated: Bool[Array, "*batch tab"]  # tabs past their lips
    jacobian: Float[Array, "*batch twist joint"]  # of the wrists, velocity above angular velocity, world axes


@runtime_checkable
class Physics(Protocol):
    """The functions of a simulator that an environment needs; pure functions of one trial."""

    @property
    def substeps(self) -> int:
        """Steps per control period."""

    @property
    def unroll(self) -> bool:
        """Whether the steps of a control period are compiled one after the other."""

    def step(self, fields: Fields, body: Any, ctrl: Array) -> tuple[Any, Glance]:
        """One physics step towards joint angles ``ctrl`` [J], rad from home; ``body`` as of :meth:`enter`."""

    def enter(self, body: Any) -> Any:
        """The form in which a body is carried from step to step."""

    def leave(self, body: Any) -> Any:
        """The form in which a body is kept between calls."""

    def joints(self, body: Any) -> Array:
        """Joint angles [J], rad from home."""

    def raw(self, body: Any) -> Array:
        """What the parts exert on the hands [6K], N and Nm, wrist frames."""


@dataclass(frozen=True)
class MjxPhysics:
    """MJX, with JAX's or Warp's kernels, as :mod:`sim_mjx.engines.device` runs them."""

    model: mjx.Model
    empty: mjx.Data
    layout: Layout
    sites: tuple[int, ...]  # of the wrists' sensors
    hinges: tuple[int, ...]  # of all joints of the robot
    moves: Bool[np.ndarray, "wrist joint"]  # which joints move which wrist

    @property
    def substeps(self) -> int:
        return self.layout.substeps

    @property
    def unroll(self) -> bool:
        return self.model.impl == mjx.Impl.WARP  # quick to compile, and a loop would copy its buffers

    def step(self, fields: Fields, body: Any, ctrl: Array) -> tuple[Any, Glance]:
        # a program that forbids promotions, which MJX makes, can still use the environment
        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            data = device.step_trial(self.model, self.empty, fields, body, ctrl)
        glance = Glance(device.seated_tabs(self.layout, data), self._jacobian(data))
        return (data if isinstance(body, mjx.Data) else device.body_of(data)), glance

    def enter(self, body: Body) -> Any:
        return body if self.model.impl == mjx.Impl.JAX else self.empty.replace(**vars(body))

    def leave(self, body: Any) -> Body:
        return device.body_of(body) if isinstance(body, mjx.Data) else body

    def joints(self, body: Any) -> Array:
        return body.qpos[jnp.array(self.layout.joints)]

    def raw(self, body: Any) -> Array:
        return -body.sensordata[jnp.array(self.layout.readings)]

    def _jacobian(self, data: mjx.Data) -> Array:
        """Geometric Jacobian of the wrists [6K, J]: a hinge moves a point at right angles to its axis and the lever."""
        hinges = jnp.array(self.hinges)
        axes, anchors = data.xaxis[hinges], data.xanchor[hinges]
        levers = data.site_xpos[jnp.array(self.sites)][:, None] - anchors[None]
        turning = jnp.broadcast_to(axes[None], levers.shape)
        moves = jnp.asarray(self.moves, axes.dtype)[..., None]
        columns = jnp.concatenate([jnp.cross(turning, levers), turning], axis=-1) * moves
        return jnp.swapaxes(columns, 1, 2).reshape(-1, len(self.hinges))


def new_physics(scene: Scene, impl: str, parallel: int) -> MjxPhysics:
    """A scene on the device.

    Args:
        scene: what is simulated.
        impl: "jax" or "warp".
        parallel: environments that step at once at most; Warp's kernels reserve memory for them.

    Raises:
        InputError: a joint that is no hinge.
    """
    model = scene.model
    hinges, sites = scene.hinges, sites_of(scene)
    if (model.jnt_type[hinges] != mujoco.mjtJoint.mjJNT_HINGE).any():
        raise InputError("This scene's robot has a joint that is no hinge; environments need robots with hinges only.")
    moves = np.array([_chain(model, int(model.site_bodyid[site]), hinges) for site in sites])
    compiled, empty = device.put_scene(scene, parallel, impl)
    return MjxPhysics(compiled, empty, device.layout_of(scene), tuple(sites), tuple(hinges.tolist()), moves)


def sites_of(scene: Scene) -> list[int]:
    """Where the wrists' sensors are."""
    sensors = np.searchsorted(scene.model.sensor_adr, scene.forces)
    return [int(scene.model.sensor_objid[sensor]) for sensor in sensors]


def settled(scene: Scene, params: Any) -> tuple[Body, Glance]:
    """Trials at rest in their home pose, where the tool's weight bends the servos.

    C MuJoCo settles them: the device's program would have to be compiled for that alone.

    Args:
        scene: what is simulated.
        params: a batch of trials.
    """
    home = np.asarray(scene.program.home(params), np.float64)
    with unwarned(), ThreadPoolExecutor(os.cpu_count()) as pool:
        bodies, glances = zip(*pool.map(partial(_settle, scene), single_trials(params.parts), home), strict=True)
    return stack(list(bodies)), stack(list(glances))


def _settle(scene: Scene, part: Any, home: Float[np.ndarray, " joint"]) -> tuple[Body, Glance]:
    model = native.model_of(scene, part)
    data = mujoco.MjData(model)
    native.settle(scene, model, data, home)
    qpos = data.qpos.copy()
    qpos[scene.joints] -= home
    values = (qpos, data.qvel, data.qacc_warmstart, data.sensordata)
    turning, moving = np.zeros((2, 3, model.nv))
    dofs, twists = model.jnt_dofadr[scene.hinges], []
    for site in sites_of(scene):
        mujoco.mj_jacSite(model, data, moving, turning, site)
        twists.append(np.concatenate([moving, turning])[:, dofs])
    mujoco.mj_kinematics(model, data)  # a step leaves the places of its beginning
    seated = native.seated_tabs(scene, data)
    body = Body(*(np.asarray(value, np.float32) for value in values))
    return body, Glance(seated, np.concatenate(twists).astype(np.float32))


def _chain(model: mujoco.MjModel, body: int, hinges: np.ndarray) -> list[bool]:
    """Which of the joints lie between the world and a body."""
    ancestors = {body}
    while body > 0:
        body = int(model.body_parentid[body])
        ancestors.add(body)
    return [int(model.jnt_bodyid[hinge]) in ancestors for hinge in hinges]
