"""Actions: towards a joint reference, and from motions of the end effector to joint velocities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.robot.kinematics import (
    END_EFFECTOR,
    JOINT_LOWER,
    JOINT_UPPER,
    JOINT_VELOCITY,
    damped_step,
    link_transforms,
    pose_errors,
    pose_jacobians,
)

__all__ = [
    "ANGULAR_SPEED",
    "LINEAR_SPEED",
    "execution_time",
    "execution_times",
    "joint_action",
    "reference_action",
]

LINEAR_SPEED = 0.15
"""m/s of the end effector at a linear action of 1."""

ANGULAR_SPEED = 0.5
"""rad/s of the end effector at an angular action of 1."""

_SPEED = 0.9
"""Share of the velocity limits at which a trajectory is executed."""

_LEAST_SQUARES_STEPS = 3
_DAMPING_LENGTH = 0.02
"""Metres; a radian of rotation counts as 0.3. Directions in which a radian of the joints moves the
hand by less than that are given up rather than followed by fast joints."""


def execution_time(trajectory: FloatArray) -> float:
    """Return how long a trajectory is executed, s, at 0.9 times the velocity limits.

    Args:
        trajectory: (T, 6) rad at equal steps of phase, which runs evenly.
    """
    return float(execution_times(trajectory[None])[0])


def execution_times(trajectories: FloatArray) -> FloatArray:
    """Return how long each of some trajectories (N, T, 6) is executed, (N,) s: `execution_time`."""
    phase = np.linspace(0.0, 1.0, trajectories.shape[1])
    rates = np.abs(np.gradient(trajectories, phase, axis=1)) / JOINT_VELOCITY
    times: FloatArray = rates.max(axis=(1, 2)) / _SPEED
    return times


def reference_action(
    target: FloatArray, reference: FloatArray, gripper: float
) -> NDArray[np.float32]:
    """Return the action (7,) that leads the joint reference to a target in one step.

    Nothing accumulates: what is cut off at the velocity limits is caught up by the next step.

    Args:
        target: (6,) rad, where the reference shall be after the step.
        reference: (6,) rad, where it is now.
        gripper: the gripper's action, -1 opening to 1 closing.
    """
    velocity = (target - reference) / (CONTROL_PERIOD * JOINT_VELOCITY)
    return np.append(np.clip(velocity, -1.0, 1.0), gripper).astype(np.float32)


def joint_action(action: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the joint velocity action that moves the end effector as wanted for one step.

    Damped least squares (Wampler 1986) on the reference, not on the measured joint angles, so that
    the arm does not sag step by step. Joints at a limit are left out of the solution. Where a joint
    would have to be faster than it can, the whole motion is slowed down, its direction kept.

    Args:
        action: (7,) linear velocity as fractions of `LINEAR_SPEED`, angular velocity as fractions
            of `ANGULAR_SPEED`, both along the axes of the base frame, and the gripper's rate.
        reference: (6,) rad, the joint angles that the motors track.

    Returns:
        (7,) joint velocities as fractions of their limits, from -1 to 1, and the gripper's rate.
    """
    links = link_transforms(reference)
    tool = links[-1] @ END_EFFECTOR
    position = tool[:3, 3] + action[:3] * LINEAR_SPEED * CONTROL_PERIOD
    turn = Rotation.from_rotvec(action[3:6] * ANGULAR_SPEED * CONTROL_PERIOD).as_matrix()
    rotation = turn @ tool[:3, :3]
    q = np.array(reference, np.float64)
    # Zero is zero: rounding must not make the arm creep.
    for _ in range(_LEAST_SQUARES_STEPS if action[:6].any() else 0):
        error = pose_errors(tool, position, rotation)
        change = _change(pose_jacobians(links, tool, True), error, q)
        q = np.clip(q + change, JOINT_LOWER, JOINT_UPPER)
        links = link_transforms(q)
        tool = links[-1] @ END_EFFECTOR
    fractions = (q - reference) / (JOINT_VELOCITY * CONTROL_PERIOD)
    fractions /= max(1.0, float(np.abs(fractions).max()))
    return np.append(fractions, action[6])


def _change(jacobian: FloatArray, error: FloatArray, q: FloatArray) -> FloatArray:
    """Return the change (6,) of the joints that reduces an error (6,) without leaving limits."""
    able = np.ones(6, np.bool_)
    while True:
        change = damped_step(np.where(able, jacobian, 0.0), error, _DAMPING_LENGTH**2, np.inf)
        stuck = ((q <= JOINT_LOWER) & (change < 0.0)) | ((q >= JOINT_UPPER) & (change > 0.0))
        if not (stuck & able).any():
            return change
        able &= ~stuck
