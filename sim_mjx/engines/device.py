"""MJX, with JAX's or Warp's kernels, or our own: whole rollouts on the device, without a transfer every period.

One compiled program does a stretch of control periods: sensor, state machine, controller and physics. Between two
stretches a lane whose trial has ended takes the next one (:mod:`sim_mjx.engines.lanes`). The physics counts joint
angles from each trial's home pose: a servo is as stiff as a spring on the last digit of its angle, which single
precision resolves best near zero.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.parts import from_lips
from sim_mjx.assembly.rollout import ONE_ARM, Program, Rollouts, batch_size
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines.common import SETTLING, collect, forward_only, select_lanes, single
from sim_mjx.engines.quiet import mjx

LANES = 16
STRETCH = 100  # control periods that run without asking which trials have ended
# Most iterations of the solver and of its line search, which MJX goes through to the last one. Single precision
# converges no further: the wrenches of 64 trials differ as little from those of 30/20 as those of 10/6 do.
SOLVER = (6, 4)
TOLERANCE = 1e-6  # of the solver, likewise
SEVERAL = 8  # contacts of two geoms at most, neither of which is a sphere
EQUALITY_ROWS = {mujoco.mjtEq.mjEQ_CONNECT: 3, mujoco.mjtEq.mjEQ_WELD: 6}  # of constraints; the others have one


@dataclass(frozen=True)
class Layout:
    """What a compiled program needs of its scene; hashable."""

    program: Program
    joints: tuple[int, ...]
    readings: tuple[int, ...]  # [6K] addresses in sensordata
    tips: tuple[int, ...]  # geoms
    lips: tuple[int, ...]
    substeps: int
    seated: Callable[[Array], Array]  # see ``Scene``


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Fixed:
    """Constants of the trials; leaves have a leading lane axis."""

    model: Any  # ``mjx.Model``, or the ``Structure`` of the fused kernel
    fields: dict[str, Array]  # of the model, [trial, ...]
    params: Any  # of the scene's program, [trial, ...]
    empty: Any  # ``mjx.Data`` or ``Body`` of one trial


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Body:
    """State of the physics between steps [trial, ...]; names as in ``mjx.Data``.

    Warp's kernels write into the buffers of a whole ``mjx.Data``, which then takes the place of this.
    """

    qpos: Array
    qvel: Array
    qacc_warmstart: Array  # the solver's first guess
    sensordata: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """State of all lanes between control periods."""

    body: Any
    loop: Any  # of the scene's program
    tick: Int[Array, " lane"]  # control periods since time zero; negative while settling


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Log:
    """What is logged each control period: a ``LogRow``, and which tabs are past their lips."""

    wrench: Float[Array, "*batch reading"]
    joints: Float[Array, "*batch joint"]
    phase: Int[Array, "*batch"]
    past: Bool[Array, "*batch tab"]  # tabs past their lips


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Outcome:
    """A batch of trials that all have ended, on the device; values after a trial's end are undefined."""

    wrench: Float[Array, "trial time reading"]  # N and Nm, world frame
    joints: Float[Array, "trial time joint"]  # rad
    phase: Int[Array, "trial time"]  # numbered as the program does
    past: Bool[Array, "trial time tab"]  # tabs past their lips, also in the period in which the trial had ended
    program: Program = field(default=ONE_ARM, metadata={"static": True})  # that logged

    @property
    def length(self) -> Int[Array, " trial"]:
        """Control periods until each trial ended."""
        return (self.phase < self.program.ended).sum(1, dtype=jnp.int32)

    @property
    def seated(self) -> Bool[Array, "trial tab"]:
        """Tabs past their lips at the end."""
        last = jnp.minimum(self.length, self.phase.shape[1] - 1)
        return jnp.take_along_axis(self.past, last[:, None, None], axis=1)[:, 0]


def simulate(scene: Scene, params: Any, impl: str, *, progress: Callable[[int], None] | None = None) -> Rollouts:
    """As :func:`sim_mjx.engines.simulate`, in single precision on JAX's default device; ``impl``: see ``Lanes``."""
    return to_host(run(scene, params, impl, progress=progress))


def to_host(out: Outcome) -> Rollouts:
    """Copy the results of the trials to the host and cut them where the trials ended."""
    wrench, joints, phase, past = jax.device_get((out.wrench, out.joints, out.phase, out.past))
    return collect(wrench, joints, phase, past, out.program)


def run(scene: Scene, params: Any, impl: str, *, progress: Callable[[int], None] | None = None) -> Outcome:
    """Like :func:`simulate`, but the results stay on the device."""
    from sim_mjx.engines.lanes import Lanes  # which imports this module

    count = batch_size(params)
    ((_, out, _),) = Lanes(scene, impl, count, at_once=count, spare=0).run([(0, params)], progress=progress)
    return out


def layout_of(scene: Scene) -> Layout:
    readings = (scene.forces[:, None] + np.arange(6)).ravel()
    joints, seen, tips, lips = (
        tuple(int(i) for i in column) for column in (scene.joints, readings, scene.tips, scene.lips)
    )
    return Layout(scene.program, joints, seen, tips, lips, scene.substeps, scene.seated)


@single
def put_scene(scene: Scene, count: int, impl: str) -> tuple[Any, Any]:
    """The scene's model on the device, and data of one trial; Warp's kernels step at most ``count`` at once.

    Raises:
        InputError: the scene has something that the engine does not simulate.
    """
    if impl == "fused":
        return _put_fused(scene)
    sizes = {}
    if impl == "warp":
        contacts, rows = most_contacts(scene.model)
        sizes = {"naconmax": count * contacts, "njmax": rows}
    compiled = copy.copy(scene.model)
    compiled.opt.tolerance = max(compiled.opt.tolerance, TOLERANCE)
    compiled.opt.iterations = min(compiled.opt.iterations, SOLVER[0])
    compiled.opt.ls_iterations = min(compiled.opt.ls_iterations, SOLVER[1])
    try:
        model, empty = mjx.put_model(compiled, impl=impl), mjx.make_data(compiled, impl=impl, **sizes)
    except NotImplementedError as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(f"MJX cannot simulate this scene: {reason}; choose the engine native.") from error
    if impl == "warp":  # its kernels would print whenever a line search ends at its limit
        model = model.tree_replace({"opt._impl.warn_overflow": 0})
    return model, empty


def _put_fused(scene: Scene) -> tuple[Any, Body]:
    from sim_mjx.engines.fused import prepare

    if what := prepare.missing(scene.model):
        raise InputError(f"The engine fused does not simulate {what}; choose the engine warp or native.")
    model = scene.model
    zeros = [jnp.zeros(size, jnp.float32) for size in (model.nq, model.nv, model.nv, model.nsensordata)]
    return prepare.structure(scene), Body(*zeros)


def fields_of(scene: Scene, params: Any, dtype: type[np.floating] = np.float32) -> dict[str, NDArray[np.floating]]:
    """Model fields of all trials, each [trial, ...]."""
    fields = scene.fields(params.parts) | _from_home(scene, np.asarray(scene.program.home(params)))
    return {name: value.astype(dtype) for name, value in fields.items()}


def _from_home(scene: Scene, home: NDArray[np.floating]) -> dict[str, NDArray[np.float64]]:
    """Fields that let the joints' angles be zero at home [trial, J]."""
    model = scene.model
    zero, limits = (np.repeat(field[None], len(home), axis=0) for field in (model.qpos0, model.jnt_range))
    zero[:, scene.joints] -= home
    limits[:, scene.hinges] -= home[..., None]
    fields = {"qpos0": zero, "jnt_range": limits}
    if (lengths := home @ _pulled(scene).T).any():
        for name in ("tendon_lengthspring", "tendon_range"):
            fields[name] = getattr(model, name)[None] - lengths[..., None]
        fields["tendon_length0"] = model.tendon_length0[None] - lengths
    return fields


def _pulled(scene: Scene) -> NDArray[np.float64]:
    """By how much each tendon grows with each of the robot's angles [tendon, J]; only fixed ones count angles."""
    model, out = scene.model, np.zeros((scene.model.ntendon, len(scene.joints)))
    for tendon, (first, count) in enumerate(zip(model.tendon_adr, model.tendon_num, strict=True)):
        for wrap in range(first, first + count):
            if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                out[tendon] += np.where(scene.hinges == model.wrap_objid[wrap], model.wrap_prm[wrap], 0.0)
    return out


def most_contacts(model: mujoco.MjModel) -> tuple[int, int]:
    """Largest numbers of contacts and of constraint rows of a trial: all that may touch does, all limits are reached.

    >>> most_contacts(mujoco.MjModel.from_xml_string("<mujoco/>"))
    (0, 0)
    """
    pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    touching = [*zip(pairs, model.pair_dim.tolist(), strict=True), *_other_pairs(model)]
    elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    contacts = rows = 0
    for pair, dim in touching:
        several = 1 if (model.geom_type[list(pair)] == mujoco.mjtGeom.mjGEOM_SPHERE).any() else SEVERAL
        contacts += several
        rows += several * (dim if elliptic else max(2 * (dim - 1), 1))
    rows += int(model.jnt_limited.sum() + model.tendon_limited.sum())
    rows += int((model.dof_frictionloss > 0).sum() + (model.tendon_frictionloss > 0).sum())
    return contacts, rows + sum(EQUALITY_ROWS.get(mujoco.mjtEq(kind), 1) for kind in model.eq_type)


def _other_pairs(model: mujoco.MjModel) -> list[tuple[tuple[int, int], int]]:
    """Geoms of different bodies that touch by their types, without a pair, and the dimensions of their contacts."""
    may = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    types, affinities, bodies = model.geom_contype, model.geom_conaffinity, model.body_weldid[model.geom_bodyid]
    return [
        ((first, second), int(model.geom_condim[[first, second]].max()))
        for first, second in combinations(may.tolist(), 2)
        if bodies[first] != bodies[second] and (types[first] & affinities[second] or types[second] & affinities[first])
    ]


def start(layout: Layout, fixed: Fixed) -> State:
    """The initial state: home pose, where all angles are zero, not yet settled."""
    count = batch_size(fixed.params)
    # what else can move, such as a free part, begins where the model has it
    places = fixed.fields["qpos0"].at[:, jnp.array(layout.joints)].set(0.0)
    body: Any = jax.vmap(lambda qpos: dataclasses.replace(fixed.empty, qpos=qpos))(places)
    if isinstance(fixed.model, mjx.Model) and fixed.model.impl == mjx.Impl.JAX:
        body = body_of(body)
    tick = jnp.full(count, -(-SETTLING // layout.substeps), jnp.int32)
    return State(body, _begin(layout, fixed, body), -tick)


def _begin(layout: Layout, fixed: Fixed, body: Any) -> Any:
    return jax.vmap(layout.program.begin)(fixed.params, _raw(layout, body))


def stretch(layout: Layout, fixed: Fixed, state: State) -> tuple[State, Log]:
    """``STRETCH`` control periods; the log has a leading time axis.

    Settling runs in the same program, in which the controller begins anew each period until time zero: the physics
    takes a minute to compile, and this way it is compiled once.
    """
    home, advance = layout.program.home(fixed.params), _advance(layout, fixed)

    def period(state: State, _: None) -> tuple[State, Log]:
        body, settling = state.body, state.tick < 0
        loop = select_lanes(state.tick > 0, state.loop, _begin(layout, fixed, body))
        joints = home + body.qpos[:, jnp.array(layout.joints)]
        loop, ends, log = jax.vmap(layout.program.control)(fixed.params, loop, joints, _raw(layout, body))
        before, after = (jnp.where(settling[:, None], 0.0, ends[:, i] - home) for i in (0, 1))

        still = (log.phase == layout.program.ended) & ~settling
        moved, past = advance(body, before, after, still)
        return State(moved, loop, state.tick + 1), Log(log.wrench, log.joints, log.phase, past)

    return jax.lax.scan(period, state, length=STRETCH)


def _advance(layout: Layout, fixed: Fixed) -> Callable[..., tuple[Any, Array]]:
    """What moves the bodies over a control period, between two controls, but those of trials that keep still."""
    if not isinstance(fixed.model, mjx.Model):
        return _fused(layout, fixed)

    def advance(body: Any, before: Array, after: Array, still: Array) -> tuple[Any, Array]:
        moved, past = _substeps(layout, fixed, body, lambda share: before + share * (after - before))
        return kept(body, moved, still), past

    return advance


def _fused(layout: Layout, fixed: Fixed) -> Callable[..., tuple[Any, Array]]:
    from sim_mjx.engines.fused import prepare, step  # which imports Warp

    numbers = prepare.numbers_of(fixed.model, fixed.fields)

    def advance(body: Body, before: Array, after: Array, still: Array) -> tuple[Body, Array]:
        state = (body.qpos, body.qvel, body.qacc_warmstart, body.sensordata)
        *moved, places = step.advance(fixed.model, numbers, layout.substeps, state, before, after, still)
        return Body(*moved), jax.vmap(layout.seated)(places)

    return advance


def _substeps(layout: Layout, fixed: Fixed, body: Any, ctrl: Callable[[Array], Array]) -> tuple[Any, Array]:
    """The bodies after a control period, sensors read in its last step, and tabs past their lips at its beginning."""
    shares = jnp.arange(1, layout.substeps + 1, dtype=jnp.float32) / layout.substeps
    if fixed.model.impl == mjx.Impl.JAX:  # a second kind of step would take another minute to compile
        moved, past = jax.lax.scan(lambda at, share: _step(layout, fixed, at, ctrl(share)), body, shares)
        return moved, past[0]
    flags = fixed.model.opt.disableflags | mjx.DisableBit.SENSOR
    blind = dataclasses.replace(fixed, model=fixed.model.tree_replace({"opt.disableflags": flags}))
    past = []
    for step, share in enumerate(shares, 1):  # quick to compile, and a loop would copy the buffers of Warp's kernels
        body, then = _step(layout, fixed if step == layout.substeps else blind, body, ctrl(share))
        past.append(then)
    return body, past[0]


def _step(layout: Layout, fixed: Fixed, body: Any, wanted: Array) -> tuple[Any, Array]:
    """One physics step of all trials, and which tabs were past their lips before it."""

    def one(fields: dict[str, Array], at: Any, ctrl: Array) -> tuple[Any, Array]:
        data = step_trial(fixed.model, fixed.empty, fields, at, ctrl)
        return data if isinstance(at, mjx.Data) else body_of(data), seated_tabs(layout, data)

    return jax.vmap(one)(fixed.fields, body, wanted)


def step_trial(model: mjx.Model, empty: mjx.Data, fields: dict[str, Array], at: Any, ctrl: Array) -> mjx.Data:
    """One physics step of one trial, from a :class:`Body` or data; places are those before the step.

    Raises:
        InputError: it is differentiated in reverse mode, which MJX's solver does not have.
    """
    model = model.tree_replace(fields)
    if not isinstance(at, mjx.Data):
        at = empty.replace(qpos=at.qpos, qvel=at.qvel, qacc_warmstart=at.qacc_warmstart)
    data = mjx.step(model, at.replace(ctrl=ctrl))
    return forward_only(data) if model.impl == mjx.Impl.JAX else data  # Warp has none, and its buffers stay as they are


def body_of(data: mjx.Data) -> Body:
    """The part of the data that the next step needs."""
    return Body(data.qpos, data.qvel, data.qacc_warmstart, data.sensordata)


def kept(old: Any, new: Any, still: Array) -> Any:
    """The new bodies, or the old ones of trials that keep still, by ``still`` [trial]."""
    names = [field.name for field in dataclasses.fields(Body)]
    chosen = {name: jnp.where(still[:, None], getattr(old, name), getattr(new, name)) for name in names}
    return dataclasses.replace(new, **chosen)


def _raw(layout: Layout, body: Any) -> Array:
    """What the parts exert on the hands [trial, 6K]: the sensors report the opposite."""
    return -body.sensordata[:, jnp.array(layout.readings)]


def seated_tabs(layout: Layout, data: mjx.Data) -> Array:
    """Which tabs of one trial are past their lips, by the places in ``data``."""
    tips, lips = jnp.array(layout.tips), jnp.array(layout.lips)
    return layout.seated(from_lips(data.geom_xpos[tips], data.geom_xpos[lips], data.geom_xmat[lips]))
