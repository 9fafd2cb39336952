"""The smallest scene an engine can run: one joint pushes a ball onto a floor, until a time that is the trial's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import LogRow, Program
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD, starts

ENDED = 2
XML = f"""
<mujoco>
  <option timestep="{CONTROL_PERIOD}" cone="pyramidal"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" contype="0" conaffinity="0"/>
    <body name="arm" pos="0 0 .1">
      <joint name="slide" type="slide" axis="0 0 -1" damping="5" armature=".01" range="-1 1"/>
      <geom type="sphere" size=".01" mass=".2" contype="0" conaffinity="0"/>
      <body name="hand"><site name="wrist"/>
        <geom name="tip" type="sphere" size=".02" mass=".1" contype="0" conaffinity="0"/></body>
    </body>
  </worldbody>
  <contact><pair geom1="tip" geom2="floor"/></contact>
  <actuator><position joint="slide" kp="300"/></actuator>
  <sensor><force site="wrist"/><torque site="wrist"/>
    <framepos objtype="geom" objname="tip" reftype="geom" refname="floor"/></sensor>
</mujoco>
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlungerParams:
    """One trial, or a batch whose leaves lead with the trial."""

    home: Float[Array, "*batch 1"]  # m
    speed: Float[Array, "*batch"]  # m/s
    timeout: Float[Array, "*batch"]  # s
    parts: Float[Array, "*batch"]  # damping of the joint, N s/m


def plunger_trials(timeout: np.ndarray[Any, Any]) -> PlungerParams:
    """Trials of these lengths, s, that differ in all else too."""
    rng, count = np.random.default_rng(0), len(timeout)
    home = rng.uniform(0.0, 0.05, (count, 1))
    return PlungerParams(home, rng.uniform(0.1, 0.5, count), timeout, rng.uniform(3.0, 9.0, count))


def plunger() -> Scene:
    """The scene; a trial is "seated" while its ball is near the floor."""
    model = mujoco.MjModel.from_xml_string(XML)
    one = np.array([0], np.int32)
    tips = np.array([model.geom("tip").id], np.int32)
    lips = np.array([model.geom("floor").id], np.int32)
    program = Program(_begin, _control, lambda params: params.home, lambda params: params.timeout, ENDED, starts)
    places = np.array([6], np.int32)
    return Scene(model, program, one, one, tips, lips, places, _fields, 1, _beneath)


def _begin(params: PlungerParams, raw: Array) -> dict[str, Array]:
    return {"tick": jnp.int32(0), "least": jnp.zeros((), raw.dtype)}


def _control(params: PlungerParams, loop: dict[str, Array], joints: Array, raw: Array) -> Any:
    time = loop["tick"].astype(jnp.float32) * CONTROL_PERIOD
    phase = jnp.where(time > params.timeout, ENDED, (time > params.timeout / 2).astype(jnp.int32))
    ends = params.home[None] + params.speed * (time + jnp.array([[0.0], [CONTROL_PERIOD]], jnp.float32))
    after = {"tick": loop["tick"] + 1, "least": jnp.minimum(loop["least"], raw[2])}
    reading = raw.at[0].set(after["least"])  # what the loop remembers shows in the log
    return after, ends, LogRow(reading, joints, phase)


def _fields(parts: np.ndarray[Any, Any]) -> dict[str, np.ndarray[Any, Any]]:
    return {"dof_damping": np.asarray(parts)[..., None]}


def _beneath(local: Array) -> Array:
    return local[..., 2] < 0.03
