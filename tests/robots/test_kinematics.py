"""The arms' kinematics against MuJoCo, itself and the recordings; the approach against the recordings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from rcbht_jax._util.compiling import compiler_options
from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro import dat
from rcbht_jax.robots import hiro, kinematics
from sim_mjx.assembly import robot
from sim_mjx.assembly.controllers import approach, half_cosine
from sim_mjx.presets import preset

SESSIONS = {
    "A": "REAL_HIRO_ONE_SA_SUCCESS",
    "B": "REAL_HIRO_ONE_SA_SUCCESS",
    "C": "REAL_HIRO_ONE_SA_ERROR_CHARAC",
    "openhrp": "SIM_HIRO_ONE_SA_SUCCESS",
}
# Joint angles that contain every recorded one, with room.
WORKSPACE = np.array([[-0.6, 0.8], [-0.8, 0.4], [-2.6, -1.2], [-0.5, 0.8], [-0.2, 1.2], [-0.8, 0.8]])


def workspace(n: int = 2000) -> np.ndarray:
    return np.random.default_rng(3).uniform(WORKSPACE[:, 0], WORKSPACE[:, 1], (n, 6))


def home(session: str) -> np.ndarray:
    return np.asarray(preset(session).task.home, float)


def recorded(hiro_dir: Path, session: str) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, joint angles [n, 6] and TCP poses [n, 6] of each approach, up to shortly before contact."""
    for folder in sorted((hiro_dir / SESSIONS[session]).iterdir()):
        number = int(folder.name.split("-")[-1]) if session in "AB" else 0
        # The 2012 simulation has another base height.
        if (session == "A" and number > 21) or (session == "B" and number < 22) or "20120426" in folder.name:
            continue
        try:
            angles = dat.read_timed(folder / "R_Angles.dat", "joint angles").values
            pose = dat.read_timed(folder / "R_CartPos.dat", "pose").values
        except InputError:
            continue
        if session == "C":
            angles = angles - np.array([0, 0, 0, 0, 0, preset(session).last_joint_offset])
        # Commanded angles come with the pose of the tick before; session A's are the encoders'.
        delay = 0 if session == "A" else 1
        # ERROR-14's state file misses its contact at 3.325 s.
        contact = 3.325 if folder.name.endswith("ERROR-14") else dat.read_state_times(folder / "R_State.dat")[1]
        n = round(contact / 0.005) - 5
        yield folder.name, angles[: n - delay], pose[delay:n]


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle [n] (degrees) between rotations [n, 3, 3]."""
    turn = a.swapaxes(1, 2) @ b
    axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]])
    return np.rad2deg(np.arcsin(np.linalg.norm(axis, axis=0) / 2))


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize("arm", ["R", "L"])
def test_mujoco_agrees(arm: str) -> None:
    model = robot.new_robot((arm,)).compile()
    data = mujoco.MjData(model)
    site = model.site(f"{arm}ARM_FT").id
    for q in np.random.default_rng(0).uniform(-3, 3, (20, 6)):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        wrist, rotation, tcp = kinematics.fk(q, arm)
        np.testing.assert_allclose(data.site_xpos[site], wrist, atol=1e-12)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3), rotation, atol=1e-12)
        np.testing.assert_allclose(data.site(f"{arm}ARM_TCP").xpos, tcp, atol=1e-12)
        linear, angular = np.zeros((2, 3, 6))
        mujoco.mj_jacSite(model, data, linear, angular, site)
        np.testing.assert_allclose(kinematics.jacobian(q, arm)[0], linear, atol=1e-12)
        np.testing.assert_allclose(kinematics.jacobian(q, arm)[1], angular, atol=1e-12)


def test_jacobian_is_the_derivative() -> None:
    q, step = workspace(20), 1e-6
    linear, angular = kinematics.jacobian(q)
    turn = kinematics.fk(q)[1]
    for joint in range(6):
        (ahead, turned, _), (behind, unturned, _) = (
            kinematics.fk(q + sign * step * np.eye(6)[joint]) for sign in (1, -1)
        )
        np.testing.assert_allclose(linear[..., joint], (ahead - behind) / (2 * step), atol=1e-8)
        spin = (turned - unturned) / (2 * step) @ turn.swapaxes(1, 2)
        rate = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
        np.testing.assert_allclose(angular[..., joint], rate, atol=1e-8)


@pytest.mark.parametrize("arm", ["R", "L"])
def test_inverse_returns_the_angles(arm: str) -> None:
    q = workspace()
    start = np.broadcast_to(home("A"), q.shape)
    if arm == "L":
        q, start = q * hiro.MIRROR, start * np.array(hiro.MIRROR)
    _, rotation, tcp = kinematics.fk(q, arm)
    np.testing.assert_allclose(kinematics.ik(tcp, rotation, start, arm), q, atol=1e-9)


def test_inverse_in_single_precision_under_jit_and_vmap() -> None:
    q = workspace()
    _, rotation, tcp = kinematics.fk(q)
    near = np.broadcast_to(home("A"), q.shape)
    solve = jax.jit(jax.vmap(kinematics.ik), compiler_options=compiler_options("cpu"))
    found = np.asarray(solve(*(jnp.asarray(x, jnp.float32) for x in (tcp, rotation, near))))
    assert found.dtype == np.float32
    _, turned, reached = kinematics.fk(found.astype(float))
    assert np.abs(reached - tcp).max() < 2e-6
    assert np.abs(turned - rotation).max() < 2e-6


def test_inverse_does_not_extrapolate_rounding() -> None:
    """Of 100,000 trials 37 had one command that was no number: a search that had converged left its solution."""
    start = np.full(49, 0.5, np.float32)
    digit = np.spacing(start)
    first, finer = np.meshgrid(np.arange(-3, 4), np.arange(-3, 4) / 16)  # of small angles digits are finer
    once = (start + first.ravel() * digit).astype(np.float32)
    twice = once + ((first + finer).ravel() * digit).astype(np.float64)
    found = kinematics._accelerated(start, once, twice)
    assert np.abs(found - twice).max() < 32 * digit[0]


@pytest.mark.parametrize(
    "q",
    [
        [2.6, 0.4, 0.5, 0.26, 0.73, 0.0],  # upper arm and forearm behind the shoulder
        [0.12, -0.14, 1.2, 0.26, 0.73, 0.0],  # elbow the other way
        [0.12, -0.14, -1.9, -2.24, 2.6, -2.2],  # wrist flipped
    ],
    ids=["behind", "elbow", "wrist"],
)
def test_near_angles_choose_the_solution(q: list[float]) -> None:
    _, rotation, tcp = kinematics.fk(np.array(q))
    near = np.array(q) + np.random.default_rng(5).uniform(-0.05, 0.05, 6)
    np.testing.assert_allclose(kinematics.ik(tcp, rotation, near), q, atol=1e-9)


def test_out_of_reach_is_nan() -> None:
    _, rotation, tcp = kinematics.fk(home("A"))
    far = np.stack([tcp, tcp + np.array([0.5, 0, 0]), tcp])
    found = kinematics.ik(far, np.stack([rotation] * 3), np.stack([home("A")] * 3))
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(found[[0, 2]], [home("A")] * 2, atol=1e-12)


def test_roll_pitch_yaw() -> None:
    rpy = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 3))
    turn = kinematics.rotation_from_rpy(rpy)
    np.testing.assert_allclose(kinematics.rpy_from_rotation(turn), rpy, atol=1e-12)
    product = np.eye(3)
    for axis, angle in zip(np.eye(3), rpy[0], strict=True):  # roll first, seen in the world
        quaternion, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
        mujoco.mju_quat2Mat(matrix, quaternion)
        product = matrix.reshape(3, 3) @ product
    np.testing.assert_allclose(turn[0], product, atol=1e-12)


def test_tilt_at_contact() -> None:
    for session, degrees in (("A", 16.8), ("B", 16.8), ("C", 11.0), ("openhrp", 11.0)):
        rotation = kinematics.rotation_from_rpy(np.asarray(preset(session).task.way_rpy)[-1])
        assert np.rad2deg(kinematics.tilt(rotation)) == pytest.approx(degrees, abs=0.06)


@pytest.mark.parametrize(
    ("session", "position", "rpy"),
    [
        ("A", (0.3383, -0.1497, 0.5397), (0.1045, -1.3122, -0.0961)),
        ("C", (0.2968, -0.1787, 0.6478), None),
    ],
)
def test_recorded_home_poses(session: str, position: tuple[float, ...], rpy: tuple[float, ...] | None) -> None:
    _, rotation, tcp = kinematics.fk(home(session))
    np.testing.assert_allclose(tcp, position, atol=6e-5)
    if rpy:
        np.testing.assert_allclose(kinematics.rpy_from_rotation(rotation), rpy, atol=2e-4)


@pytest.mark.parametrize(
    ("session", "millimetres", "degrees", "trials"),
    # Session A records encoder angles beside commanded poses, hence the larger distance.
    [("A", 0.3, 0.037, 15), ("B", 0.01, 0.002, 19), ("C", 0.01, 0.002, 9), ("openhrp", 0.01, 0.002, 25)],
)
def test_recorded_angles_give_the_recorded_pose(
    hiro_dir: Path, session: str, millimetres: float, degrees: float, trials: int
) -> None:
    seen = 0
    for name, q, pose in recorded(hiro_dir, session):
        _, rotation, tcp = kinematics.fk(q)
        seen += 1
        assert rms(np.linalg.norm(tcp - pose[:, :3], axis=1)) <= millimetres * 1e-3, name
        assert rms(angle_between(rotation, kinematics.rotation_from_rpy(pose[:, 3:]))) <= degrees, name
        # All recorded angles come back from their pose, whichever solution is near: the home pose's.
        near = np.broadcast_to(home(session), q.shape)
        np.testing.assert_allclose(kinematics.ik(tcp, rotation, near), q, atol=1e-9)
    assert seen >= trials


@pytest.mark.parametrize(
    ("session", "lag", "milliradians", "millimetres"),
    # Session A's encoders follow four control periods later; the others' angles are commands.
    [("A", 4, 0.36, 0.6), ("B", 0, 0.35, 0.1), ("C", 0, 0.60, 0.4), ("openhrp", 1, 0.40, 0.15)],
)
def test_waypoints_reproduce_the_recorded_approach(
    hiro_dir: Path, session: str, lag: int, milliradians: float, millimetres: float
) -> None:
    task = preset(session).task
    for name, q, pose in recorded(hiro_dir, session):
        t = (np.arange(len(q)) - lag) * 0.005
        way = np.array(task.way_position, float)
        if session == "B":  # each trial has its own offset, in whole millimetres
            x, y, z = pose[-1, :3]
            way[:, :2] += np.round([x - 0.311 - 20 / 11 * (0.495 - z), y + 0.1726], 3)
        rebuilt = approach(home(session), task.way_time, way, task.way_rpy, t)
        assert rms(rebuilt - q) <= milliradians * 1e-3, name
        assert np.abs(kinematics.fk(rebuilt)[2] - kinematics.fk(q)[2]).max() <= millimetres * 1e-3, name


def test_half_cosine() -> None:
    times, poses = np.array([0.0, 2.0, 3.0]), np.array([[0.0, 1.0], [4.0, 1.0], [4.0, -1.0]])
    t = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 9.0])
    expected = [[0, 1], [0, 1], [2 - 2**0.5, 1], [2, 1], [4, 1], [4, 0], [4, -1], [4, -1]]
    np.testing.assert_allclose(half_cosine(times, poses, t), expected, atol=1e-12)
    np.testing.assert_allclose(half_cosine(times, poses, np.array(0.5)), expected[2], atol=1e-12)


def test_approach_of_a_batch_under_jit() -> None:
    task = preset("B").task
    fields = [jnp.asarray(x, jnp.float32) for x in (task.home, task.way_time, task.way_position, task.way_rpy)]
    shifted = fields[2][None] + jnp.asarray([[[0.0, 0.0, 0.0]], [[0.002, -0.002, 0.0]]], jnp.float32)
    t = jnp.arange(0, 6, 0.5, dtype=jnp.float32)
    batch = jax.jit(jax.vmap(approach, in_axes=(None, None, 0, None, None)))(
        fields[0], fields[1], shifted, fields[3], t
    )
    way = np.array(task.way_position, float) + np.array([0.002, -0.002, 0.0])
    expected = approach(home("B"), task.way_time, way, task.way_rpy, np.asarray(t, float))
    np.testing.assert_allclose(batch[1], expected, atol=1e-5)


def test_unknown_arm() -> None:
    with pytest.raises(InputError, match='expected "R" or "L"'):
        kinematics.fk(np.zeros(6), "X")


def test_session_c_needs_its_tool_offset(hiro_dir: Path) -> None:
    folder = hiro_dir / SESSIONS["C"] / "20160930-HIRO_ERROR-06"
    angles = dat.read_timed(folder / "R_Angles.dat", "joint angles").values[:600]
    pose = dat.read_timed(folder / "R_CartPos.dat", "pose").values[1:601]
    assert rms(np.linalg.norm(kinematics.fk(angles)[2] - pose[:, :3], axis=1)) > 0.005


def test_left_arm_is_the_mirror_image() -> None:
    q = workspace(20)
    (_, turned_right, right), (_, turned_left, left) = kinematics.fk(q, "R"), kinematics.fk(q * hiro.MIRROR, "L")
    flip = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(left, right @ flip, atol=1e-12)
    np.testing.assert_allclose(turned_left, flip @ turned_right @ flip, atol=1e-12)


def test_tilt_is_the_distance_of_pitch_from_hand_down() -> None:
    rpy = np.array([[0.3, -np.pi / 2, 0.1], [0.0, -1.2784, 0.0], [0.0, -1.3782, 1.0]])
    tilt = np.degrees(kinematics.tilt(kinematics.rotation_from_rpy(rpy)))
    np.testing.assert_allclose(tilt, [0.0, 16.75, 11.03], atol=0.01)


def test_last_joint_does_not_change_the_tilt() -> None:
    q = np.tile([0.12, -0.13, -1.89, 0.26, 0.72, 0.0], (5, 1))
    q[:, 5] = np.linspace(-1, 1, 5)
    tilt = kinematics.tilt(kinematics.fk(q)[1])
    np.testing.assert_allclose(tilt, tilt[0], atol=1e-9)
