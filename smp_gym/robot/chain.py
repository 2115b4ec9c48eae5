"""The arm's chain as numbers: links, limits, frames, forward kinematics.

The arm is a Kinova JACO j2s6s200: six revolute joints, two fingers of two links each. The
constants are those of the manufacturer's robot description; `smp_gym.jaco_assets` writes
the simulated arm from the same numbers. Joint i turns LINKS[i + 1] about the z axis of its frame.
Metres, radians, seconds; poses are (4, 4) homogeneous matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray

__all__ = [
    "BASE_TRANSFORM",
    "END_EFFECTOR",
    "FINGER_JOINT_ORIGINS",
    "FINGER_TIP_ORIGIN",
    "GRASP_CENTER",
    "JOINT_LOWER",
    "JOINT_ORIGINS",
    "JOINT_UPPER",
    "JOINT_VELOCITY",
    "LINKS",
    "PEN_END",
    "PEN_RADIUS",
    "PEN_TIP",
    "REACH",
    "SHOULDER_HEIGHT",
    "end_effector_pose",
    "link_transforms",
]


def _rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return Rz(yaw) Ry(pitch) Rx(roll), the convention of URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _pose(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = _rotation(*rpy)
    pose[:3, 3] = xyz
    return pose


def constant(value: ArrayLike) -> FloatArray:
    """Return a float64 array that cannot be written."""
    array = np.array(value, np.float64)
    array.setflags(write=False)
    return array


LINKS = ("j2s6s200_link_base", *(f"j2s6s200_link_{i}" for i in range(1, 7)))
"""Links of the arm from base to hand; a link's index here is what `SphereSet.link` holds."""

JOINT_LOWER = constant(
    [-2 * np.pi, np.radians(47), np.radians(19), -2 * np.pi, np.radians(30), -2 * np.pi]
)
JOINT_UPPER = constant(
    [2 * np.pi, np.radians(313), np.radians(341), 2 * np.pi, np.radians(330), 2 * np.pi]
)
"""(6,) rad. Joints 1, 4 and 6 turn endlessly; they are held within a turn either way, unwrapped."""

JOINT_VELOCITY = constant(np.radians([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]))
"""(6,) rad/s, limits."""

BASE_TRANSFORM = constant(_pose((0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2)))
"""(4, 4) LINKS[0] in the base frame."""

JOINT_ORIGINS = constant(
    [
        _pose((0.0, 0.0, 0.15675), (0.0, np.pi, 0.0)),
        _pose((0.0, 0.0016, -0.11875), (-np.pi / 2, 0.0, np.pi)),
        _pose((0.0, -0.410, 0.0), (0.0, np.pi, 0.0)),
        _pose((0.0, 0.2073, -0.0114), (-np.pi / 2, 0.0, np.pi)),
        _pose((0.0, 0.0, -0.10375), (np.pi / 2, 0.0, np.pi)),
        _pose((0.0, 0.10375, 0.0), (-np.pi / 2, 0.0, np.pi)),
    ]
)
"""(6, 4, 4) frame of joint i + 1 at angle zero, in LINKS[i]."""

END_EFFECTOR = constant(_pose((0.0, 0.0, -0.16), (np.pi, np.pi / 2, 0.0)))
"""(4, 4) end-effector frame in LINKS[6]: x approaches, the fingers open along y."""

GRASP_CENTER = constant([0.022, 0.0, 0.0])
"""(3,) m, middle between the finger pads, in the end-effector frame."""

PEN_TIP = constant([0.14, 0.0, 0.0])
"""(3,) m, point of the pen in the end-effector frame; the pen lies on the frame's x axis."""

REACH = float(
    np.linalg.norm(JOINT_ORIGINS[2:, :3, 3], axis=1).sum()
    + np.linalg.norm(END_EFFECTOR[:3, 3])
    + np.linalg.norm(PEN_TIP)
)
"""m from the shoulder (joint 2), farther than which no point of the hand or of the pen ever is."""

SHOULDER_HEIGHT = 0.2755
"""m, of joint 2, which is on the base's axis to within 2 mm."""

PEN_END = -0.02
PEN_RADIUS = 0.006
"""Metres: where the pen's other end lies on that axis, and how thick it is."""

_FINGER_TILT = 0.649262481663582
FINGER_JOINT_ORIGINS = constant(
    [
        _pose((-0.0025, 0.03095, -0.11482), (-np.pi / 2, _FINGER_TILT, np.pi / 2)),
        _pose((-0.0025, -0.03095, -0.11482), (-np.pi / 2, _FINGER_TILT, -np.pi / 2)),
    ]
)
"""(2, 4, 4) proximal joints of fingers 1 and 2 in LINKS[6], at angle zero; they turn about z."""

FINGER_TIP_ORIGIN = constant(_pose((0.044, -0.003, 0.0), (0.0, 0.0, 0.0)))
"""(4, 4) joint of a finger's tip in its proximal link, at angle zero; it turns about z."""


def checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a float64 array.

    Raises:
        ValueError: its last axes are not of the given shape, or an entry is not finite.
    """
    array = np.asarray(value, np.float64)
    if array.shape[-len(shape) :] != shape:
        wanted = ", ".join(map(str, shape))
        raise ValueError(f"{name} must have shape (..., {wanted}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array}")
    return array


def turned(origins: FloatArray, angles: FloatArray) -> FloatArray:
    """Return joint frames (..., 4, 4) turned about their own z by angles (...)."""
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    x, y = origins[..., :, 0], origins[..., :, 1]
    turned = np.empty((*np.broadcast_shapes(x.shape, cosine.shape), 4))
    turned[..., 0] = cosine * x + sine * y
    turned[..., 1] = cosine * y - sine * x
    turned[..., 2:] = origins[..., :, 2:]
    return turned


def link_transforms(configurations: ArrayLike) -> FloatArray:
    """Return the poses (..., 7, 4, 4) of all `LINKS` in the base frame.

    Args:
        configurations: (..., 6) rad.

    Raises:
        ValueError: wrong shape, or not finite.
    """
    q = checked("configurations", configurations, (6,))
    poses = np.empty((*q.shape[:-1], len(LINKS), 4, 4))
    poses[..., 0, :, :] = BASE_TRANSFORM
    for i in range(6):
        poses[..., i + 1, :, :] = turned(poses[..., i, :, :] @ JOINT_ORIGINS[i], q[..., i])
    return poses


def end_effector_pose(configurations: ArrayLike) -> FloatArray:
    """Return the end-effector frame (..., 4, 4) in the base frame, for (..., 6) rad."""
    return np.asarray(link_transforms(configurations)[..., -1, :, :] @ END_EFFECTOR)
