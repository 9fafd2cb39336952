"""Forward kinematics of the HIRO arms, from the identified kinematic table of the recordings.

World frame: the robot's base, x forward, y left, z up; the waist is 0.45 m above the floor and the chest
does not turn. Lengths in metres, angles in radians unless a name says degrees.
Source: the residual table of the data audit (0.001 mm rms on the simulated, 0.006 mm on the real approaches).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

WAIST_HEIGHT = 0.450
SHOULDER_ROLL = np.deg2rad(15.0)
JOINT_AXES = "zyyzyx"
# Parent-to-joint translations of the right arm, row per joint; the left arm has the opposite y.
JOINT_OFFSETS = np.array(
    [
        [0.0, -0.150, 0.355 + WAIST_HEIGHT],
        [0.0, 0.0, 0.0],
        [0.0, -0.080, -0.250],
        [-0.020, 0.0, 0.0],
        [0.0, 0.0, -0.230],
        [-0.0190, 0.0, -0.0800],
    ]
)
TCP_IN_WRIST = np.array([-0.0510, 0.0020, -0.0225])
# The real failure session logs the last joint with the 30.43 degree mounting angle of its tool.
FAILURE_SESSION_Q5_OFFSET = 0.531117

Floats = NDArray[np.float64]


def rotation(axis: str, angle: Floats) -> Floats:
    """Rotation matrices [n, 3, 3] about one coordinate axis ("x", "y" or "z") by angles [n] (rad)."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    out = np.zeros((len(angle), 3, 3))
    out[:, i, i] = 1.0
    out[:, j, j] = out[:, k, k] = np.cos(angle)
    out[:, k, j] = np.sin(angle)
    out[:, j, k] = -np.sin(angle)
    return out


def wrist_pose(q: Floats, arm: str = "R") -> tuple[Floats, Floats]:
    """Pose of the wrist (last joint's) frame in the world.

    Args:
        q: joint angles [n, 6], rad, in file order (the mounting offset of the failure session removed).
        arm: "R" or "L"; the left arm is the right one mirrored in the x-z plane.

    Returns:
        position [n, 3] in metres and rotation [n, 3, 3] whose columns are the wrist's axes.

    Raises:
        InputError: the angles are not [n, 6] or the arm is neither "R" nor "L".
    """
    if q.ndim != 2 or q.shape[1] != 6:
        raise InputError(f"Joint angles have shape {q.shape}; expected [samples, 6].")
    side = _side(arm)
    turn = rotation("x", np.full(len(q), side * SHOULDER_ROLL))
    position = np.zeros((len(q), 3))
    orientation = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    for joint, axis in enumerate(JOINT_AXES):
        offset = JOINT_OFFSETS[joint] * np.array([1.0, side, 1.0])
        position = position + orientation @ offset
        if joint == 0:
            orientation = turn
        orientation = orientation @ rotation(axis, q[:, joint])
    return position, orientation


def tcp_pose(q: Floats, arm: str = "R") -> tuple[Floats, Floats]:
    """Pose of the tool centre point: position [n, 3] (m) and rotation [n, 3, 3] (that of the wrist).

    Takes and raises what :func:`wrist_pose` does.
    """
    position, orientation = wrist_pose(q, arm)
    return position + orientation @ (TCP_IN_WRIST * np.array([1.0, _side(arm), 1.0])), orientation


def tilt_degrees(orientation: Floats) -> Floats:
    """Angle [n] in degrees between the hand and the vertical: 0 when the wrist's x axis points up.

    The last joint turns about that axis, so its offset does not matter here.
    """
    return np.rad2deg(np.arccos(np.clip(orientation[:, 2, 0], -1.0, 1.0)))


def rpy_rotation(rpy: Floats) -> Floats:
    """Rotation matrices [n, 3, 3] = Rz(yaw) Ry(pitch) Rx(roll) from [n, 3] roll, pitch, yaw (rad)."""
    return rotation("z", rpy[:, 2]) @ rotation("y", rpy[:, 1]) @ rotation("x", rpy[:, 0])


def _side(arm: str) -> float:
    if arm not in ("R", "L"):
        raise InputError(f'Arm is {arm!r}; expected "R" or "L".')
    return 1.0 if arm == "R" else -1.0
