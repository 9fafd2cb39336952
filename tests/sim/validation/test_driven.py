"""The hand on a given path, parts identified from it, and derivatives through the physics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments._lib import driven_objective
from experiments._lib.driven_objective import DrivenObjective, DrivenTrial
from rcbht_jax.errors import InputError
from rcbht_jax.robots import kinematics
from rcbht_jax.types import Recordings
from sim_mjx.assembly import sensor
from sim_mjx.assembly.parts import TIP_HEIGHT
from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.scene import Scene, hooked
from sim_mjx.engines import native
from sim_mjx.presets import HOOKED
from sim_mjx.validation import gauss_newton, sensitivity, sessions
from sim_mjx.validation.driven import DrivenParams, driven, quicker_path
from sim_mjx.validation.system_id import Bound, Search

PRESET = HOOKED["hooked-B"]
TOUCH = 5.2  # s, when the nominal trial of this session touches
NAMES = {"parts.friction": 1e-4, "parts.mount_stiffness[2]": 1.0, "parts.position[2]": 1e-7}  # and steps


@pytest.fixture(scope="module")
def scene() -> Scene:
    return driven(hooked(4, impratio=PRESET.impratio))


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    """Of a nominal trial, around touch."""
    params = sessions.trials_of(PRESET, 1, seed=0)
    run = native.simulate(PRESET.scene(), replace(params, task=replace(params.task, timeout=np.full(1, TOUCH + 0.7))))
    return quicker_path(run.joints[0, : run.length[0]], TOUCH - 0.6, 1.2, 1.0)


def pressed(path: np.ndarray, **changed: np.ndarray) -> DrivenParams:
    return DrivenParams(replace(PRESET.parts, **changed), PRESET.sensor, path, np.array(len(path), np.int32))


def test_the_hand_follows_its_path_whatever_it_presses(scene: Scene, path: np.ndarray) -> None:
    soft = pressed(path, mount_stiffness=PRESET.parts.mount_stiffness / 4)
    run = native.simulate(scene, stack([pressed(path), soft]))
    assert not run.diverged.any()
    assert run.length.tolist() == [len(path)] * 2
    speed = np.abs(np.diff(path, axis=0)).max()
    for joints in run.joints:  # a servo is a control period late
        assert np.abs(joints[2:] - path[1:-1]).max() < speed + 1e-5
    np.testing.assert_allclose(run.joints[0], run.joints[1], atol=2e-5)  # though one part pushes back harder
    late = run.wrench[:, -20:, 2].mean(1)
    assert late[0] > 1.5 * late[1] > 1.0


def test_a_real_arm_yields(path: np.ndarray) -> None:
    runs = [
        native.simulate(driven(hooked(4, impratio=PRESET.impratio), heavier), stack([pressed(path)]))
        for heavier in (1.0, 1e3, 2e3)
    ]
    real, stiff, stiffer = (run.joints[0, -20:] for run in runs)
    assert np.abs(real - stiff).max() > 10 * np.abs(stiff - stiffer).max()
    assert np.abs(real - stiff).max() > 1e-5


def test_without_noise_and_steps_the_sensor_reads_exactly() -> None:
    params = replace(PRESET.sensor, step=np.full(6, 1e-9), noise=np.zeros(6))
    rng = np.random.default_rng(0)
    one = other = sensor.begin(params, jnp.asarray(rng.normal(size=6), jnp.float32))
    for raw in jnp.asarray(rng.normal(size=(30, 6)), jnp.float32):
        one, expected = sensor.read(params, one, raw, jnp.zeros(6), jnp.eye(3))
        other, found = sensor.read_exactly(params, other, raw, jnp.eye(3))
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_parts_are_found_again_from_the_wrench_that_they_gave(scene: Scene, path: np.ndarray) -> None:
    true = {"parts.mount_stiffness[2]": 9000.0, "hooked-B:parts.position[2]": 1.0e-3}
    seen = DrivenTrial("made", "hooked-B", path, np.zeros((len(path), 6)), 100)
    presets = {"hooked-B": PRESET}
    ((wrench,),) = DrivenObjective(scene, presets, (seen,)).simulate([true])
    objective = DrivenObjective(scene, presets, (replace(seen, wrench=wrench),))
    assert float((objective([true]) ** 2).sum()) < 1e-12
    np.testing.assert_allclose(driven_objective.explained(objective.trials[0], wrench), 1.0)
    bounds = {"parts.mount_stiffness[2]": Bound(3e3, 2e4, True), "hooked-B:parts.position[2]": Bound(0.0, 2.5e-3)}
    start = {"parts.mount_stiffness[2]": 5000.0, "hooked-B:parts.position[2]": 1.6e-3}
    found = gauss_newton.fit(objective, Search(bounds, start=start), iterations=12)
    for name, value in true.items():
        assert found.values[name] == pytest.approx(value, rel=0.02)
    assert found.candidates < 100


def test_a_trial_that_diverged_counts_as_lost(scene: Scene, path: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = DrivenTrial("made", "hooked-B", path, np.ones((len(path), 6)), 100)
    objective = DrivenObjective(scene, {"hooked-B": PRESET}, (seen,))
    run = native.simulate(scene, stack([pressed(path)]))
    monkeypatch.setattr(driven_objective.engines, "simulate", lambda *_: replace(run, diverged=np.array([True])))
    (residual,) = objective([{}])
    assert np.isfinite(residual).all()
    assert (residual**2).sum() == pytest.approx(driven_objective.LOST**2)


def test_where_the_hand_is_loaded_is_found_and_counts(path: np.ndarray) -> None:
    """A force at known points of the hand gives the moments that a sensor at its reference feels."""
    forward, left = np.linspace(-0.02, 0.02, len(path)), 0.01
    _, rotation, _ = jax.vmap(kinematics.fk)(path)
    force = np.array([14.0, 2.0, -3.0])  # N, along the hand, to the left and backwards
    reference = np.asarray(PRESET.sensor.reference)

    def wrench(forward: np.ndarray) -> np.ndarray:
        place = np.stack([np.full_like(forward, TIP_HEIGHT), np.full_like(forward, left), -forward], axis=1)
        felt = np.concatenate([np.tile(force, (len(path), 1)), np.cross(place - reference, force)], axis=1)
        return np.einsum("tij,thj->thi", rotation, felt.reshape(-1, 2, 3)).reshape(-1, 6)

    trial = DrivenTrial("pressed", "hooked-B", path, wrench(forward), 20)
    objective = DrivenObjective(hooked(4), {"hooked-B": PRESET}, (trial,), load_weight=0.8)
    found = objective.load_point(0, trial.wrench)
    np.testing.assert_allclose(found, np.stack([forward, np.full_like(forward, left)], axis=1), atol=1e-6)
    plain = replace(objective, load_weight=0.0)
    for moved, squares in ((0.0, 0.0), (0.01, 0.5), (1.0, 4.5)):  # 10 mm are a unit of one axis of two; three at most
        candidate = wrench(forward + moved)
        loads = (objective.residuals([candidate]) ** 2).sum() - (plain.residuals([candidate]) ** 2).sum()
        assert loads == pytest.approx(0.8 * squares, rel=1e-3, abs=1e-9)
    lifted = (objective.residuals([np.zeros_like(trial.wrench)]) ** 2).sum()  # it has no such place
    assert lifted - (plain.residuals([np.zeros_like(trial.wrench)]) ** 2).sum() == pytest.approx(0.8 * 9.0)


def test_recorded_trials_are_cut_around_contact(hiro_dir: Path, hiro_recordings: Recordings) -> None:
    rows = sessions.recorded_rows(hiro_recordings, "hooked-A")
    with_angles = driven_objective.rows_with_angles(hiro_dir, hiro_recordings, rows, HOOKED["hooked-A"])
    assert len(with_angles) == len(rows) - 1  # the angles of one are empty
    trial = driven_objective.driven_trial(hiro_dir, hiro_recordings, with_angles[0], "hooked-A", HOOKED["hooked-A"])
    assert len(trial.path) == len(trial.wrench)
    assert np.abs(trial.wrench[driven_objective.BASE].mean(0)).max() < 1e-9
    assert np.abs(trial.wrench[: trial.begin, 2]).max() < 2.0 < trial.wrench[trial.begin :, 2].max()


def test_fields_change_with_what_a_name_covers(scene: Scene) -> None:
    tangent = sensitivity.field_derivatives(scene, [PRESET.parts], "parts.mount_stiffness[2]", 1.0)
    moving = [name for name, value in tangent.items() if np.abs(value).max() > 0]
    assert moving == ["jnt_stiffness"]
    assert tangent["jnt_stiffness"].sum() == pytest.approx(1.0)
    assert sensitivity.moved(PRESET.parts, "parts.hook_overlap[2:4]", 1e-4).hook_overlap == pytest.approx(
        PRESET.parts.hook_overlap + np.array([0.0, 0.0, 1e-4, 1e-4])
    )
    with pytest.raises(InputError, match="no physical parameter"):
        sensitivity.field_derivatives(scene, [PRESET.parts], "parts.colour", 1.0)


def test_derivatives_are_traced_in_double_precision(path: np.ndarray) -> None:
    """The engine alone would go back to single precision."""
    loose = jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow")  # MJX is not strict
    with jax.enable_x64(True), loose[0], loose[1]:
        scene = sensitivity.smooth(driven(hooked(4, impratio=PRESET.impratio)))
        job = sensitivity._Job(scene, stack([pressed(path[60:])]), lambda wrench: jnp.mean(wrench, axis=1))
        assert jax.eval_shape(job.run, job.fixed.fields).dtype == np.float64


def test_forward_derivatives_are_central_differences(path: np.ndarray) -> None:
    scene = sensitivity.smooth(driven(hooked(4, impratio=PRESET.impratio)))
    one = pressed(path[60:])

    def means(wrench: jax.Array) -> jax.Array:
        return jnp.mean(wrench[:, 80:], axis=1)

    with (
        jax.enable_x64(True),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):  # MJX is not strict
        tangents = [sensitivity.field_derivatives(scene, [one.parts], name, by) for name, by in NAMES.items()]
        value, forward = sensitivity.wrench_and_derivatives(scene, stack([one]), tangents, means)
        ends = [
            replace(one, parts=sensitivity.moved(one.parts, name, sign * by))
            for name, by in NAMES.items() for sign in (1, -1)
        ]  # fmt: skip
        found = sensitivity.values(scene, stack([one, *ends]), means)
    np.testing.assert_allclose(found[0], value[0], rtol=1e-9)
    central = (found[1::2] - found[2::2]) / (2 * np.array(list(NAMES.values())))[:, None]
    assert np.abs(central).max(1).min() > 0  # each moves something
    np.testing.assert_allclose(forward[0].T, central, rtol=1e-2, atol=1e-9)
