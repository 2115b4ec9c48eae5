"""Strokes of the pen: moved from where they were demonstrated, and followed by the arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import PEN_TIP
from smp_gym.robot.pen import pen_path

__all__ = ["follow", "moved"]

_POSTURE_LENGTH = 5e-4
"""Metres that one radian away from the given posture counts as: next to nothing."""

_DIRECTION_LENGTH = 1.5e-3
"""Metres that a pen pointing one radian off counts as."""

_LARGEST_STEP = 0.3
_SMALLEST_STEP = 1e-4
"""Rad that a joint may turn in one iteration, and below which the search ends."""


def moved(points: FloatArray, end: Sequence[float], scale: float, yaw: float) -> FloatArray:
    """Return a stroke scaled and turned about its end, and shifted.

    Args:
        points: (..., N, 3) m.
        end: (3,) m, where the last point comes to lie.
        scale: 1 keeps its size.
        yaw: about the vertical, rad.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((points - points[..., -1:, :]) @ (scale * rotation.T) + end)


def follow(
    points: FloatArray,
    near: FloatArray,
    directions: FloatArray | None = None,
    iterations: int = 8,
) -> tuple[FloatArray, float]:
    """Return configurations whose pen is at given points, changed as little as that takes.

    Gauss-Newton on the squared error, at all points at once, with a slight pull towards the given
    configurations and, if told, towards a direction of the pen. Held to one orientation, the hand
    would have to turn faster than its joints can.

    Args:
        points: (N, 3) m.
        near: (N, 6) rad, from which the search starts and to which it is pulled.
        directions: (N, 3) unit vectors along which the pen shall point, or None for any.
        iterations: of Gauss-Newton, at most.

    Returns:
        (N, 6) rad within the joint limits, and the largest remaining distance to a point, m.
    """
    q = near
    for _ in range(iterations):
        links = kinematics.link_transforms(q)
        pose = links[:, -1] @ kinematics.END_EFFECTOR
        tip = pose[:, :3, :3] @ PEN_TIP + pose[:, :3, 3]
        axes, origins = links[:, 1:, :3, 2], links[:, 1:, :3, 3]
        jacobian = np.swapaxes(np.cross(axes, tip[:, None] - origins), 1, 2)
        hessian = np.swapaxes(jacobian, 1, 2) @ jacobian + _POSTURE_LENGTH**2 * np.eye(6)
        slope = np.einsum("nij,ni->nj", jacobian, points - tip) + _POSTURE_LENGTH**2 * (near - q)
        if directions is not None:
            pointing = pose[:, :3, 0]
            turning = np.swapaxes(np.cross(axes, pointing[:, None]), 1, 2)
            weight = _DIRECTION_LENGTH**2
            hessian += weight * np.swapaxes(turning, 1, 2) @ turning
            slope += weight * np.einsum("nij,ni->nj", turning, directions - pointing)
        step = np.linalg.solve(hessian, slope[..., None])[..., 0]
        step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        q = np.clip(q + step, kinematics.JOINT_LOWER, kinematics.JOINT_UPPER)
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    return q, float(np.linalg.norm(pen_path(q) - points, axis=-1).max())
