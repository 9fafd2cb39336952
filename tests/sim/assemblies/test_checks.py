"""Mistakes in assemblies and robots of one's own: each is one sentence before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.assemblies import ASSEMBLIES, Phase, Variation
from sim_mjx.assemblies.assembly import Assembly
from sim_mjx.assemblies.draw import check, with_own
from sim_mjx.assemblies.fields import FieldWriter, ball, box, touch
from sim_mjx.assemblies.pressing import APPROACH, at_bottom, press
from sim_mjx.assemblies.scene import scene
from sim_mjx.engines.device import put_scene
from sim_mjx.engines.native import model_of
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import pair
from sim_mjx.robots import ROBOTS, Robot

CLIP, PANDA = ASSEMBLIES["clip"], ROBOTS["panda"]


def altered(thing: Any, **values: Any) -> Any:
    """A copy with values of any type, which the annotations of the tests' run refuse."""
    new = copy(thing)
    for name, value in values.items():
        object.__setattr__(new, name, value)
    return new


def changed(**values: Any) -> Assembly:
    return altered(CLIP, **values)


def with_phase(move: Callable[..., Any] = press, leave: Callable[..., Any] = at_bottom) -> dict[str, Any]:
    return {"phases": (APPROACH, Phase("press", move, leave))}


@dataclass(frozen=True)
class Plain:  # JAX does not know it
    gap: float = 1.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Named:
    material: Any = "brass"


@dataclass(frozen=True)
class Unset(Variation):
    ends: Any = ()


@dataclass(frozen=True)
class Rough(Variation):
    friction: tuple[float, float] = (-1.0, -0.5)


def drawing(task: Any = None, own: Any = None) -> dict[str, Any]:
    def draw(spec: Any, rng: np.random.Generator) -> Any:
        first, second = CLIP.draw(spec, rng)
        return task or first, own or second

    return {"draw": draw}


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (with_phase(move=lambda sense, task: press(sense, task)[:3]), r"move of .*'press' of clip gives float32 \[3\]"),
        (with_phase(move=lambda sense, task: 0.0), r"move of .* gives float32 \[\]; expected a twist, float32 \[6\]"),
        (with_phase(move=lambda sense, task: None), "move of .* gives NoneType; expected a twist"),
        (
            with_phase(move=lambda sense, task: task.absent),
            "'press' of clip ends in AttributeError: 'PressTask'",
        ),
        (with_phase(leave=lambda sense, task: sense.time), r"leave of .* gives float32 \[\]; expected one bool"),
        (with_phase(leave=lambda sense, task: sense.force > 1), r"leave of .* gives bool \[3\]; expected one bool"),
        (with_phase(leave=lambda sense, task: bool(sense.time)), "leave of .* ends in TracerBoolConversionError: Att"),
        ({"seated": lambda local: (local[..., 2] < 0).all()}, r"seated of clip gives bool \[\] for places \[2, 1, 3\]"),
        ({"seated": lambda local: local[..., 2]}, r"seated of clip gives float64 \[2, 1\]"),
        ({"seated": lambda local: local[0][2] < 0}, "seated of clip ends in IndexError"),
        ({"faults": {"none": CLIP.faults["chip"]}}, "has a fault named 'none'"),
        ({"variation": Rough}, "range of friction begins at -1.0; expected zero or more"),
        ({"draw": lambda spec, rng: Plain()}, "draw of clip gives a Plain; expected two"),
        ({"draw": lambda spec, rng: spec.gaap}, "draw of clip ends in AttributeError: 'LatchVariation' object has no"),
        (drawing(own={"gap": 1.0}), "draw of clip gives a dict for the parts; expected a dataclass"),
        (drawing(task=Plain()), "Plain of clip is unknown to JAX; add @jax.tree_util.register_dataclass"),
        (drawing(own=Named()), "material of Named of clip is of type str; expected an array"),
        (drawing(own=Named(Named(1.0))), "material of Named of clip is of type Named; expected an array"),
        (drawing(own=Named(None)), "material of Named of clip is of type NoneType; expected an array"),
        ({"phases": None}, "phases of the assembly clip is None; expected a tuple of Phase"),
        ({"phases": ("approach",)}, r"phases of the assembly clip is \('approach',\); expected a tuple of Phase"),
        ({"faults": None}, "faults of the assembly clip is None; expected a dict of functions by name"),
        ({"faults": {3: CLIP.faults["chip"]}}, "faults of the assembly clip is .*; expected a dict of functions by"),
        ({"tabs": "LATCH"}, "tabs of the assembly clip is 'LATCH'; expected a tuple of names"),
        ({"marks": ("LATCH", "LIP")}, r"marks of the assembly clip is .*; expected a tuple of pairs of names"),
        ({"variation": dict}, "variation of the assembly clip is <class 'dict'>; expected a class derived from"),
        ({"name": None}, "name of the assembly None is None; expected a word"),
        ({"timeout": float("nan")}, "timeout of clip is nan s"),
        ({"timeout": "20"}, "timeout of clip is 20 s; expected a positive"),
        ({"start": float("nan")}, "start of clip is nan m; expected a finite number"),
        ({"reach": None}, "reach of clip is None m"),
        ({"substeps": 0}, "substeps of clip are 0"),
        ({"substeps": 2.5}, "substeps of clip are 2.5; expected a count"),
        ({"mount_stiffness": (-1e4, 1e4, 1e4)}, "mount_stiffness of clip is"),
        ({"mount_stiffness": (1e4, 1e4)}, r"mount_stiffness of clip is \(10000.0, 10000.0\); expected three numbers"),
        ({"mount_stiffness": 1e4}, "mount_stiffness of clip is 10000.0; expected three numbers"),
        (drawing(own=Named(np.asarray(np.nan))), "draw of clip sets material to nan; expected numbers"),
        ({"name": "camera-snap"}, "The name camera-snap is that of the recorded assembly"),
        ({"name": "a\nb"}, "names the assembly, a phase, a fault or a tab of 'a"),
    ],
)
def test_a_mistake_in_an_assembly_is_one_sentence(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as raised:
        pair(changed(**values), PANDA)
    assert "\n" not in str(raised.value)


def test_a_variation_may_hold_more_than_ranges() -> None:
    for ends in (("wood", "steel"), (1e-3,), (1e-3, 2e-3, 1e-3), {"a": 1}):
        pair(changed(draw=lambda spec, rng: CLIP.draw(CLIP.variation(), rng), variation=Unset), PANDA).draw(
            0, 0, Unset(ends=ends, nominal_share=1.0)
        )
    with pytest.raises(InputError, match="The range of ends is 2 to 1"):
        pair(changed(draw=lambda spec, rng: CLIP.draw(CLIP.variation(), rng), variation=Unset), PANDA).draw(
            0, 0, Unset(ends=[2, 1])
        )
    scenario = pair(CLIP, PANDA)
    with pytest.raises(InputError, match=r"stop_at begins at -1.0 s"):
        scenario.draw(0, 0, scenario.spec(stop_at=(-1.0, 1.0)))


def test_a_range_is_two_numbers_and_a_spec_that_of_its_assembly() -> None:
    scenario = pair(CLIP, PANDA)
    for values, sentence in (
        ({"friction": 0.3}, "The range of friction is 0.3; expected two numbers"),
        ({"friction": (0.1, 0.2, 0.3)}, r"The range of friction is \(0.1, 0.2, 0.3\); expected two numbers"),
        ({"worn": None}, "The range of worn is None; expected two numbers"),
        ({"noise": np.array([2.0, 1.0])}, "The range of noise is 2.0 to 1.0; expected two increasing numbers"),
        ({"lag": (1.5, 2.5)}, r"The lag is \(1.5, 2.5\); expected two increasing counts"),
        ({"lag": 2}, "The lag is 2; expected two increasing counts"),
        ({"longest": "3"}, "The longest trial is 3 s; expected a positive number"),
        ({"nominal_share": "1"}, "The nominal share is 1; expected 0 to 1"),
    ):
        with pytest.raises(InputError, match=sentence):
            check(altered(scenario.spec(), **values), CLIP)
    for spec, sentence in (
        (ASSEMBLIES["peg-in-hole"].variation(), "Distributions of clip are a LatchVariation; this PegVariation has no"),
        (DomainRandomization(), "Distributions of clip are a LatchVariation; this DomainRandomization has no nom"),
        ({"nominal_share": 1.0}, "Distributions of clip are a LatchVariation; this dict has no nominal_share"),
    ):
        with pytest.raises(InputError, match=sentence):
            check(spec, CLIP)
    with pytest.raises(InputError, match="There is no trial of clip to draw"):
        scenario.draw_batch(0, (), scenario.spec())


def with_sensor(**values: Any) -> Callable[..., Any]:
    """A fault of the wrist's sensor."""
    return lambda trial, spec, rng: replace(trial, sensor=replace(trial.sensor, **values))


def test_a_fault_that_fails_is_named() -> None:
    for fault, sentence in (
        (
            lambda trial, spec, rng: None,
            "the fault 'bad' of clip in trial 0 gives a NoneType; expected the changed trial",
        ),
        (lambda trial, spec, rng: replace(trial, gap=1), "the fault 'bad' of clip in trial 0 ends in TypeError"),
        (
            lambda trial, spec, rng: with_own(trial, material=np.zeros(2)),
            r"the shape of parts.own.material from \[\] to",
        ),
        (lambda trial, spec, rng: replace(trial, timeout=np.array(np.nan)), "sets a timeout of nan s"),
        (
            lambda trial, spec, rng: replace(trial, command_delay=np.array(40)),
            "sets a delay of 40 periods; expected a whole number, 0 to 10",
        ),
        (lambda trial, spec, rng: altered(trial, command_delay=np.array(1.5)), "sets a delay of .* periods"),
        (with_sensor(delay=np.array(12, np.int32)), "sets sensor.delay to 12; expected 0 to 11 control periods"),
        (with_sensor(offset=np.ones(6)), "does not always give sensor.offset; expected the same parameters in every"),
        (with_sensor(step=np.zeros(6)), "sets sensor.step to .*; expected more than zero"),
        (with_sensor(noise=-np.ones(6)), "sets sensor.noise to .*; expected zero or more"),
        (lambda trial, spec, rng: replace(trial, hand=trial.hand * np.nan), r"sets hand to \[nan"),
        (lambda trial, spec, rng: with_own(trial, material="brass"), "sets parts.own.material to brass; expected num"),
        (lambda trial, spec, rng: with_own(trial, material=None), "does not always give parts.own.material"),
    ):
        scenario = pair(changed(faults={"bad": fault}, **drawing(own=Named(np.asarray(1.0)))), PANDA)
        with pytest.raises(InputError, match=sentence):
            scenario.draw(0, 0, scenario.spec(nominal_share=0.0))


def test_parameters_have_one_shape_in_all_trials() -> None:
    def draw(spec: Any, rng: np.random.Generator) -> Any:
        task, _ = CLIP.draw(spec, rng)
        return task, Named(np.zeros(3 if rng.random() < 0.5 else 2))

    scenario = pair(changed(draw=draw), PANDA)
    for indices in (range(8), range(1, 9), [8, 3]):
        with pytest.raises(
            InputError, match=r"draw of clip in trial \d changes the shape of material from \[\d\] to \[\d\]"
        ):
            scenario.draw_batch(0, indices, scenario.spec(nominal_share=1.0))


def poked(write: Callable[[FieldWriter, Any], None], extra: Callable[[mujoco.MjSpec, Any], Any] | None = None) -> Any:
    """A clip with an upright box at the origin of its mount."""

    def female(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        CLIP.female(spec, body)
        box(body, "UPRIGHT", (0.0, 0.0, 0.0), (0.01, 0.01, 0.01))
        ball(body, "BALL", (0.03, 0.0, 0.0), 1e-3)
        touch(spec, "BALL", "UPRIGHT")
        if extra is not None:
            extra(spec, body)

    return changed(female=female, write=write)


def test_parameters_have_one_type_in_all_trials() -> None:
    def own(*numbers: Any, fault: Any = 0.5) -> Any:
        """Draws these numbers one after the other: for the check, then for the types and the trial of each draw."""
        left = iter(numbers)
        return pair(
            changed(
                draw=lambda spec, rng: (CLIP.draw(spec, rng)[0], Named(np.asarray(next(left)))),
                faults={"chip": lambda trial, spec, rng: with_own(trial, material=np.asarray(fault))},
            ),
            PANDA,
        )

    whole = own(0.5, 0.5, 2, 0.5, np.float32(1.5))
    for value in (2.0, 1.5):
        drawn = whole.draw(0, 0, whole.spec(nominal_share=1.0))[0].parts.own.material
        assert (drawn, drawn.dtype) == (value, np.float64)
    for fault, share in ((0, 0.0), (0, 1.0)):
        broken = own(0.5, 0.5, 0.5, fault=fault)
        assert broken.draw(0, 0, broken.spec(nominal_share=share))[0].parts.own.material.dtype == np.float64
    mixed, what = (
        own(0, 0, 0, fault=1e-3),
        r"changes the type of (parts\.own\.)?material from int64 to float64; expected",
    )
    with pytest.raises(
        InputError, match=f"the fault 'chip' of clip in trial 0 {what} one type in every trial, such as 0.0, not"
    ):
        mixed.draw(0, 0, mixed.spec(nominal_share=0.0))
    later = own(0, 0, 0.5)
    with pytest.raises(InputError, match=f"draw of clip in trial 0 {what}"):
        later.draw(0, 0, later.spec(nominal_share=1.0))


def test_a_whole_number_of_seconds_is_a_time_like_others() -> None:
    timed = pair(changed(timeout=12), PANDA)
    kinds = {timed.draw(0, 0, timed.spec(nominal_share=share))[0].timeout.dtype for share in (0.0, 1.0)}
    kinds |= {timed.draw(0, 0, timed.spec(nominal_share=0.0, faults=("early-stop",)))[0].timeout.dtype}
    assert kinds == {np.dtype(np.float64)}


def test_any_geom_can_be_turned_and_moved() -> None:
    """Also one that was compiled in its body's frame, whose own place and turn MuJoCo skips."""
    turn, place = np.array([0.8, 0.0, 0.6, 0.0]), np.array([1e-3, 2e-3, 3e-3])

    def write(writer: FieldWriter, own: Any) -> None:
        CLIP.write(writer, own)
        writer.turn("UPRIGHT", turn)
        writer.place("UPRIGHT", place)

    scenario = pair(poked(write), PANDA)
    params, _ = scenario.draw(0, 0, scenario.spec(nominal_share=1.0))
    model = model_of(scenario.scene(), params.parts)
    data, matrix = mujoco.MjData(model), np.zeros(9)
    mujoco.mj_kinematics(model, data)
    mount, geom = data.body("MOUNT"), data.geom("UPRIGHT")
    axes = mount.xmat.reshape(3, 3)
    mujoco.mju_quat2Mat(matrix, turn)
    np.testing.assert_allclose(geom.xpos, mount.xpos + axes @ place, atol=1e-12)
    np.testing.assert_allclose(geom.xmat.reshape(3, 3), axes @ matrix.reshape(3, 3), atol=1e-12)


def with_pebbles(write: Callable[[FieldWriter, Any], None]) -> mujoco.MjModel:
    """A trial's model with a floor and two pebbles far from all else, which touch by MuJoCo's rules."""

    def pebbles(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        body.add_geom(name="FLOOR", type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.1, 0.01), pos=(0.0, 2.0, 0.0), mass=0)
        loose = spec.worldbody.add_body(name="PEBBLES", pos=(0.0, 0.0, 5.0))
        loose.add_freejoint()
        for x in (0.0, 0.05):
            loose.add_geom(size=(0.01, 0.0, 0.0), pos=(x, 0.0, 0.0), mass=0.01)

    scenario = pair(poked(write, pebbles), PANDA)
    params, _ = scenario.draw(0, 0, scenario.spec(nominal_share=1.0, friction=(0.4, 0.4)))
    return model_of(scenario.scene(), params.parts)


def test_geoms_touch_where_a_trial_puts_them_and_with_its_friction() -> None:
    """By MuJoCo's rules, too, whose mid phase knows geoms where they were compiled."""
    model = with_pebbles(lambda writer, own: writer.place("FLOOR", np.array([0.0, 3.0, 0.0])))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    floor = data.geom("FLOOR").xpos
    data.joint(int(model.body("PEBBLES").jntadr[0])).qpos[:3] = floor + np.array([0.0, 0.0, 0.0195])
    mujoco.mj_forward(model, data)
    assert [contact.friction[0] for contact in data.contact] == [0.4, 0.4]


def test_a_free_body_is_not_placed() -> None:
    with pytest.raises(InputError, match="The free body 'PEBBLES' begins where it was compiled"):
        with_pebbles(lambda writer, own: writer.body("PEBBLES", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))


def test_what_a_scene_cannot_have_is_named() -> None:
    def absent(writer: FieldWriter, own: Any) -> None:
        writer.place("ABSENT", np.zeros(3))

    scenario = pair(poked(absent), PANDA)
    params, _ = scenario.draw(0, 0, scenario.spec())
    with pytest.raises(InputError, match="The scene has no geom 'ABSENT'"):
        scenario.scene().fields(params.parts)

    def endless(writer: FieldWriter, own: Any) -> None:
        writer.place("BALL", np.full(3, np.nan))

    with pytest.raises(InputError, match="write of clip gives a geom_pos that is not finite"):
        pair(poked(endless), PANDA).scene().fields(params.parts)

    def motor(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        spec.add_actuator(name="MOTOR", target="MOUNT_X", trntype=mujoco.mjtTrn.mjTRN_JOINT)

    def reading(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        spec.add_sensor(
            name="PLACE_0", type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=mujoco.mjtObj.mjOBJ_GEOM, objname="BALL"
        )

    for extra, sentence in (
        (motor, "clip adds the actuator 'MOTOR', which nothing commands"),
        (reading, "MuJoCo cannot compile clip on panda: repeated name 'PLACE_0'"),
        (lambda spec, body: body.absent(), "MuJoCo cannot compile clip on panda: .* has no attribute 'absent'"),
        (lambda spec, body: 1 / 0, "male or female of clip ends in ZeroDivisionError: division by zero"),
    ):
        with pytest.raises(InputError, match=sentence):
            scene(poked(CLIP.write, extra), PANDA)


def test_what_mjx_cannot_simulate_is_one_sentence() -> None:
    def can(spec: mujoco.MjSpec, body: Any) -> None:
        body.add_geom(name="CAN", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.01, 0.01, 0.0), contype=0, conaffinity=0)
        touch(spec, "CAN", "UPRIGHT")

    def smooth(spec: mujoco.MjSpec, body: Any) -> None:
        spec.pair("BALL:UPRIGHT").condim = 1

    for extra, reason in ((can, ".*CYLINDER.* collisions not implemented"), (smooth, "condim=1 with .*")):
        with pytest.raises(InputError, match=f"^MJX cannot simulate this scene: {reason}; choose the engine native.$"):
            put_scene(scene(poked(CLIP.write, extra), PANDA), 1, "jax")


def test_a_mistake_in_a_robot_is_one_sentence() -> None:
    def robot(**values: Any) -> Robot:
        new: Robot = altered(PANDA, **{"name": "mine", **values})
        new.__post_init__()
        return new

    for values, sentence in (
        ({"tool_mass": -1.0}, "tool_mass of the robot mine is -1.0 kg; expected zero"),
        ({"tool_mass": float("nan")}, "tool_mass of the robot mine is nan"),
        ({"home": (np.nan,) * 7}, "home of the robot mine is .*; expected finite numbers"),
        ({"home": None}, "home of the robot mine is None; expected finite numbers, one for each joint"),
        ({"place": (0.5, 0.0)}, r"place of the robot mine is \(0.5, 0.0\); expected three finite numbers"),
        ({"place": ("0.5", 0.0, 0.1)}, "place of the robot mine is .*; expected three finite numbers"),
        ({"tool_mass": "light"}, "tool_mass of the robot mine is light; expected a finite number"),
        ({"name": "a\nb"}, r"'a\\nb' names a robot; expected a word"),
        ({"home": (0.0, 1.0)}, "home has 2 angles; expected one per joint of the arm, 7"),
        ({"wrist": "HAND"}, "The robot mine has no site 'HAND'"),
        ({"build": lambda: None}, "build of the robot mine gives a NoneType; expected a mujoco.MjSpec"),
        ({"build": lambda: 1 / 0}, "build of the robot mine ends in ZeroDivisionError: division by zero"),
    ):
        with pytest.raises(InputError, match=sentence):
            scene(CLIP, robot(**values))
