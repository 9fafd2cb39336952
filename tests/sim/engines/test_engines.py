"""Engines: same trials, same wrenches, and no divergence that goes unnoticed."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from jaxtyping import Int
from mujoco import mjx

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx import engines
from sim_mjx.assembly.parts import from_lips, past_lips
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import one_arm
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device
from sim_mjx.engines import native as native_engine
from sim_mjx.engines.native import LANES
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.validation.engine_parity import FORCE_LIMIT, MOMENT_LIMIT, parity, reference
from sim_mjx.validation.solver_convergence import certify
from tests.support.plunger import plunger, plunger_trials

SCENE = one_arm()
SLOPE = """
<mujoco>
  <option timestep="0.00125" gravity="4 0 -9" cone="elliptic" impratio="{}" iterations="30" ls_iterations="20"/>
  <worldbody>
    <geom name="floor" type="box" size="1 1 .1" pos="0 0 -.1" contype="0" conaffinity="0"/>
    <body pos="0 0 .01">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 0 1"/>
      <geom name="tip" size=".01" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <contact><pair geom1="tip" geom2="floor" condim="3" friction="1 1 .005 .0001 .0001"/></contact>
</mujoco>
"""


def short_trials(count: int, longest: float = 2.4) -> TrialParams:
    """Session B's task with an approach of about a second, so that contact comes soon."""
    params, _ = get_scenario("B").draw_batch(0, range(count), DomainRandomization(nominal_share=1.0, longest=longest))
    return replace(params, task=replace(params.task, way_time=params.task.way_time / 4))


def take(params: TrialParams, rows: list[int]) -> TrialParams:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], params)


@pytest.fixture(scope="module")
def native() -> Rollouts:
    return engines.simulate(SCENE, short_trials(4), "native")


@pytest.fixture(scope="module")
def watched() -> tuple[Rollouts, Int[np.ndarray, " trial"]]:
    """The same trials, and the sample of each trial's first contact."""
    return reference(SCENE, short_trials(4))


def test_mjx_gives_the_wrench_of_native(
    native: Rollouts, watched: tuple[Rollouts, Int[np.ndarray, " trial"]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """C MuJoCo is the oracle; until the contact the wrench is equal, after it the course is."""
    monkeypatch.setattr(device, "LANES", 8)  # more than trials: batches are filled up
    params = short_trials(4)
    expected, contact = watched
    np.testing.assert_array_equal(expected.wrench, native.wrench)  # watching changes nothing
    assert (contact < expected.onset[:, 1] / CONTROL_PERIOD).all()
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        out = engines.simulate(SCENE, params, "mjx")
    found = parity(expected, contact, out)
    # labels are compared over whole trials by experiments/simulation/engines.py: in a short trial that is all contact,
    # a last digit that flips the sensor's quantisation weighs too much
    assert found.force_until_contact <= FORCE_LIMIT
    assert found.moment_until_contact <= MOMENT_LIMIT
    assert (found.states, found.same_outcome) == (1.0, 1.0)
    assert (found.trials, found.touched, found.diverged) == (4, 4, 0)
    np.testing.assert_array_equal(out.length, expected.length)
    np.testing.assert_allclose(out.onset[:, :2], expected.onset[:, :2], atol=1.5 * CONTROL_PERIOD)
    peaks = np.abs(expected.wrench[..., 2]).max(1)
    assert (peaks > 5).all()
    np.testing.assert_allclose(np.abs(out.wrench[..., 2]).max(1), peaks, rtol=0.1)


def test_parity_sees_what_differs(native: Rollouts, watched: tuple[Rollouts, Int[np.ndarray, " trial"]]) -> None:
    _, contact = watched
    wrench = native.wrench.copy()
    wrench[2, contact[2] - 1, 1] += 0.06
    assert not parity(native, contact, replace(native, wrench=wrench)).holds
    wrench = native.wrench.copy()
    wrench[2, contact[2] + 1, 1] += 0.06
    assert parity(native, contact, replace(native, wrench=wrench)).holds
    seated = native.seated.copy()
    seated[0] = ~native.seated[0].all()
    assert not parity(native, contact, replace(native, seated=seated)).holds
    wrench = native.wrench + np.where(np.arange(native.wrench.shape[1]) >= 300, 1.0, 0.0)[None, :, None]
    wrench = wrench.astype(np.float32) * (1 + np.arange(native.wrench.shape[1], dtype=np.float32) % 7)[None, :, None]
    assert min(parity(native, contact, replace(native, wrench=wrench)).labels.values()) < 0.9


def test_lanes_are_refilled_without_a_trace() -> None:
    count = LANES + 7
    params, _ = get_scenario("A").draw_batch(3, range(count), DomainRandomization(longest=0.2))
    timeout = 0.05 + 0.005 * (np.arange(count) * 13 % 30)
    params = replace(params, task=replace(params.task, timeout=timeout))
    out = engines.simulate(SCENE, params, "native")
    np.testing.assert_array_equal(out.length, np.round(timeout / CONTROL_PERIOD) + 1)
    for row in (0, LANES - 1, LANES, count - 1, int(timeout.argmin())):
        alone = engines.simulate(SCENE, take(params, [row]), "native")
        np.testing.assert_array_equal(alone.wrench[0], out.wrench[row, : out.length[row]])
        np.testing.assert_array_equal(alone.joints[0], out.joints[row, : out.length[row]])


def test_another_number_of_trials_compiles_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """It compiled two programs for each shape of a parameter, which only copied rows."""
    engines.simulate(SCENE, short_trials(1, longest=0.05), "native")
    params = short_trials(5, longest=0.05)
    with jax.log_compiles():
        engines.simulate(SCENE, params, "native")
    assert "Compiling" not in caplog.text


def test_an_error_in_a_thread_ends_the_simulation() -> None:
    def watch(*_: np.ndarray) -> None:
        raise RuntimeError("seen")

    with pytest.raises(RuntimeError, match="seen"):
        native_engine.simulate(SCENE, short_trials(LANES + 1, longest=30.0), watch=watch)


def test_a_trial_does_not_depend_on_the_others(native: Rollouts) -> None:
    longer = short_trials(4)
    timeout = np.array([1.0, 2.4, 2.4, 1.4])
    mixed = engines.simulate(SCENE, replace(longer, task=replace(longer.task, timeout=timeout)), "native")
    for row in (1, 2):
        for name in ("wrench", "joints", "onset", "seated", "length"):
            np.testing.assert_array_equal(getattr(mixed, name)[row], getattr(native, name)[row])
    alone = engines.simulate(SCENE, take(longer, [0, 0, 0, 0]), "native")
    np.testing.assert_array_equal(alone.wrench[0, : mixed.length[0]], mixed.wrench[0, : mixed.length[0]])
    assert (mixed.wrench[0, mixed.length[0] :] == 0).all()


def test_divergence_is_marked_and_not_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    params = short_trials(2, longest=0.3)
    stiffness = params.parts.tab_stiffness.copy()
    stiffness[1] = 1e12
    damping = params.parts.tab_damping.copy()
    damping[1] = 0.0
    params = replace(params, parts=replace(params.parts, tab_stiffness=stiffness, tab_damping=damping))
    out = engines.simulate(SCENE, params, "native")
    assert out.diverged.tolist() == [False, True]
    assert np.isfinite(out.wrench).all()
    assert np.abs(out.wrench[0]).max() > 0
    assert (out.wrench[1] == 0).all()
    assert not out.seated[1].any()
    # MuJoCo would print its warnings, and write them into a file of the folder
    assert (list(tmp_path.iterdir()), capfd.readouterr()) == ([], ("", ""))
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    engines.simulate(SCENE, params, "native")  # a program's own handler stays
    mujoco.set_mju_user_warning(None)
    assert heard


@pytest.mark.parametrize("speed", [np.nan, np.inf, 1e30])
def test_a_command_that_is_no_number_is_a_divergence(speed: float) -> None:
    params = plunger_trials(np.full(2, 0.1))
    params = replace(params, speed=np.array([params.speed[0], speed]))
    out = native_engine.simulate(plunger(), params)
    assert out.diverged.tolist() == [False, True]  # MuJoCo would go on towards zero
    assert (out.wrench[1] == 0).all()


def test_unknown_engines_are_refused() -> None:
    with pytest.raises(InputError, match="native, mjx, warp"):
        engines.simulate(SCENE, short_trials(1), "bullet")


def test_engines_are_imported_when_used() -> None:
    code = "import sys, sim_mjx.engines; sys.exit('mujoco.mjx' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_tab_is_past_its_lip_only_beneath_and_near_it() -> None:
    lip, turn = np.array([0.3, 0.0, 0.4]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.004], [0.0, 0.01, 0.0], [0.008, 0.0, 0.0], [0.0, 0.006, 0.0]])
    # in the lip's turned frame: the world's y is its x, the world's -x its y
    found = past_lips(from_lips(lip + places, np.broadcast_to(lip, (5, 3)), np.broadcast_to(turn, (5, 3, 3))))
    assert found.tolist() == [True, False, False, False, True]


def test_production_settings_are_converged_and_a_few_iterations_are_not() -> None:
    params = short_trials(4)
    good = certify(params, one_arm)
    assert good.converged
    assert good.path.force <= 0.05
    assert good.path.moment <= 0.005
    assert (good.trials, good.same_onsets, good.same_outcome) == (4, 1.0, 1.0)
    bad = certify(params, one_arm, settings=(2, 4))
    assert not bad.converged
    assert bad.step.time > 0.5  # not before the contact


def crept(impratio: float) -> tuple[float, float]:
    """m, by which a sphere creeps in a quarter of a second down a slope that holds it; C MuJoCo and MJX."""
    model, steps = mujoco.MjModel.from_xml_string(SLOPE.format(impratio)), 400
    data, on_device = mujoco.MjData(model), mjx.put_model(model)
    mujoco.mj_step(model, data, steps // 2)
    settled = data.qpos[0]
    mujoco.mj_step(model, data, steps // 2)

    def step(at: mjx.Data, _: None) -> tuple[mjx.Data, Array]:
        after = mjx.step(on_device, at)
        return after, after.qpos[0]

    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        _, path = jax.jit(lambda start: jax.lax.scan(step, start, length=steps))(mjx.make_data(model))
    return float(data.qpos[0] - settled), float(path[-1] - path[steps // 2 - 1])


def test_a_larger_impratio_makes_contacts_creep_less_in_mjx_too() -> None:
    (native_often, mjx_often), (native_seldom, mjx_seldom) = crept(1.0), crept(10.0)
    assert native_often == pytest.approx(10 * native_seldom, rel=0.01)
    assert mjx_often == pytest.approx(native_often, rel=0.01)
    assert mjx_seldom == pytest.approx(native_seldom, rel=0.1)  # a hundredth of a millimetre in single precision


def test_mjx_prints_nothing_where_results_are_printed() -> None:
    """Without Warp, MJX says so on standard output as it is imported."""
    code = "import sys; sys.modules['warp'] = None; import sim_mjx.env; import sim_mjx.engines.device"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == ""
