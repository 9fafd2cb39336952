"""Motions of the hand do what they are named after, and joint references follow them on any arm."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sim_mjx.controllers import Sense, admittance, go_to, keep_turn, resolved_rates, spiral, tilt
from sim_mjx.robots import ROBOTS
from sim_mjx.robots.chain import pose, rotation_vector, serial_chain
from sim_mjx.robots.robot import HAND, equipped

PERIOD = 0.005


def sense(**values: Any) -> Sense:
    nothing = {name: jnp.zeros(3) for name in Sense.__dataclass_fields__ if name != "time"}
    return Sense(**{"time": jnp.float32(0), **nothing, **values})


def followed(move: Any, seconds: float) -> np.ndarray:
    """Place and turn ``[time, 6]`` of a hand that follows a motion exactly."""

    def step(at: jax.Array, tick: jax.Array) -> tuple[jax.Array, jax.Array]:
        time = tick.astype(jnp.float32) * PERIOD
        new = at + PERIOD * move(sense(time=time, wanted_place=at[:3], wanted_turn=at[3:]))
        return new, new

    return np.asarray(jax.lax.scan(step, jnp.zeros(6), jnp.arange(round(seconds / PERIOD)))[1])


def test_go_to_arrives_at_its_speed_and_stays() -> None:
    goal = np.array([0.01, -0.02, 0.02], np.float32)
    path = followed(lambda seen: go_to(seen, goal, 0.01, jnp.array([0.0, 0.1, 0.0])), 5.0)
    speeds = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) / PERIOD
    assert speeds.max() == pytest.approx(0.01, rel=1e-3)
    np.testing.assert_allclose(path[-1], [*goal, 0.0, 0.1, 0.0], atol=1e-5)
    assert np.linalg.norm(path[200, :3]) == pytest.approx(0.01, rel=0.01)  # after one second
    left = np.linalg.norm(path[:, :3] - goal, axis=1)
    assert left[620] / left[620 - round(1 / 8 / PERIOD)] == pytest.approx(np.exp(-1), rel=0.03)


def test_a_spiral_leaves_nothing_out() -> None:
    """Every point within its radius is nearer to the path than half the pitch, and the speed is constant."""
    pitch, speed, seconds = 1e-3, 8e-3, 6.0
    path = followed(lambda seen: spiral(seen, pitch, speed), seconds)[:, :2]
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1)[20:] / PERIOD
    np.testing.assert_allclose(speeds, speed, rtol=0.05)
    radius = np.sqrt(speed * seconds * pitch / np.pi)  # an area of path times pitch
    assert np.linalg.norm(path, axis=1).max() == pytest.approx(radius, rel=0.05)
    points = np.random.default_rng(0).uniform(-radius, radius, (400, 2))
    points = points[np.linalg.norm(points, axis=1) < radius - pitch]
    nearest = np.linalg.norm(points[:, None] - path[None], axis=2).min(1)
    assert nearest.max() < 0.55 * pitch


def test_tilt_leans_all_round_and_keep_turn_undoes_it() -> None:
    turns = followed(lambda seen: tilt(seen, 0.05, 2.0), 6.0)[:, 3:]
    late = turns[400:]
    assert not turns[0].any()  # leaning begins slowly
    np.testing.assert_allclose(np.linalg.norm(late, axis=1), 0.05, rtol=0.1)
    assert (late.max(0)[:2] > 0.04).all()
    assert (late.min(0)[:2] < -0.04).all()
    assert (late[:, 2] == 0).all()
    back = keep_turn(sense(wanted_turn=jnp.array([0.1, 0.0, 0.0])))
    assert float(back[3]) < 0


@pytest.mark.parametrize(("period", "share"), [(4.0, 98), (2.0, 93), (1.0, 79)])
def test_the_lag_of_a_tilt_is_as_documented(period: float, share: int) -> None:
    turns = followed(lambda seen: tilt(seen, 0.05, period), 3 * period)[:, 3:]
    lean = np.linalg.norm(turns[round(2 * period / PERIOD) :], axis=1).mean()
    assert round(100 * lean / 0.05) == share
    assert f"{share} % " in " ".join(str(tilt.__doc__).split())


def test_admittance_rests_at_the_wanted_force_against_a_spring() -> None:
    stiffness = 1e4
    wanted = jnp.array([0.0, 0.0, 12.0])

    def move(seen: Sense) -> jax.Array:
        felt = -stiffness * jnp.minimum(seen.wanted_place, 0.0) * jnp.array([0.0, 0.0, 1.0])
        pushed = sense(force=felt, moment=jnp.array([0.2, 0.0, 0.0]))
        return admittance(pushed, wanted, 6e-4, 0.1)

    path = followed(move, 2.0)
    assert path[-1, 2] == pytest.approx(-12.0 / stiffness, rel=1e-3)
    assert path[-1, 3] == pytest.approx(0.2 * 0.1 * 2.0, rel=1e-3)  # it turns the way it is pushed


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_hand_moves_as_it_is_told(name: str) -> None:
    robot = ROBOTS[name]
    chain = serial_chain(equipped(robot).compile(), HAND)
    home = np.array(robot.home, np.float32)
    twist = np.array([0.01, -0.02, 0.03, 0.05, -0.1, 0.02], np.float32)
    step, where = jax.jit(resolved_rates), jax.jit(pose)
    now = home
    for _ in range(100):  # half a second
        now = step(chain, now, twist, home)
    place, turn = where(chain, home)
    moved, turned = where(chain, now)
    np.testing.assert_allclose((moved - place) / 0.5, twist[:3], atol=1e-3)
    np.testing.assert_allclose(rotation_vector(turned @ turn.T) / 0.5, twist[3:], atol=5e-3)
    # an arm with a spare joint goes home without moving its hand
    aside = np.asarray(now) + np.linspace(0.1, -0.1, len(home), dtype=np.float32)
    after = step(chain, aside, np.zeros(6, np.float32), home)
    np.testing.assert_allclose(where(chain, after)[0], where(chain, aside)[0], atol=2e-5)
    spare = len(home) > 6
    assert (np.linalg.norm(after - home) < np.linalg.norm(aside - home) - 1e-5) == spare
