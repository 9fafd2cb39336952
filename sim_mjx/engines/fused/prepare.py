"""A scene for the kernel: whether it can simulate it, the structure of the model, and the numbers of trials."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Int32
from numpy.typing import NDArray

from rcbht_jax.types import Array
from sim_mjx.assembly.scene import Scene

LEAST_FRICTION = 1e-5  # MuJoCo's mjMINMU
MOST_JOINTS = 31  # bits of an integer; the kernel's matrices are unrolled
# Fields of the model that trials may have of their own.
NUMBERS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "body_gravcomp", "qpos0",
    "qpos_spring", "jnt_pos", "jnt_axis", "jnt_range", "jnt_margin", "jnt_solref", "jnt_solimp", "jnt_stiffness",
    "dof_damping", "dof_armature", "dof_invweight0", "geom_pos", "geom_quat", "geom_size", "pair_friction",
    "pair_solref", "pair_solimp", "pair_margin", "body_invweight0", "actuator_gear", "actuator_gainprm",
    "actuator_biasprm", "actuator_forcerange", "site_pos", "site_quat",
)  # fmt: skip
# Fields that must be zero: what they switch on the kernel does not have.
ZERO = {
    "ntendon": "tendons", "neq": "equality constraints", "na": "actuators with a state", "nplugin": "plugins",
    "nflex": "flexible bodies", "nmocap": "mocap bodies", "dof_frictionloss": "friction in joints",
    "jnt_stiffnesspoly": "springs that are not linear", "dof_dampingpoly": "dampers that are not linear",
    "jnt_actfrclimited": "limits of a joint's actuator force", "actuator_ctrllimited": "limits of controls",
    "actuator_damping": "damping of actuators", "actuator_armature": "armature of actuators",
    "actuator_dyntype": "actuators with a state", "actuator_gaintype": "gains that are not constant",
    "actuator_trntype": "actuators of other than joints", "pair_solreffriction": "references of friction",
    "pair_adhesion": "adhesion", "geom_surfacevel": "surfaces that move",
}  # fmt: skip


def missing(model: mujoco.MjModel) -> str | None:
    """What the kernel does not have of a model; None if it can simulate it.

    >>> missing(mujoco.MjModel.from_xml_string("<mujoco/>"))
    'the integrator Euler'
    """
    option, kinds = model.opt, set(model.jnt_type.tolist())
    if option.integrator != mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        return f"the integrator {mujoco.mjtIntegrator(option.integrator).name.removeprefix('mjINT_').title()}"
    if option.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        return "pyramidal friction cones"
    if option.disableflags or option.enableflags or option.density or option.viscosity or option.wind.any():
        return "flags, fluids or wind"
    if kinds - {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}:
        return "ball and free joints"
    if len(set(model.actuator_trnid[:, 0].tolist())) < model.nu:
        return "several actuators of one joint"
    if not 0 < model.njnt <= MOST_JOINTS:
        return f"{model.njnt} joints (1 to {MOST_JOINTS} work)"
    if not set(model.actuator_biastype.tolist()) <= {mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE}:
        return "biases of actuators that are not affine"
    for name, what in ZERO.items():
        if np.any(getattr(model, name)):
            return what
    if (model.geom_contype | model.geom_conaffinity).any():
        return "contacts without a pair"
    pairs = model.geom_type[_pairs(model)]
    balls, boxes = pairs[:, 0] == mujoco.mjtGeom.mjGEOM_SPHERE, pairs[:, 1] == mujoco.mjtGeom.mjGEOM_BOX
    if not (balls & boxes & (model.pair_dim == 3)).all():
        return "contacts of other than spheres with boxes"
    return None


def _pairs(model: mujoco.MjModel) -> Int32[np.ndarray, "pair 2"]:
    """Geoms of each pair; spheres come first, as in MuJoCo's contacts."""
    pairs = np.stack([model.pair_geom1, model.pair_geom2], 1)
    return np.take_along_axis(pairs, np.argsort(model.geom_type[pairs], axis=1, kind="stable"), axis=1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Structure:
    """What all trials of a scene share."""

    numbered: dict[str, Array]  # integers, by the kernel's names
    shared: dict[str, Array]  # fields of the model by ``NUMBERS``, [item, ..., 1]
    numbers: Array  # gravity, origin, time step, ratio of impedances
    sites: Array  # of the force sensors
    limited: Array  # whether an actuator's force is
    biased: Array  # whether an actuator has a bias


def structure(scene: Scene) -> Structure:
    """The structure of a scene."""
    model = scene.model
    moves = np.zeros(model.nbody, np.uint32)
    for body in range(1, model.nbody):
        first = model.body_jntadr[body]
        moves[body] = moves[model.body_parentid[body]] | sum(1 << (first + k) for k in range(model.body_jntnum[body]))
    actuator = np.full(model.njnt, -1)
    actuator[model.actuator_trnid[:, 0]] = np.arange(model.nu)
    sites = model.sensor_objid[np.searchsorted(model.sensor_adr, scene.forces)]
    numbered = {
        "body_parentid": model.body_parentid, "body_jntadr": model.body_jntadr, "body_jntnum": model.body_jntnum,
        "body_moves": moves, "jnt_slides": model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE,
        "jnt_limited": model.jnt_limited, "dof_bodyid": model.dof_bodyid, "geom_bodyid": model.geom_bodyid,
        "pair_geom": _pairs(model), "jnt_actuator": actuator,
        "site_body": model.site_bodyid[sites], "site_sensor": scene.forces,
        "tip_geom": np.stack([scene.tips, scene.lips], 1),
    }  # fmt: skip
    numbers = np.concatenate([model.opt.gravity, _origin(model), [model.opt.timestep, model.opt.impratio]])
    shared = {name: getattr(model, name).astype(np.float32)[..., None] for name in NUMBERS}
    integers = {name: np.ascontiguousarray(value).astype(np.int32) for name, value in numbered.items()}
    limited, biased = (
        model.actuator_forcelimited.astype(np.bool_),
        model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE,
    )
    return jax.device_put(
        Structure(integers, shared, numbers.astype(np.float32), sites.astype(np.int32), limited, biased)
    )


def _origin(model: mujoco.MjModel) -> NDArray[np.float64]:
    """A place near the contacts."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.geom_xpos[model.pair_geom2].mean(0) if model.npair else np.zeros(3)


def numbers_of(structure: Structure, fields: dict[str, Array]) -> dict[str, Array]:
    """The kernel's real arrays, [item, ..., trial], or [item, ..., 1] where all trials share them.

    Args:
        structure: of the scene. fields: of the model, of each trial, [trial, ...].
    """
    of = structure.shared | {name: jnp.moveaxis(leaf, 0, -1) for name, leaf in fields.items()}
    quaternions = {name: jnp.roll(of[name], -1, axis=1) for name in ("body_quat", "geom_quat")}
    gear, weights = of["actuator_gear"][:, 0], of["body_invweight0"][:, 0]
    bias = jnp.where(structure.biased[:, None, None], of["actuator_biasprm"], 0.0)
    first, second = (structure.numbered["geom_bodyid"][side] for side in structure.numbered["pair_geom"].T)
    limits = gear[:, None] * of["actuator_forcerange"]
    free = jnp.array([-jnp.inf, jnp.inf], jnp.float32)[None, :, None]
    kept = ("body_pos", "body_ipos", "body_mass", "body_gravcomp", "qpos0", "qpos_spring", "jnt_pos", "jnt_axis",
            "jnt_range", "jnt_margin", "jnt_solref", "jnt_solimp", "jnt_stiffness", "dof_damping", "dof_armature",
            "dof_invweight0", "geom_pos", "geom_size", "pair_solref", "pair_solimp")  # fmt: skip
    return {name: of[name] for name in kept} | quaternions | {
        "body_inertia": _turned(of["body_inertia"], of["body_iquat"]),
        "pair_friction": jnp.maximum(of["pair_friction"][:, :2], LEAST_FRICTION),
        "pair_margin": of["pair_margin"],  # contacts in a gap beyond it exert nothing
        "pair_invweight": weights[first] + weights[second],
        "actuator_gain": gear * of["actuator_gainprm"][:, 0],
        "actuator_bias": jnp.stack([gear * bias[:, 0], gear**2 * bias[:, 1], gear**2 * bias[:, 2]], 1),
        "actuator_range": jnp.where(structure.limited[:, None, None], jnp.sort(limits, axis=1), free),
        "site_pos": of["site_pos"][structure.sites],
        "site_quat": jnp.roll(of["site_quat"], -1, axis=1)[structure.sites],
    }  # fmt: skip


def _turned(inertia: Array, quat: Array) -> Array:
    """Principal inertias in the body's axes [body, 6, trial]: xx, yy, zz, xy, xz, yz."""
    w, x, y, z = (quat[:, i] for i in range(4))
    turn = jnp.stack([
        jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
        jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
        jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
    ], 1)  # fmt: skip
    whole = (turn[:, :, None] * inertia[:, None, None] * turn[:, None]).sum(3)  # einsum would round to TF32 on a GPU
    return jnp.stack([whole[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], 1)
