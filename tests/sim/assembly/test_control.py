"""Controllers, state machine and sensor chain of the simulation."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.robots import kinematics
from sim_mjx.assembly import sensor, task
from sim_mjx.assembly.controllers import force_law, goals_in_world, half_cosine
from sim_mjx.assembly.rollout import as_float32, stack
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import ONE_ARM, preset

NAMES = tuple(ONE_ARM)
advance = jax.jit(task.advance)


def single(name: str) -> object:
    return as_float32(preset(name).task)


def run(params: object, wrench_of: object, joints_of: object, ticks: int) -> task.TaskState:
    state = task.start(params)
    for tick in range(ticks):
        joints = jnp.asarray(joints_of(tick, state), jnp.float32)
        state = advance(params, state, joints, jnp.asarray(wrench_of(tick, state), jnp.float32))
    return state


def test_unknown_presets_are_refused() -> None:
    with pytest.raises(InputError, match="openhrp"):
        preset("D")


@pytest.mark.parametrize("name", NAMES)
def test_force_law_is_the_transposed_jacobian(name: str) -> None:
    params, rng = preset(name).task, np.random.default_rng(0)
    q, wrench, force, moment = params.home, rng.normal(size=6), rng.normal(size=3), rng.normal(size=3)
    new = np.asarray(force_law(jnp.asarray(q), jnp.asarray(wrench), force, moment, 5e-5, 3.5e-6))
    velocity, angular = kinematics.jacobian(q)
    expected = q.copy()
    for j in range(3):
        expected[j] += 5e-5 * velocity[:, j] @ (wrench[:3] - force)
        expected[j + 3] += 3.5e-6 * angular[:, j + 3] @ (wrench[3:] - moment)
    np.testing.assert_allclose(new, expected, atol=1e-7)


def test_set_points_turn_with_the_wrist_unless_given_in_the_world() -> None:
    turn = kinematics.rotation_from_rpy(np.array([0.0, -np.pi / 2, 0.0]))
    goal = jnp.array([10.0, 0.0, -5.0])
    np.testing.assert_allclose(goals_in_world(goal, turn, jnp.bool_(True)), goal)
    # hand straight down: the wrist's x is the world's z, its z the world's -x
    np.testing.assert_allclose(goals_in_world(goal, turn, jnp.bool_(False)), [5.0, 0.0, 10.0], atol=1e-6)


def test_a_motion_rests_at_every_waypoint_and_is_halfway_in_half_the_time() -> None:
    times, poses = np.array([0.0, 2.0, 3.0]), np.array([[1.0, 0.0], [5.0, -2.0], [5.0, 4.0]])
    at = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 9.0])
    share = (1 - np.cos(np.pi / 4)) / 2
    expected = [poses[0], poses[0], poses[0] + share * (poses[1] - poses[0]), [3.0, -1.0], poses[1], [5.0, 1.0]]
    np.testing.assert_allclose(half_cosine(times, poses, at), [*expected, poses[2], poses[2]], atol=1e-12)
    speed = np.diff(half_cosine(times, poses, np.repeat(times, 2) + np.tile([-1e-4, 1e-4], 3)), axis=0)[::2]
    np.testing.assert_allclose(speed, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_without_contact_the_approach_ends_by_timeout(name: str) -> None:
    params = replace(single(name), timeout=jnp.float32(0.1))
    state = run(params, lambda tick, s: np.zeros(6), lambda tick, s: s.command, 30)
    assert int(state.phase) == task.ENDED
    assert np.asarray(state.entered).tolist() == [0, -1, -1, -1, -1, 20]


def test_session_a_passes_its_states_by_force_and_wrist_angle() -> None:
    params = replace(single("A"), mating_time=jnp.float32(0.05))
    pushed = np.array([0.0, 0.0, 12.0, 0.0, 0.0, 0.0])

    def wrench(tick: int, state: task.TaskState) -> np.ndarray:
        return pushed if tick >= 10 else np.zeros(6)

    def joints(tick: int, state: task.TaskState) -> np.ndarray:
        angle = 0.5 if tick < 20 else 0.18 if tick < 30 else 0.1
        return np.array([*np.asarray(params.home[:4]), angle, 0.0])

    state = run(params, wrench, joints, 60)
    entered = np.asarray(state.entered)
    assert entered[:3].tolist() == [0, 10, 20]
    assert entered[task.MATING] == 30
    assert entered[task.PRE_MATING] == -1  # session A has none
    assert entered[task.ENDED] == 40
    onsets = task.onsets(entered)
    np.testing.assert_allclose(onsets, np.array([0, 10, 20, 30]) * CONTROL_PERIOD, atol=1e-6)


def test_a_stopped_robot_keeps_still_and_its_record_goes_on() -> None:
    params = replace(single("A"), stop=jnp.float32(0.05), timeout=jnp.float32(0.2))
    pushed = lambda tick, s: np.array([0.0, 0.0, 12.0 * (tick > 5), 0.0, 0.0, 0.0])  # noqa: E731
    home = lambda tick, s: params.home.at[4].set(0.18 if tick > 10 else 0.5)  # noqa: E731  # would end the rotation
    before, later = run(params, pushed, home, 10), run(params, pushed, home, 39)
    assert int(before.phase) == int(later.phase) == task.ROTATION
    np.testing.assert_array_equal(before.command, later.command)
    assert not np.array_equal(run(replace(params, stop=jnp.float32(9)), pushed, home, 39).command, later.command)
    assert np.asarray(run(params, pushed, home, 41).entered).tolist() == [0, 6, -1, -1, -1, 40]


def test_after_mating_the_robot_rests_for_as_long_as_it_is_told() -> None:
    params = replace(single("A"), mating_time=jnp.float32(0.05), rest=jnp.float32(0.1))
    down = params.home.at[4].set(0.1)  # the wrist is bent farther than it waits for
    wrench = lambda tick, s: np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])  # noqa: E731
    entered = run(params, wrench, lambda tick, s: down, 60).entered
    begun = int(entered[task.MATING])
    assert int(entered[task.ENDED]) == begun + 30
    still = [run(params, wrench, lambda tick, s: down, begun + ticks).command for ticks in (5, 11, 12, 29)]
    assert not np.array_equal(still[0], still[1])
    np.testing.assert_array_equal(still[1], still[2])
    np.testing.assert_array_equal(still[2], still[3])


def test_sessions_b_and_c_rotate_for_one_period() -> None:
    up = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    for name in ("B", "C"):
        params = single(name)
        state = run(params, lambda tick, s: up, lambda tick, s: s.command, 4)
        assert np.asarray(state.entered)[:3].tolist() == [0, 1, 2]


def test_insertion_ends_by_pitch() -> None:
    task_b = preset("B").task
    position = kinematics.fk(task_b.home)[2]
    level, down = (
        kinematics.ik(position, kinematics.rotation_from_rpy(np.array([0.0, pitch, 0.0])), task_b.home)
        for pitch in (-1.5, -1.56)
    )

    up = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    state = run(as_float32(task_b), lambda tick, s: up, lambda tick, s: down if tick >= 20 else level, 50)
    assert np.asarray(state.entered)[[task.INSERTION, task.MATING]].tolist() == [2, 20]


def test_nothing_follows_the_end() -> None:
    params = replace(single("B"), leave_wrist=jnp.full(4, jnp.inf), mating_time=jnp.float32(0.05))
    up = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    ended, later = (run(params, lambda tick, s: up, lambda tick, s: params.home, ticks) for ticks in (15, 40))
    assert int(ended.phase) == int(later.phase) == task.ENDED
    np.testing.assert_array_equal(ended.command, later.command)


@pytest.mark.parametrize("row", range(4))
def test_each_phase_has_its_own_set_points_and_gain(row: int) -> None:
    rng, never, task_b = np.random.default_rng(row), np.full(4, task.NEVER), preset("B").task
    force, moment, wrench = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.normal(size=6)
    gains = np.array([1e-3, 2e-3, 3e-3, 4e-3])
    params = as_float32(
        replace(task_b, force=force, moment=moment, moment_gain=gains, leave_wrist=never, leave_pitch=never)
    )
    state = task.TaskState(jnp.int32(9), jnp.int32(task.ROTATION + row), jnp.zeros(6, jnp.int32), params.home)
    found = advance(params, state, params.home, jnp.asarray(wrench, jnp.float32)).command
    velocity, angular = kinematics.jacobian(task_b.home)
    turns = np.concatenate(
        [
            task_b.force_gain * (wrench[:3] - force[row]) @ velocity[:, :3],
            gains[row] * (wrench[3:] - moment[row]) @ angular[:, 3:],
        ]
    )
    np.testing.assert_allclose(found - task_b.home, turns, atol=1e-6)


def test_an_approach_is_where_its_plan_is_at_the_end_of_a_period() -> None:
    params = replace(single("B"), way_time=jnp.array([0.1, 0.2]))
    halfway = run(params, lambda tick, s: np.zeros(6), lambda tick, s: s.command, 10).command
    home, way = kinematics.fk(params.home)[2], params.way_position[0]
    np.testing.assert_allclose(kinematics.fk(halfway)[2], (home + way) / 2, atol=1e-4)


def test_times_are_whole_periods_although_single_precision_is_not() -> None:
    ticks = np.arange(12_000)  # a minute
    np.testing.assert_array_equal(task.periods(jnp.asarray(ticks * CONTROL_PERIOD, jnp.float32)), ticks)


def test_openhrp_waits_for_its_time_before_it_believes_a_contact() -> None:
    params = single("openhrp")
    up = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    state = run(params, lambda tick, s: up, lambda tick, s: s.command, 50)
    assert int(state.phase) == task.APPROACH


def test_a_state_never_reached_has_no_onset() -> None:
    onsets = task.onsets(np.array([0, 12, -1, -1, -1, 30]))
    assert onsets[1] == pytest.approx(0.06)
    assert np.isnan(onsets[2:]).all()


def test_batches_of_presets_keep_every_field() -> None:
    batch = stack([preset("A").task, preset("C").task])
    for name in type(batch).__dataclass_fields__:
        rows = getattr(batch, name)
        np.testing.assert_array_equal(rows[0], getattr(preset("A").task, name))
        np.testing.assert_array_equal(rows[1], getattr(preset("C").task, name))


def settle(params: sensor.SensorParams, raw: np.ndarray, first: np.ndarray, ticks: int = 400) -> np.ndarray:
    params = as_float32(params)
    read = jax.jit(sensor.read)
    state = sensor.begin(params, jnp.asarray(first, jnp.float32))
    for _ in range(ticks):
        state, logged = read(params, state, jnp.asarray(raw, jnp.float32), jnp.zeros(6), jnp.eye(3))
    return np.asarray(logged)


def test_recorded_filter_has_its_gain_error_and_the_right_one_none() -> None:
    raw = np.array([3.0, -2.0, 10.0, 0.0, 0.0, 0.0])
    params = replace(preset("A").sensor, reference=np.zeros(3), bias=np.zeros(6))
    logged = settle(params, raw, np.zeros(6))
    np.testing.assert_allclose(logged[:3], 1.1338 * raw[:3], atol=0.03)
    exact = settle(replace(params, d=np.array(0.0730)), raw, np.zeros(6))
    np.testing.assert_allclose(exact[:3], raw[:3], atol=0.03)


def test_tare_removes_what_was_there_at_first_and_moments_refer_to_the_sensor() -> None:
    weight = np.array([-4.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    params = replace(preset("A").sensor, bias=np.zeros(6))
    np.testing.assert_allclose(settle(params, weight, weight), 0.0, atol=1e-6)
    push = np.array([0.0, 0.0, 5.0])
    about_wrist = np.cross(params.reference, push)  # a force through the reference point has no moment there
    logged = settle(params, np.concatenate([push, about_wrist]), np.zeros(6))
    np.testing.assert_allclose(logged[3:], 0.0, atol=2e-3)


def test_readings_come_late_by_the_delay() -> None:
    params = as_float32(
        replace(preset("openhrp").sensor, d=np.array(1.0), c=np.array(0.0), delay=np.array(3, np.int32))
    )
    state, seen = sensor.begin(params, jnp.zeros(6)), []
    for tick in range(6):
        raw = jnp.full(6, float(tick + 1), jnp.float32)
        state, logged = sensor.read(params, state, raw, jnp.zeros(6), jnp.eye(3))
        seen.append(float(logged[0]))
    np.testing.assert_allclose(seen, [0, 0, 0, 1, 2, 3], atol=1e-4)


def direct(**changes: np.ndarray) -> sensor.SensorParams:
    """A sensor without filter, delay, tare, noise and quantisation, but for ``changes``."""
    plain = {
        "a": np.array(0.0), "b": np.array(0.0), "c": np.array(0.0), "d": np.array(1.0), "delay": np.array(0, np.int32),
        "noise": np.zeros(6), "step": np.full(6, 1e-6), "bias": np.zeros(6), "tared": np.array(0.0),
        "reference": np.zeros(3),
    }  # fmt: skip
    return as_float32(sensor.SensorParams(**plain | changes))


def reading(params: sensor.SensorParams, raw: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
    """One reading [6] of a raw wrench [6], world frame = wrist frame."""
    felt, normal = jnp.asarray(raw, jnp.float32), jnp.asarray(np.zeros(6) if noise is None else noise, jnp.float32)
    return np.asarray(sensor.read(params, sensor.begin(params, felt), felt, normal, jnp.eye(3))[1])


def test_exact_readings_are_those_without_noise_and_quantisation() -> None:
    rng = np.random.default_rng(0)
    params = direct(
        a=np.array(0.9), b=np.array(0.1), c=np.array(0.7), d=np.array(0.3), delay=np.array(2, np.int32),
        tared=np.array(1.0), reference=np.array([0.01, -0.03, 0.05]), bias=rng.normal(size=6),
    )  # fmt: skip
    turned = jnp.asarray(kinematics.rotation_from_rpy(np.array([0.3, -1.2, 0.5])), jnp.float32)
    raw = jnp.asarray(rng.normal(size=(6, 6)), jnp.float32)
    state = other = sensor.begin(params, raw[0])
    for felt in raw:
        state, logged = sensor.read(params, state, felt, jnp.zeros(6), turned)
        other, exact = sensor.read_exactly(params, other, felt, turned)
        np.testing.assert_allclose(exact, logged, atol=1e-5)


def test_noise_is_added_before_the_filter_with_its_standard_deviation() -> None:
    raw, normal = np.arange(6.0), np.array([1.0, -1.0, 2.0, 0.5, -0.5, 3.0])
    sd = np.array([0.105, 0.077, 0.065, 0.0017, 0.0042, 0.0038])
    np.testing.assert_allclose(reading(direct(noise=sd), raw, normal), raw + sd * normal, atol=2e-6)
    halved = reading(direct(noise=sd, d=np.array(0.5)), raw, normal)
    np.testing.assert_allclose(halved, 0.5 * (raw + sd * normal), atol=2e-6)


def test_an_offset_is_read_without_a_load_and_jitter_only_under_one() -> None:
    offset, normal = np.array([2.0, 0.0, -1.0, 0.0, 0.1, 0.0]), np.array([1.0, -1.0, 2.0, 0.5, -0.5, 3.0])
    factor = np.tril(np.arange(36.0).reshape(6, 6) / 10)
    params = direct(offset=offset, jitter=factor, delay=np.array(1, np.int32))
    rest, brushed, pressed = np.array([0.0, 0.0, -4.0, 0.0, 0.0, 0.0]) + np.eye(6)[2] * [[0.0], [0.9], [10.0]]
    state, given = sensor.begin(params, jnp.asarray(rest, jnp.float32)), jnp.asarray(normal, jnp.float32)
    for felt, expected in ((brushed, rest), (pressed, brushed), (rest, pressed + factor @ normal)):
        state, logged = sensor.read(params, state, jnp.asarray(felt, jnp.float32), given, jnp.eye(3))
        np.testing.assert_allclose(logged, expected + offset, atol=1e-5)


def test_bias_is_added_to_the_reading_in_the_world_frame() -> None:
    bias = np.array([0.3, -0.2, 0.1, 0.02, -0.01, 0.03])
    np.testing.assert_allclose(reading(direct(bias=bias), np.arange(6.0)), np.arange(6.0) + bias, atol=2e-6)
    turned = jnp.asarray(kinematics.rotation_from_rpy(np.array([0.0, -np.pi / 2, 0.0])), jnp.float32)
    params = direct(bias=bias)
    _, logged = sensor.read(params, sensor.begin(params, jnp.zeros(6)), jnp.zeros(6), jnp.zeros(6), turned)
    np.testing.assert_allclose(logged, bias, atol=1e-6)


def test_readings_are_quantised_before_the_filter() -> None:
    raw = np.array([1.24, -1.26, 0.74, 0.124, -0.126, 0.074])
    step = np.array([0.5] * 3 + [0.05] * 3)
    np.testing.assert_allclose(reading(direct(step=step), raw), [1.0, -1.5, 0.5, 0.1, -0.15, 0.05], atol=1e-6)
    halved = reading(direct(step=step, d=np.array(0.5)), raw)
    np.testing.assert_allclose(halved, [0.5, -0.75, 0.25, 0.05, -0.075, 0.025], atol=1e-6)


def test_readings_are_turned_from_the_wrist_into_the_world() -> None:
    turn, raw = kinematics.rotation_from_rpy(np.array([0.3, -1.2, 0.5])), np.array([3.0, -2.0, 10.0, 0.1, 0.4, -0.2])
    params, felt = direct(reference=np.array([0.01, -0.03, 0.05])), jnp.asarray(raw, jnp.float32)
    about = raw[3:] - np.cross([0.01, -0.03, 0.05], raw[:3])
    expected = np.concatenate([turn @ raw[:3], turn @ about])
    state, turned = sensor.begin(params, jnp.zeros(6)), jnp.asarray(turn, jnp.float32)
    for _, logged in (
        sensor.read(params, state, felt, jnp.zeros(6), turned),
        sensor.read_exactly(params, state, felt, turned),
    ):
        np.testing.assert_allclose(logged, expected, atol=3e-6)
