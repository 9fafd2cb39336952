"""The two-arm scene against the recorded trials, Newton's third law, and the importer's way of storing both arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.store import read_attrs, read_recordings, read_simulation
from rcbht_jax.learning.tasks import TaskSpec, extract_features, labelled_intervals
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import snap_recordings
from sim_mjx.assembly import task, two_arm_program
from sim_mjx.assembly.controllers import approach
from sim_mjx.assembly.rollout import Rollouts, as_float32
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.assembly.two_arm_scene import TURN, model_fields, two_arm
from sim_mjx.engines import native
from sim_mjx.presets import TWO_ARM, preset
from sim_mjx.presets import two_arm as presets
from sim_mjx.randomization.trials import FAULTS, DomainRandomization, sample
from sim_mjx.randomization.two_arm import REPEATED
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig
from sim_mjx.validation.sessions import part_of
from sim_mjx.validation.solver_convergence import certify
from tests.support.trees import assert_trees_equal

SOURCE = "SIM_HIRO_TWO_SA_SUCCESS"
SCENE = two_arm()
ONSETS = [0.0, 4.005, 11.94, 15.67]  # s, recorded medians


def trials(name: str, count: int = 2, spec: DomainRandomization = REPEATED) -> two_arm_program.TwoArmParams:
    params: two_arm_program.TwoArmParams = get_scenario(name).draw_batch(0, range(count), spec)[0]
    return params


@pytest.fixture(scope="module")
def whole() -> dict[str, Rollouts]:
    """Two whole trials of each preset, simulated as one batch."""
    batches = [trials(name) for name in TWO_ARM]
    run = native.simulate(SCENE, jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches))
    return {name: part_of(run, slice(2 * i, 2 * i + 2)) for i, name in enumerate(TWO_ARM)}


@pytest.fixture(scope="module")
def recorded(hiro_dir: Path) -> list[Path]:
    return sorted((hiro_dir / SOURCE).iterdir())


def angles(folder: Path, arm: str) -> np.ndarray:
    return dat.read_timed(folder / f"{arm}_Angles.dat", "joint angles").values


def logged(folder: Path, arm: str) -> np.ndarray:
    return dat.read_timed(folder / f"{arm}_Torques.dat", "wrench").values


def test_both_arms_of_the_model_stand_where_the_kinematics_say(recorded: list[Path]) -> None:
    data = mujoco.MjData(SCENE.model)
    for folder in recorded[:3]:
        both = np.concatenate([angles(folder, "R"), angles(folder, "L")], axis=1)[::200]
        for row in both:
            data.qpos[SCENE.joints] = row
            mujoco.mj_kinematics(SCENE.model, data)
            for arm, q in (("R", row[:6]), ("L", row[6:])):
                _, rotation, tcp = kinematics.fk(q, arm)
                np.testing.assert_allclose(data.site(f"{arm}ARM_TCP").xpos, tcp, atol=1e-9)
                np.testing.assert_allclose(data.site(f"{arm}ARM_TCP").xmat.reshape(3, 3), rotation, atol=1e-9)


def test_approach_is_the_recorded_one(recorded: list[Path]) -> None:
    right = presets.TASK
    for folder in recorded:
        q = angles(folder, "R")
        np.testing.assert_allclose(q[0], right.home, atol=1e-12)
        t = np.arange(len(q)) * CONTROL_PERIOD
        free = (t > 2.0) & (t < 3.9)
        planned = approach(right.home, right.way_time, right.way_position, right.way_rpy, t[free])
        np.testing.assert_allclose(planned, q[free], atol=1e-3)


def test_left_arm_never_moved_in_the_recordings(recorded: list[Path]) -> None:
    for folder in recorded:
        q = angles(folder, "L")
        np.testing.assert_array_equal(q, np.broadcast_to(presets.TWO_FIXED.hold.home, q.shape))


def test_set_points_are_the_recorded_ones(recorded: list[Path]) -> None:
    """What is left of the recorded joint increments when the logged wrench is taken off."""
    right = presets.TASK
    gain = float(right.force_gain), float(right.moment_gain[0])
    for folder in recorded[::5]:
        q, wrench = angles(folder, "R"), logged(folder, "R")[:-1]
        velocity, angular = kinematics.jacobian(q)
        _, rotation, _ = kinematics.fk(q)
        step = np.diff(q, axis=0)
        seen = [
            np.linalg.solve(jacobian[:-1, :, part].swapaxes(1, 2), step[:, part, None] / k)
            for jacobian, part, k in zip((velocity, angular), (slice(3), slice(3, 6)), gain, strict=True)
        ]
        push, turn = (rotation[:-1].swapaxes(1, 2) @ one for one in seen)
        t = np.arange(len(step)) * CONTROL_PERIOD
        for row, (begin, end) in enumerate(((4.05, 11.9), (12.0, 14.45), (14.55, 15.4))):
            inside = (t > begin) & (t < end)
            np.testing.assert_allclose((wrench[inside, :3] - push[inside, :, 0]).mean(0), right.force[row], atol=0.1)
            np.testing.assert_allclose((wrench[inside, 3:] - turn[inside, :, 0]).mean(0), right.moment[row], atol=0.05)


def test_trials_go_through_the_states_when_the_recorded_ones_do(whole: dict[str, Rollouts]) -> None:
    for run in whole.values():
        np.testing.assert_allclose(run.onset, np.tile(ONSETS, (len(run.onset), 1)), atol=0.3)
        assert not run.diverged.any()
        assert run.seated.all()


def test_parts_push_both_hands_equally(whole: dict[str, Rollouts]) -> None:
    """Newton's third law in world axes, after both wrists' offsets; slow enough that no mass matters."""
    run = whole["two-fixed"]
    params = trials("two-fixed")
    for row in range(len(run.length)):
        samples = slice(int(run.onset[row, 2] / CONTROL_PERIOD), int(run.length[row]))
        wrench = run.wrench[row, samples] - params.offset[row]
        q = run.joints[row, samples].astype(np.float64)
        forces = [
            (kinematics.fk(q[:, 6 * arm : 6 * arm + 6], name)[1] @ wrench[:, 6 * arm : 6 * arm + 3, None])[..., 0]
            for arm, name in enumerate("RL")
        ]
        assert np.abs(forces[0]).max() > 2.0
        np.testing.assert_allclose(forces[0], -forces[1], atol=0.35)


def test_left_hand_gives_way_under_force_control_only(whole: dict[str, Rollouts]) -> None:
    way = {}
    for name, run in whole.items():
        wrist, _, _ = kinematics.fk(run.joints[0, : run.length[0], 6:].astype(np.float64), "L")
        way[name] = float(np.linalg.norm(wrist - wrist[0], axis=1).max())
    assert way["two-fixed"] < 5e-5
    assert 2e-4 < way["two"] < 5e-3


def test_force_control_moves_the_left_hand_with_the_push() -> None:
    hold = jax.jit(two_arm_program.hold)
    held = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), presets.HOLD)
    home = held.home
    row = task.INSERTION - task.ROTATION
    goal = jnp.concatenate([held.force[row], held.moment[row]])
    phase = jnp.int32(task.INSERTION)
    np.testing.assert_allclose(hold(held, home, home, goal, phase), home, atol=1e-7)
    for phase_off in (task.APPROACH, task.ENDED):
        np.testing.assert_array_equal(hold(held, home, home, goal + 5.0, jnp.int32(phase_off)), home)
    before, rotation, _ = kinematics.fk(np.asarray(home, np.float64), "L")
    for axis in range(3):
        push = goal.at[axis].add(10.0)
        after, _, _ = kinematics.fk(np.asarray(hold(held, home, home, push, phase), np.float64), "L")
        assert ((after - before) @ rotation)[axis] > 0
    off = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), presets.TWO_FIXED.hold)
    np.testing.assert_array_equal(hold(off, home, home, goal + 5.0, phase), home)


def test_a_robot_that_is_stopped_keeps_both_arms_still() -> None:
    """The parts are in contact then, and the left hand would go on giving way to the force."""
    stopped = DomainRandomization(nominal_share=0.0, faults=("early-stop",), stop_at=(0.8, 0.8), logs_on=0.5)
    params = trials("two", 1, stopped)
    run = native.simulate(SCENE, params)
    still = round(float(params.task.stop[0]) / CONTROL_PERIOD) + 20  # the servos have followed
    assert np.isfinite(run.onset[0, 1])
    assert run.length[0] > still + 100
    assert np.abs(np.ptp(run.joints[0, still : run.length[0]], axis=0)).max() < 2e-5


def test_contact_chatters_on_both_wrists_at_once() -> None:
    """The force between the parts varies by one factor per tick; nothing varies where nothing touches."""
    drawn, _ = get_scenario("two").draw(0, 0, REPEATED)
    contact = np.array([4.0, 2.0, -1.0, 0.1, 0.2, 0.3, 3.0, -2.0, 1.0, 0.3, -0.2, 0.1], np.float32)
    control = jax.jit(two_arm_program.control)

    def wrenches(chatter: float, felt: np.ndarray) -> np.ndarray:
        params = as_float32(replace(drawn, chatter=np.array(chatter)))
        joints = two_arm_program.TWO_ARM.home(params)
        loop, out = two_arm_program.begin(params, jnp.zeros(12, jnp.float32)), []
        for _ in range(20):
            loop, _, log = control(params, loop, joints, jnp.asarray(felt))
            out.append(np.asarray(log.wrench))
        return np.array(out)

    change = (wrenches(0.5, contact) - wrenches(0.0, contact))[5:]
    forces = change[:, [0, 1, 2, 6, 7, 8]] / contact[[0, 1, 2, 6, 7, 8]]
    assert forces.std() > 0.02
    np.testing.assert_allclose(forces, np.broadcast_to(forces[:, :1], forces.shape), atol=1e-4)
    np.testing.assert_array_equal(wrenches(0.5, 0 * contact), wrenches(0.0, 0 * contact))


def test_free_space_offset_appears_as_recorded(recorded: list[Path], whole: dict[str, Rollouts]) -> None:
    found = whole["two"].wrench[0, 500:760].mean(0)
    mean = np.mean([np.concatenate([logged(f, a)[500:760].mean(0) for a in "RL"]) for f in recorded], axis=0)
    np.testing.assert_allclose(found[:3], mean[:3], atol=0.1)
    np.testing.assert_allclose(found[6:9], mean[6:9], atol=0.1)
    np.testing.assert_allclose(found[[3, 4, 5, 9, 10, 11]], mean[[3, 4, 5, 9, 10, 11]], atol=0.01)


def test_part_moves_in_the_axes_of_the_left_hand() -> None:
    """Forward, up and to the robot's right, whatever the wrist's own axes are."""
    home = presets.HOLD.home
    _, rotation, _ = kinematics.fk(home, "L")
    np.testing.assert_allclose(rotation @ TURN, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=2e-3)
    part = presets.PARTS
    shift = np.array([0.001, 0.002, 0.003])
    plain = model_fields(SCENE.model, part)["body_pos"]
    moved = model_fields(SCENE.model, replace(part, position=part.position + shift))["body_pos"]
    mount = SCENE.model.body("MOUNT").id
    np.testing.assert_allclose(rotation @ (moved - plain)[mount], [0.001, -0.003, 0.002], atol=1e-5)
    assert not np.delete(moved - plain, mount, axis=0).any()


@pytest.mark.parametrize("kind", sorted(FAULTS))
def test_faults_are_those_of_one_arm_turned_sideways(kind: str) -> None:
    spec = DomainRandomization(nominal_share=0.0, faults=(kind,))
    params, fault = get_scenario("two").draw(5, 3, spec)
    single, same = sample(preset("openhrp"), 5, 3, spec)
    assert (fault.kind, fault.failure_type) == (same.kind, same.failure_type)
    np.testing.assert_array_equal(fault.deviation, same.deviation)
    base, one = presets.TWO, sample(preset("openhrp"), 5, 3, DomainRandomization(nominal_share=0.0, faults=(kind,)))[0]
    moved = params.task.way_position - base.task.way_position
    wanted = one.task.way_position - np.array([[0.326, -0.1726, 0.536], [0.331, -0.1726, 0.531]])
    np.testing.assert_allclose(moved[:, [0, 2]], wanted[:, [0, 1]], atol=1e-12)
    np.testing.assert_allclose(params.task.way_rpy[:, 0] - np.pi / 2, single.task.way_rpy[:, 0], atol=1e-12)
    np.testing.assert_array_equal(params.parts.hook_overlap < 0, single.parts.hook_overlap < 0)


def test_a_trial_depends_on_seed_and_index_alone() -> None:
    spec = DomainRandomization()
    batch, _ = get_scenario("two").draw_batch(3, [4, 9], spec)
    single, _ = get_scenario("two").draw(3, 9, spec)
    assert_trees_equal(jax.tree.map(lambda rows: rows[1], batch), single)
    other, _ = get_scenario("two").draw(4, 9, spec)
    assert not np.array_equal(other.offset, single.offset)
    still, _ = get_scenario("two-fixed").draw(3, 9, spec)
    np.testing.assert_array_equal(still.offset, single.offset)
    assert still.hold.force_gain == still.hold.moment_gain == 0


def test_a_physical_parameter_of_the_sensor_is_that_of_both_wrists() -> None:
    spec = DomainRandomization(nominal_share=1.0, physical=(("sensor.step", 0.5), ("sensor.delay", 3.0)))
    params, _ = get_scenario("two").draw_batch(0, range(2), spec)
    for sensor in (params.sensor, params.left_sensor):
        assert (sensor.step == 0.5).all()
        assert sensor.delay.tolist() == [3, 3]


def test_unknown_presets_are_refused() -> None:
    with pytest.raises(InputError, match="two-fixed"):
        get_scenario("three")


def test_solver_has_converged() -> None:
    params = trials("two", 2)
    quick = replace(params.task, way_time=params.task.way_time / 2, contact_after=params.task.contact_after / 2)
    certificate = certify(replace(params, task=replace(quick, timeout=np.full(2, 3.5))), two_arm)
    assert certificate.converged


def test_store_is_like_the_imported_one(tmp_path: Path) -> None:
    """Two recordings per trial, right before left; grammar and tasks read both arms."""
    target = tmp_path / "two.zarr"
    report = synthesise(target, SynthesisConfig("two", trials=5, shard=2, spec=DomainRandomization(longest=0.4)))
    assert report.stored == 5
    assert sum(count for count, _ in report.faults.values()) == 5
    found, known = read_recordings(target), read_simulation(target)
    assert found.arm.tolist() == ["R", "L"] * 5
    assert found.trial[::2].tolist() == found.trial[1::2].tolist()
    assert found.wrench.shape[2] == 6
    assert read_attrs(target)["simulated"]["job"]["preset"] == "two"
    np.testing.assert_array_equal(known["index"], np.repeat(np.arange(5), 2))
    assert known["hold_force"].shape == (10, 4, 3)
    assert known["offset"].shape == (10, 12)
    params, _ = get_scenario("two").draw_batch(0, range(5), DomainRandomization(longest=0.4))
    run = native.simulate(SCENE, params)
    longest = found.wrench.shape[1]
    np.testing.assert_allclose(found.wrench[0::2], run.wrench[:, :longest, :6], atol=1e-6)
    np.testing.assert_allclose(found.wrench[1::2], run.wrench[:, :longest, 6:], atol=1e-6)


def test_grammar_of_both_arms(whole: dict[str, Rollouts]) -> None:
    run = whole["two"]
    count = len(run.length)
    rows = np.repeat(np.arange(count), 2)
    blank = np.full(2 * count, "")
    both = snap_recordings(
        wrench=run.wrench.reshape(count, -1, 2, 6).swapaxes(1, 2).reshape(2 * count, -1, 6), length=run.length[rows],
        dt=CONTROL_PERIOD, onset=run.onset[rows], onset_harmonised=run.onset[rows],
        trial=np.array([f"trial {row}" for row in rows]), arm=np.tile(["R", "L"], count), source=blank, session=blank,
        outcome=np.full(2 * count, "success"), failure_type=blank, deviation=np.zeros((2 * count, 3)), note=blank,
    )  # fmt: skip
    tracks = encode_dataset(both)
    items = labelled_intervals(both, TaskSpec(arms="both"))
    assert items.classes == ("approach", "rotation", "insertion", "mating")
    single = extract_features(tracks, labelled_intervals(both, TaskSpec(arms="R")), FeatureSpec())
    made = extract_features(tracks, items, FeatureSpec())
    assert made.values.shape == (4 * count, 2 * single.values.shape[1])
    np.testing.assert_array_equal(made.values[:, : single.values.shape[1]], single.values)
