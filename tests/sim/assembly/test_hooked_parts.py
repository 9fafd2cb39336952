"""Hooks in the scene: they catch, they hold, and worn or broken ones do not."""

from __future__ import annotations

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.assembly import hooked_parts, parts
from sim_mjx.assembly.hooked_parts import HOOK, HookedParams, caught
from sim_mjx.assembly.rollout import Rollouts, stack
from sim_mjx.assembly.scene import Scene, hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets import HOOKED, ONE_ARM, PRESETS
from sim_mjx.presets.session import SessionPreset
from sim_mjx.randomization import overrides, trials
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.passes import passes_of
from sim_mjx.validation import sessions, snaps
from sim_mjx.validation.replay import Recorder, raw_force

HOOKED_B = HOOKED["hooked-B"]
PULL, HELD_FOR = 20.0, 0.5  # N on the female part, away from the hand; s


def run_of(session: SessionPreset, *changes: dict[str, np.ndarray]) -> tuple[Scene, Rollouts, Recorder, list]:
    """Nominal placements of a session with changed parts; their motions, and the parts."""
    one = jax.tree.map(lambda leaf: leaf[0], sessions.trials_of(session, 1, longest=9.0))
    drawn = [replace(one, parts=replace(one.parts, **change)) for change in changes]
    scene, batch = session.scene(), stack(drawn)
    recorder = Recorder(scene, len(drawn))
    run = native.simulate(scene, batch, watch=recorder.watch)
    return scene, run, recorder, [each.parts for each in drawn]


@pytest.fixture(scope="module")
def pressed() -> tuple[Scene, Rollouts, Recorder, list]:
    gone, worn = np.array([0.0, 0.0, 0.02, 0.0]), np.array([0.0, 0.0, 0.0, 1.0e-3])
    blocked = {"seat_depth": HOOKED_B.parts.seat_depth - 1e-3}
    return run_of(HOOKED_B, {}, {"tab_cut": gone}, {"hook_wear": worn}, blocked)


def test_whole_hooks_catch_and_others_do_not(pressed: tuple) -> None:
    _, run, _, _ = pressed
    assert not run.diverged.any()
    np.testing.assert_array_equal(run.seated[0], True)
    assert not run.seated[1, 2]  # broken off at its root
    assert run.seated[1, [1, 3]].all()  # the left ones; the right front one, whose side has no rear one, does not pass
    assert not run.seated[2, 3]  # a head that is rubbed off reaches beneath nothing


def after_a_pull(scene: Scene, qpos: np.ndarray, part: object) -> np.ndarray:
    """Which tabs are in after the female part was pulled away from a hand that keeps still."""
    model = native.model_of(scene, part)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = qpos, qpos[scene.joints]
    data.xfrc_applied[model.body("MOUNT").id, 2] = -PULL
    mujoco.mj_step(model, data, round(HELD_FOR / model.opt.timestep))
    mujoco.mj_kinematics(model, data)
    return native.seated_tabs(scene, data)


def test_caught_hooks_hold_where_blocks_that_rub_let_go(pressed: tuple) -> None:
    scene, _, recorder, part = pressed
    last = recorder.qpos(0)[-1]
    assert after_a_pull(scene, last, part[0]).all()
    no_lips = replace(part[0], tab_cut=np.full(4, 0.02))
    assert not after_a_pull(scene, last, no_lips).any()


def test_beneath_is_not_beside_nor_below_the_floor() -> None:
    radius = HOOK.tip_radius
    places = np.array(
        [[0.0, 0.0, -1e-4], [0.0, 0.0, 1e-4], [-radius * 1.01, 0.0, -1e-4], [0.0, 5e-3, -1e-4], [0.0, 0.0, -0.013]]
    )
    np.testing.assert_array_equal(caught(places), [True, False, False, False, False])
    half_turn, zero = np.diag([-1.0, -1.0, 1.0]), np.zeros_like(places)
    local = parts.from_lips(places @ half_turn.T, zero, np.broadcast_to(half_turn, (5, 3, 3)))
    np.testing.assert_array_equal(local, places)


def test_tips_meet_the_lead_in_at_first_touch() -> None:
    """At its nominal height a tip touches its lip, a tenth of a millimetre higher it does not."""
    scene = hooked()
    still = replace(HOOKED_B.parts, position=np.zeros(3), roll=np.array(0.0), rear_rise=np.zeros(2))
    model = native.model_of(scene, still)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for tab, edge in zip(scene.tips, scene.lips, strict=True):
        name = model.geom(tab).name.removeprefix("RTIP_")
        lead, turn = model.geom(f"LIP_{name}"), data.geom(f"EDGE_{name}").xmat.reshape(3, 3)
        overlap = still.hook_overlap[parts.TABS.index(name)]
        touch = data.geom_xpos[edge] + turn @ [overlap - HOOK.tip_radius, 0.0, 0.0]
        for above, meets in ((1e-5, True), (1e-4, False)):
            tip = touch + np.array(
                [0.0, 0.0, hooked_parts.first_touch(HOOK, overlap) - 2e-5 * meets + above * (not meets)]
            )
            inside = data.geom_xmat[lead.id].reshape(3, 3).T @ (tip - data.geom_xpos[lead.id])
            outside = np.maximum(np.abs(inside) - model.geom_size[lead.id], 0.0)
            assert (np.linalg.norm(outside) < HOOK.tip_radius) == meets


def test_faults_are_geometry() -> None:
    spec = DomainRandomization(nominal_share=0.0, faults=("missing-tab",))
    params = [trials.sample(HOOKED_B, 0, index, spec)[0].parts for index in range(16)]
    assert all((part.tab_cut > 0.01).sum() == 1 and (part.hook_overlap > 0).all() for part in params)
    jammed, _ = trials.sample(HOOKED_B, 0, 0, DomainRandomization(nominal_share=0.0, faults=("jamming",)))
    assert isinstance(jammed.parts, HookedParams)
    assert (jammed.parts.hook_overlap > 1.6e-3).all()


def test_a_tip_too_wide_for_its_lip_is_refused() -> None:
    part = replace(HOOKED_B.parts, hook_overlap=np.full(4, 3e-3))
    with pytest.raises(InputError, match=r"2\.8 mm"):
        parts.check(part)
    with pytest.raises(InputError, match="hook_overlap must be positive"):
        parts.check(replace(HOOKED_B.parts, hook_overlap=np.full(4, -1e-4)))


def test_one_part_in_three_sessions() -> None:
    own = {"mount_stiffness", "mount_damping", "position", "roll", "tilt"}
    first = HOOKED["hooked-A"].parts
    for name in ("hooked-B", "hooked-C"):
        for field in first.__dataclass_fields__.keys() - own:
            np.testing.assert_array_equal(getattr(HOOKED[name].parts, field), getattr(first, field))
    assert get_scenario("hooked-A").scene().substeps == 8


def test_the_part_is_turned_about_the_vertical_and_then_tilted() -> None:
    part = replace(HOOKED_B.parts, roll=np.array(0.3), tilt=np.array([0.02, -0.05]))
    scene = HOOKED_B.scene()
    found = hooked_parts.model_fields(scene.model, part)["body_quat"][scene.model.body("MOUNT").id]
    expected = np.zeros(4)
    yaw, tilt = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(yaw, np.array([0.0, 0.0, 1.0]), 0.3)
    mujoco.mju_axisAngle2Quat(tilt, np.array([0.02, -0.05, 0.0]) / np.hypot(0.02, 0.05), np.hypot(0.02, 0.05))
    mujoco.mju_mulQuat(expected, yaw, tilt)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_friction_and_lips_hold_as_the_preset_and_the_part_say() -> None:
    held = replace(HOOKED_B.parts, lip_impedance=np.array([0.97, 0.97, 0.99, 0.99]))
    scene = replace(HOOKED_B, impratio=10.0, parts=held).scene()
    assert scene.model.opt.impratio == 10.0
    assert get_scenario("hooked-B").scene().model.opt.impratio == HOOKED_B.impratio == 3.0
    assert get_scenario("B").scene().model.opt.impratio == 1.0
    model = native.model_of(scene, held)
    front, rear = (model.pair(f"RTIP_{tab}:LIP_{tab}").solimp[:2] for tab in ("FR", "RR"))
    np.testing.assert_allclose([front, rear], [[0.97, 0.99], [0.99, 0.99667]], atol=1e-5)


def test_a_tilted_hand_stands_on_its_rim_before_its_hooks_are_beneath_their_lips() -> None:
    model = hooked().model
    places = {
        reach: hooked_parts.model_fields(model, replace(HOOKED_B.parts, foot_reach=np.array(reach)))["geom_pos"]
        for reach in (0.0, 2e-3)
    }
    moved = places[2e-3] - places[0.0]  # in the wrist's frame z points backwards
    feet = {name: moved[model.geom(f"RFOOT_{name}").id, 2] for name in parts.TABS}
    assert feet == pytest.approx({"FR": -2e-3, "FL": -2e-3, "RR": 2e-3, "RL": 2e-3})
    others = [geom for geom in range(model.ngeom) if "FOOT" not in model.geom(geom).name]
    assert not moved[others].any()


def test_only_hooks_have_wear() -> None:
    assert overrides.apply_overrides(HOOKED_B.parts, "parts", (("parts.hook_wear[1]", 1e-4),)).hook_wear[1] == 1e-4
    with pytest.raises(InputError, match="only those with hooks"):
        overrides.apply_overrides(ONE_ARM["B"].parts, "parts", (("parts.hook_wear", 1e-4),))


def test_only_rigid_contacts_have_an_offset_of_the_sensor() -> None:
    rigid, sensor = PRESETS["rigid-openhrp"].sensor, ONE_ARM["B"].sensor
    assert overrides.apply_overrides(rigid, "sensor", (("sensor.offset[2]", 1.0),)).offset[2] == 1.0
    with pytest.raises(InputError, match="only that of rigid-openhrp"):
        overrides.apply_overrides(sensor, "sensor", (("sensor.offset", 1.0),))
    with pytest.raises(InputError, match="only that of rigid-openhrp"):
        overrides.value(ONE_ARM["B"].parts, sensor, "sensor.jitter")


def test_rear_hooks_snap_unless_the_seat_holds_the_hand_up(pressed: tuple) -> None:
    """Pressed in mating, both give way at once; on a seat 1 mm higher the feet carry the hand."""
    _, run, recorder, _ = pressed
    rear = np.array([start for tab, start, end in passes_of(run.past, run.length)[0].tolist() if end and tab >= 2])
    assert len(rear) == 2
    assert np.ptp(rear) <= snaps.FALL
    free, blocked = (snaps.find(raw_force(recorder, run, row)[:, 2], float(run.onset[row, 1])) for row in (0, 3))
    last = free[-1]
    assert last.drop > snaps.DROP[0]
    assert last.time > run.onset[0, 3]
    begun = round(last.time / CONTROL_PERIOD)
    assert 0 <= rear[0] - begun <= 3 * snaps.FALL  # as far as a fall is looked for
    assert not blocked


def test_time_to_mating_is_the_recorded(pressed: tuple) -> None:
    _, run, _, _ = pressed
    assert abs(run.onset[0, 3] - HOOKED_B.mating_begins) < 0.6
    assert run.length[0] * CONTROL_PERIOD < run.onset[0, 3] + 9.1
