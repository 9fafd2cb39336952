"""Assemblies: each is put together on an arm, each fault changes what it should, and success means what it says."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx import engines
from sim_mjx.assemblies import ASSEMBLIES
from sim_mjx.assemblies.assembly import Assembly, Phase, Variation
from sim_mjx.assemblies.draw import uniform
from sim_mjx.assemblies.fields import FieldWriter, ball, box, touch
from sim_mjx.assemblies.latch import HOOK
from sim_mjx.assemblies.pressing import APPROACH, at_bottom, draw_task, press
from sim_mjx.assemblies.scene import home
from sim_mjx.assemblies.scene import scene as scene_of
from sim_mjx.assembly.hook import mating_force
from sim_mjx.assembly.parts import from_lips
from sim_mjx.assembly.rollout import Rollouts, as_float32, stack
from sim_mjx.engines import device
from sim_mjx.engines.native import model_of
from sim_mjx.registry import Scenario, get_scenario, pair
from sim_mjx.robots import ROBOTS, Robot
from sim_mjx.validation.engine_parity import FORCE_LIMIT, MOMENT_LIMIT
from tests.support.trees import assert_trees_equal

NOMINAL = 3
ON = {"peg-in-hole": "panda", "clip": "ur5e", "plug": "hiro"}  # each assembly once, each robot once
CERTAIN = {"moved-part", "early-stop", "tight", "blocked", "broken-hook", "stiff-hook", "chip"}  # never succeed
# What a fault may change, and nothing else.
CHANGES = {
    "moved-part": {".parts.mount.position"}, "early-stop": {".timeout"}, "tight": {".parts.own.clearance"},
    "rough": {".parts.mount.friction"}, "askew": {".parts.grip"}, "blocked": {".parts.own.floor"},
    "broken-hook": {".parts.own.overlap"}, "worn-hook": {".parts.own.overlap"},
    "stiff-hook": {".parts.own.stiffness"}, "chip": {".parts.own.seat"},
}  # fmt: skip


@dataclass(frozen=True)
class Run:
    """Some nominal trials and one of each fault."""

    scenario: Scenario
    kinds: list[str]
    params: Any
    out: Rollouts


def scenario_of(assembly: str) -> Scenario:
    return get_scenario(f"{assembly}@{ON.get(assembly, 'panda')}")


def drawn(scenario: Scenario, fault: str, index: int = 0) -> Any:
    """A trial with a fault, or "none"; all numbers that the fault does not change are those of the nominal trial."""
    kinds = tuple(ASSEMBLIES[scenario.assembly].faults)
    if fault == "none":
        return scenario.draw(7, index, scenario.spec(nominal_share=1.0))[0]
    params, found = scenario.draw(7, index, scenario.spec(nominal_share=0.0, faults=(fault,)))
    assert found.kind == fault
    assert set(kinds) <= set(CHANGES)
    return params


@pytest.fixture(scope="module", params=list(ON))
def run(request: pytest.FixtureRequest) -> Run:
    """Some nominal trials and one of each fault."""
    scenario = scenario_of(request.param)
    kinds = [*["none"] * NOMINAL, *ASSEMBLIES[request.param].faults]
    params = stack([drawn(scenario, kind, index) for index, kind in enumerate(kinds)])
    params = replace(params, timeout=np.minimum(params.timeout, 6.0))
    return Run(scenario, kinds, params, engines.simulate(scenario.scene(), params))


def test_it_is_put_together_and_faults_matter(run: Run) -> None:
    scenario, kinds, out = run.scenario, run.kinds, run.out
    seated = out.seated.all(1)
    assert seated[:NOMINAL].all()
    assert not any(seat for seat, kind in zip(seated, kinds, strict=True) if kind in CERTAIN)
    assert not out.diverged.any()
    onset = out.onset[:NOMINAL]
    assert onset.shape == (NOMINAL, len(scenario.states))
    assert np.isfinite(onset).all()
    assert (onset[:, 0] == 0).all()
    assert (np.diff(onset, axis=1) > 0).all()
    assert (onset[:, -1] < out.length[:NOMINAL] * 0.005).all()
    # something is felt, and nothing breaks: the hand presses with at most 25 N and gives way
    peaks = np.abs(out.wrench[:NOMINAL, :, 2]).max(1)
    assert ((peaks > 10) & (peaks < 40)).all()
    stopped = kinds.index("early-stop")
    assert out.length[stopped] * 0.005 < 2.6
    if scenario.assembly == "clip":
        check_mating_force(run)


def check_mating_force(run: Run) -> None:
    """The force at which the hook snaps is that of the design guides; the wrist feels it, filtered and with noise."""
    own, mount = run.params.parts.own, run.params.parts.mount
    for row in range(NOMINAL):
        start, stop = (int(run.out.onset[row, phase] / 0.005) for phase in (1, 2))
        force = run.out.wrench[row, start:stop, 2]
        top = np.maximum.accumulate(force)
        snap = int(np.argmax((force < 0.5 * top) & (top > 2.0)))
        numbers = {"stiffness": own.stiffness[row], "overlap": own.overlap[row], "friction": mount.friction[row]}
        hook = replace(HOOK, **{name: float(value) for name, value in numbers.items()})
        assert top[snap] == pytest.approx(mating_force(hook), rel=0.15)


@pytest.mark.parametrize(("assembly", "fault"), [(a.name, f) for a in ASSEMBLIES.values() for f in a.faults])
def test_a_fault_changes_what_it_should(assembly: str, fault: str) -> None:
    scenario = scenario_of(assembly)
    nominal, faulty = (jax.tree_util.tree_flatten_with_path(drawn(scenario, kind))[0] for kind in ("none", fault))
    changed = {
        jax.tree_util.keystr(path)
        for (path, before), (_, after) in zip(nominal, faulty, strict=True)
        if not np.array_equal(before, after)
    }
    assert changed == CHANGES[fault]


@pytest.mark.parametrize("assembly", list(ON))
def test_a_part_that_is_pulled_away_is_no_success(assembly: str) -> None:
    """The predicate on the scene's own geometry, the male part put where it belongs and then elsewhere."""
    scenario = scenario_of(assembly)
    scene, part = scenario.scene(), ASSEMBLIES[assembly]
    params = drawn(scenario, "none")
    model = model_of(scene, params.parts)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lips, turns = data.geom_xpos[scene.lips], data.geom_xmat[scene.lips].reshape(-1, 3, 3)
    inside = {"peg-in-hole": [0.0, 0.0, -15.5e-3], "clip": [-0.1e-3, 0.0, -1e-3], "plug": [-0.1e-3, 0.0, -1e-3]}

    def seated(shift: tuple[float, float, float]) -> bool:
        tips = lips + np.array(inside[assembly]) + np.array(shift)
        return bool(np.asarray(scene.seated(from_lips(tips, lips, turns))).all())  # type: ignore[misc]

    assert seated((0.0, 0.0, 0.0))
    assert not seated((0.0, 0.0, 3e-3))
    assert not seated((-4e-3, 0.0, 0.0))
    assert part.marks


def test_a_range_of_one_lag_changes_nothing_but_the_lag() -> None:
    scenario = get_scenario("clip@panda")
    usual, late = (scenario.draw_batch(0, range(8), scenario.spec(lag=lag)) for lag in ((1, 3), (4, 4)))
    assert set(usual[0].command_delay.tolist()) == {1, 2, 3}
    assert set(late[0].command_delay.tolist()) == {4}
    assert_trees_equal(usual[0], replace(late[0], command_delay=usual[0].command_delay))
    assert [fault.kind for fault in usual[1]] == [fault.kind for fault in late[1]]


def test_trials_do_not_depend_on_their_batch() -> None:
    scenario = scenario_of("peg-in-hole")
    spec = scenario.spec(nominal_share=0.3)
    batch, faults = scenario.draw_batch(3, [4, 9, 2], spec)
    for row, index in enumerate([4, 9, 2]):
        single, fault = scenario.draw(3, index, spec)
        assert fault.kind == faults[row].kind
        for whole, one in zip(jax.tree.leaves(batch), jax.tree.leaves(single), strict=True):
            np.testing.assert_array_equal(whole[row], one)
    kinds = {scenario.draw(3, index, spec)[1].kind for index in range(60)}
    assert kinds == {"none", *ASSEMBLIES["peg-in-hole"].faults}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Height:
    """Of the box that is poked."""

    height: Any  # m


def poke() -> Assembly:
    """A ball that pokes a box: the least that goes through every part of an engine, because MJX compiles for long."""

    def male(_: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        ball(body, "BALL", (0.0, 0.0, 5e-3), 5e-3)

    def female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        box(body, "BOX", (0.0, 0.0, -0.01), (0.02, 0.02, 0.01))
        touch(spec, "BALL", "BOX")

    def write(writer: FieldWriter, own: Height) -> None:
        writer.place("BOX", np.stack([0 * own.height, 0 * own.height, own.height - 0.01], -1))

    def draw(spec: Variation, rng: np.random.Generator) -> tuple[Any, Height]:
        return draw_task(spec, rng, press=10.0, bottom=1e-2, approach_speed=0.02), Height(uniform(rng, (-1e-3, 1e-3)))

    return Assembly(
        "poke", male, female, write, (APPROACH, Phase("press", press, at_bottom)), draw, (("BALL", "BOX"),),
        lambda local: local[..., 2] < 16e-3, {}, timeout=0.7, start=5e-3,
    )  # fmt: skip


def test_mjx_gives_the_wrench_of_native() -> None:
    scenario = pair(poke(), ROBOTS["ur5e"])
    params, faults = scenario.draw_batch(0, range(3), scenario.spec())
    assert [fault.kind for fault in faults] == ["none"] * 3  # there are none to draw
    scene = scenario.scene()
    native = engines.simulate(scene, params)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        mjx = engines.simulate(scene, params, "mjx")
    np.testing.assert_array_equal(native.seated, np.ones((3, 1), bool))
    np.testing.assert_array_equal(mjx.seated, native.seated)
    np.testing.assert_allclose(mjx.length, native.length, atol=2)
    np.testing.assert_allclose(mjx.onset, native.onset, atol=0.011)
    touch_at = int(np.nanmin(native.onset[:, 1]) / 0.005) - 10  # before any ball touches
    gap = np.abs(mjx.wrench - native.wrench)[:, :touch_at]
    assert touch_at > 20
    assert gap[..., :3].max() <= FORCE_LIMIT
    assert gap[..., 3:].max() <= MOMENT_LIMIT
    peaks = np.abs(native.wrench[..., 2]).max(1)
    assert (peaks > 6.0).all()
    np.testing.assert_allclose(np.abs(mjx.wrench[..., 2]).max(1), peaks, rtol=0.1)


def test_a_device_begins_where_native_does() -> None:
    """Its angles count from home: cords over the arm and parts that move have the same places and forces."""

    def female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        poke().female(spec, body)
        cube = spec.worldbody.add_body(name="CUBE", pos=(0.7, 0.3, 0.08), quat=(0.6, 0.8, 0.0, 0.0))
        cube.add_freejoint()
        cube.add_geom(size=(0.01, 0.0, 0.0), contype=0, conaffinity=0)
        bolt = body.add_body(name="BOLT", pos=(0.05, 0.0, 0.0))
        bolt.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1.0, 0.0, 0.0), ref=0.02, stiffness=[9.0, 0.0, 0.0])
        bolt.add_geom(size=(0.01, 0.0, 0.0), contype=0, conaffinity=0)
        # rests elsewhere than at home
        cord = spec.add_tendon(name="CORD", stiffness=[3.0, 0.0, 0.0], springlength=(0.1, 0.1), range=(-9.0, -1.0))
        cord.wrap_joint("JOINT4", 1.5)
        cord.wrap_joint("JOINT6", -0.5)

    scenario = pair(Assembly(**{**vars(poke()), "female": female}), ROBOTS["panda"])
    params, _ = scenario.draw_batch(0, range(1), scenario.spec())
    scene, home = scenario.scene(), np.asarray(params.home[0])
    fields = device.fields_of(scene, params)
    on_device = {name: jnp.asarray(field) for name, field in fields.items()}
    model, empty = device.put_scene(scene, 1, "jax")
    fixed = device.Fixed(model, on_device, as_float32(params), empty)
    begun = device.start(device.layout_of(scene), fixed).body.qpos[0]

    here = model_of(scene, jax.tree.map(lambda leaf: leaf[0], params.parts))
    native, there = mujoco.MjData(here), copy.copy(here)
    native.qpos[scene.joints] = home
    for name, field in fields.items():
        getattr(there, name)[:] = field[0]
    data = mujoco.MjData(there)
    data.qpos[:] = begun
    mujoco.mj_forward(here, native)
    mujoco.mj_forward(there, data)
    np.testing.assert_allclose(data.xpos, native.xpos, atol=1e-6)
    np.testing.assert_allclose(data.xmat, native.xmat, atol=1e-6)
    assert np.abs(native.qfrc_spring).max() > 1.0
    np.testing.assert_allclose(data.qfrc_spring, native.qfrc_spring, atol=1e-4)
    np.testing.assert_allclose(
        data.ten_length - there.tendon_range[:, 0], native.ten_length - here.tendon_range[:, 0], atol=1e-6
    )


def test_room_on_a_device_is_kept_for_all_that_can_act() -> None:
    """Warp leaves out, without a word, what there is no room for."""

    def female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        poke().female(spec, body)
        for index, place in enumerate([(0.7, 0.3, 0.05), (0.7, 0.3, 0.0699)]):
            cube = spec.worldbody.add_body(name=f"CUBE{index}", pos=place)
            cube.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.01, 0.01, 0.01))
            cube.add_joint(name=f"SLIDE{index}", type=mujoco.mjtJoint.mjJNT_SLIDE, frictionloss=0.1)
        spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, name1="CUBE0", name2="MOUNT", objtype=mujoco.mjtObj.mjOBJ_BODY)

    plain, scene = (
        pair(assembly, ROBOTS["panda"]).scene() for assembly in (poke(), Assembly(**{**vars(poke()), "female": female}))
    )
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    assert data.ncon == 4  # of the cubes, which no pair names
    assert device.most_contacts(plain.model)[0] == 1
    contacts, rows = device.most_contacts(scene.model)
    assert contacts >= data.ncon + 1  # the ball is not on its box yet
    assert rows >= data.nefc + 3
    assert data.nefc > device.most_contacts(plain.model)[1]


@dataclass(frozen=True)
class Unbounded(Variation):
    extra: tuple[float, float] = (np.nan, np.nan)


def half_turned() -> mujoco.MjSpec:
    """A Panda whose wrist's x axis shows backward at home."""
    spec = ROBOTS["panda"].build()
    site = spec.site("WRIST")
    mujoco.mju_mulQuat(site.quat, site.quat.copy(), np.array([0.0, 0.0, 0.0, 1.0]))
    return spec


def lever() -> mujoco.MjSpec:
    """One upright hinge, and a wrist that points up on its axis."""
    return mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body><joint name="turn" axis="0 0 1"/><geom size="0.1"/><site name="WRIST"/></body>'
        "</worldbody></mujoco>"
    )


def test_what_cannot_be_drawn_is_refused() -> None:
    scenario = scenario_of("clip")
    for values, sentence in (
        ({"nominal_share": 2.0}, "nominal share is 2.0"),
        ({"faults": ("jam",)}, "clip has no fault 'jam'; it has moved-part"),
        ({"longest": -1.0}, "longest trial is -1.0 s"),
        ({"lag": (3, 20)}, "lag is"),
        ({"worn": (2e-3, 1e-3)}, "range of worn"),
    ):
        with pytest.raises(InputError, match=sentence):
            scenario.draw(0, 0, scenario.spec(**values))
    with pytest.raises(InputError, match=r"no assembly 'bolt'; expected one of peg-in-hole"):
        get_scenario("bolt@panda")
    with pytest.raises(InputError, match="camera-snap cannot use the robot 'panda'; expected 'hiro'"):
        get_scenario("camera-snap@panda")
    assert get_scenario("camera-snap@hiro").preset.name == "hooked-B"
    far = Robot("far", ROBOTS["panda"].build, "WRIST", ROBOTS["panda"].home, (2.0, 0.0, 0.1))
    with pytest.raises(InputError, match=r"far does not reach the start of clip, .*: it stays [\d.e+]+ mm and"):
        home(ASSEMBLIES["clip"], far)
    with pytest.raises(InputError, match=r"lever does not reach the start of clip"):  # from where no joint helps
        home(ASSEMBLIES["clip"], Robot("lever", lever, "WRIST", (0.0,), (0.1, 0.0, 0.1)))
    backward = Robot("backward", half_turned, "WRIST", ROBOTS["panda"].home, ROBOTS["panda"].place)
    with pytest.raises(InputError, match=r"JOINT\d would be at [-\d.]+ rad, beyond its limits of"):
        home(ASSEMBLIES["clip"], backward)
    unmarked = Assembly(**{**vars(ASSEMBLIES["clip"]), "marks": ()})
    with pytest.raises(InputError, match="clip has no marks, by whose places success is decided"):
        pair(unmarked, ROBOTS["panda"])
    undrawable = Assembly(**{**vars(ASSEMBLIES["clip"]), "variation": Unbounded})
    with pytest.raises(InputError, match="range of extra is nan to nan"):
        pair(undrawable, ROBOTS["panda"])
    nowhere = Assembly(**{**vars(ASSEMBLIES["clip"]), "marks": (("TIP", "HOLE"),)})
    with pytest.raises(InputError, match="no geom 'TIP'"):
        scene_of(nowhere, ROBOTS["panda"])
