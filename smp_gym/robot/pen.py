"""The pen in the hand: where its tip is, and where the hand takes hold of it."""

from __future__ import annotations

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import PEN_TIP, end_effector_pose

__all__ = ["PEN_CONFIGURATION", "PEN_POSE", "pen_path"]

PEN_CONFIGURATION = (-1.52, 2.96, 0.83, 0.63, 3.07, -0.61)
"""Joint angles in which the hand closes on the pen before it is put at an episode's start, rad."""


PEN_POSE = np.eye(4)
"""(4, 4) pose of the pen's tip in the end-effector frame."""
PEN_POSE[:3, 3] = PEN_TIP
PEN_POSE.setflags(write=False)


def pen_path(configurations: FloatArray) -> FloatArray:
    """Return where the pen's tip is, (..., 3) m, for configurations (..., 6) rad."""
    pose = end_effector_pose(configurations)
    return np.asarray(pose[..., :3, :3] @ PEN_TIP + pose[..., :3, 3])
