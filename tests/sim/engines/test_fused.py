"""The fused kernel against C MuJoCo: random models and states, whole trials, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from sim_mjx import engines
from sim_mjx.engines import device
from sim_mjx.engines.fused import prepare
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from tests.support.random_models import Shape, random_scene

SHAPE = Shape(bodies=6, joints=5, pairs=4)  # one, since each is compiled
MODELS, STATES = 60, 4
Floats = NDArray[np.floating]


def states(model: mujoco.MjModel, qpos: Floats, rng: np.random.Generator) -> list[Floats]:
    """Positions near ``qpos``, velocities, guesses of accelerations, and controls, [state, ...]."""
    sizes = ((model.nv, 0.2), (model.nv, 5.0), (model.nu, 1.0))
    rest = [rng.normal(size=(STATES, size)) * scale for size, scale in sizes]
    return [qpos + rng.normal(size=(STATES, model.nv)) * 1e-4, *rest]


def expected(model: mujoco.MjModel, places: Floats, speeds: Floats, guesses: Floats, ctrl: Floats) -> list[Floats]:
    """qpos, qvel, qacc_warmstart and sensordata after a step of C MuJoCo."""
    rows, data = [], mujoco.MjData(model)
    for row in range(len(places)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = places[row], speeds[row], guesses[row]
        data.ctrl[:] = ctrl[row]
        mujoco.mj_step(model, data)
        rows.append([data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy(), data.sensordata.copy()])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def stepped(scene: Any, places: Floats, speeds: Floats, guesses: Floats, ctrl: Floats, still: Any = None) -> Any:
    """The same of the kernel, and the places of tips."""
    step = pytest.importorskip("sim_mjx.engines.fused.step", reason='it needs pip install "rcbht-jax[warp]"')
    structure, count = prepare.structure(scene), len(places)
    body = [jnp.asarray(leaf, jnp.float32) for leaf in (places, speeds, guesses)]
    body.append(jnp.zeros((count, scene.model.nsensordata), jnp.float32))
    still = jnp.zeros(count, bool) if still is None else still
    controls, numbers = jnp.asarray(ctrl, jnp.float32), prepare.numbers_of(structure, {})
    return [np.asarray(leaf) for leaf in step.advance(structure, numbers, 1, tuple(body), controls, controls, still)]


def off(found: Floats, wanted: Floats) -> float:
    """The largest difference, as a share of the largest number."""
    return float(np.abs(found - wanted).max() / (1.0 + np.abs(wanted).max()))


def test_a_step_of_random_models_is_that_of_mujoco() -> None:
    """Only single precision may differ: an acceleration is a small difference of larger ones."""
    rng, wrong, pushed = np.random.default_rng(0), [], 0
    for number in range(MODELS):
        scene, qpos = random_scene(rng, SHAPE)
        if number % 10 == 9:
            scene.model.pair_friction[:] = 0.0  # of which MuJoCo makes 1e-5
        assert prepare.missing(scene.model) is None
        given = states(scene.model, qpos, rng)
        wanted, found = expected(scene.model, *given), stepped(scene, *given)
        wrench, places = scene.forces[:, None] + np.arange(6), scene.places[:, None] + np.arange(3)
        errors = (
            off(found[2], wanted[2]), off(found[1], wanted[1]), off(found[3][:, wrench], wanted[3][:, wrench]),
            off(found[4], wanted[3][:, places]), off(found[0], wanted[0]),
        )  # fmt: skip
        pushed += bool(np.abs(wanted[2]).max() > 100.0)
        if any(error > most for error, most in zip(errors, (2e-3, 1e-3, 2e-3, 2e-6, 1e-3), strict=True)):
            wrong.append((number, errors))
    assert pushed > MODELS // 2
    assert not wrong, wrong


def test_trials_do_not_depend_on_their_neighbours_and_keep_still() -> None:
    scene, qpos = random_scene(np.random.default_rng(1), SHAPE)
    given = states(scene.model, qpos, np.random.default_rng(2))
    whole, turned = stepped(scene, *given), stepped(scene, *(leaf[::-1] for leaf in given))
    alone = stepped(scene, *(leaf[:1] for leaf in given))
    still = stepped(scene, *given, still=jnp.array([True, False, False, True]))
    for leaf, backwards, first, kept in zip(whole, turned, alone, still, strict=True):
        np.testing.assert_array_equal(leaf, backwards[::-1])
        np.testing.assert_array_equal(leaf[:1], first)
        np.testing.assert_array_equal(leaf[1:3], kept[1:3])
    np.testing.assert_array_equal(still[0][[0, 3]], given[0][[0, 3]].astype(np.float32))


def test_whole_trials_are_those_of_mujoco() -> None:
    pytest.importorskip("warp", reason='warp-lang is not installed: pip install "rcbht-jax[warp]"')
    scenario = get_scenario("hooked-B")
    params, _ = scenario.draw_batch(0, range(4), DomainRandomization(longest=9.0))
    found, wanted = (engines.simulate(scenario.scene(), params, engine) for engine in ("fused", "native"))
    np.testing.assert_array_equal(found.length, wanted.length)
    np.testing.assert_array_equal(found.onset, wanted.onset)
    error = np.abs(found.wrench - wanted.wrench)[..., :3]
    assert np.median(error) < 0.005
    assert np.quantile(error, 0.99) < 0.05


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('<option integrator="Euler" cone="elliptic"/>', "Euler"),
        ('<option integrator="implicitfast"/>', "pyramidal"),
        ('<option integrator="implicitfast" cone="elliptic" density="1"/>', "fluids"),
    ],
)
def test_what_it_does_not_simulate_is_named(text: str, what: str) -> None:
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>")
    assert what in str(prepare.missing(model))


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("dof_frictionloss", 1.0, "friction"), ("actuator_ctrllimited", 1, "controls"), ("pair_dim", 1, "spheres"),
        ("geom_contype", 1, "pair"), ("jnt_actfrclimited", 1, "force"), ("pair_solreffriction", 0.1, "references"),
        ("actuator_biastype", mujoco.mjtBias.mjBIAS_MUSCLE, "affine"), ("jnt_type", mujoco.mjtJoint.mjJNT_FREE, "free"),
    ],
)  # fmt: skip
def test_fields_that_it_does_not_read_are_refused(name: str, value: float, what: str) -> None:
    scene = get_scenario("hooked-B").scene()
    assert prepare.missing(scene.model) is None
    getattr(scene.model, name)[0] = value
    assert what in str(prepare.missing(scene.model))
    with pytest.raises(InputError, match=r"The engine fused does not simulate .*; choose the engine warp or native\."):
        device.put_scene(replace(scene), 1, "fused")


def test_inertias_turn_with_their_principal_axes() -> None:
    quat, inertia = np.array([[0.5, -0.1, 0.7, 0.2]]), np.array([[0.1, 0.3, 0.35]])
    quat /= np.linalg.norm(quat)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quat[0])
    whole = turn.reshape(3, 3) @ np.diag(inertia[0]) @ turn.reshape(3, 3).T
    found = np.asarray(jax.jit(prepare._turned)(inertia[..., None], quat[..., None]))[0, :, 0]
    np.testing.assert_allclose(found, whole[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], rtol=1e-5)
