"""Inverse kinematics by damped least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.robot.chain import (
    END_EFFECTOR,
    JOINT_LOWER,
    JOINT_UPPER,
    checked,
    constant,
    end_effector_pose,
    link_transforms,
)

__all__ = ["UnreachableError", "damped_step", "inverse_kinematics", "pose_errors", "pose_jacobians"]


class UnreachableError(ValueError):
    """A pose that the arm cannot take."""


_SEED_LIBRARY = constant(
    [
        [-0.8, 3.5, 1.0, 0.0, 2.7, 0.0],
        [-2.1, 3.8, 1.0, 0.0, 2.5, 0.0],
        [-1.6, 2.9, 1.3, 4.2, 1.4, 0.0],
        [-1.6, 3.4, 2.0, 1.5, 2.0, 1.5],
        [0.8, 3.2, 1.6, -1.5, 2.2, 0.0],
        [-3.0, 4.0, 1.6, 1.0, 3.6, 1.0],
        [-1.6, 2.4, 4.6, 3.0, 2.6, 0.0],
        [1.6, 3.6, 2.4, 0.0, 4.0, 3.0],
        [2.5, 1.8, 2.8, -2.0, 4.6, -1.5],
    ]
)
"""Configurations all over the workspace from which the search starts besides the caller's."""

_ITERATIONS = 200
_DAMPING = 1e-3
LARGEST_STEP = 0.3
"""rad, farther than which no joint turns in one step."""

_ROTATION_LENGTH = 0.3
"""Metres that one radian of rotation error counts as."""


def damped_step(
    jacobian: FloatArray, error: FloatArray, damping: ArrayLike, largest: float = LARGEST_STEP
) -> FloatArray:
    """Return the step of damped least squares (Wampler 1986), J^T (J J^T + d I)^-1 e.

    Args:
        jacobian: (..., m, n).
        error: (..., m), what the step shall make up for.
        damping: (...) d, in squared units of the Jacobian.
        largest: rad, to which the whole step is shortened so that no joint turns farther.

    Returns:
        (..., n) rad.
    """
    transposed = np.swapaxes(jacobian, -1, -2)
    square = jacobian @ transposed + np.asarray(damping)[..., None, None] * np.eye(error.shape[-1])
    step = (transposed @ np.linalg.solve(square, error[..., None]))[..., 0]
    size = np.abs(step).max(axis=-1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, largest / np.maximum(size, 1e-12)))


def pose_errors(poses: FloatArray, position: FloatArray, rotation: FloatArray | None) -> FloatArray:
    """Return (..., 3) position errors, or (..., 6) with scaled rotation vectors."""
    offset = position - poses[..., :3, 3]
    if rotation is None:
        return np.asarray(offset)
    turn = rotation @ np.swapaxes(poses[..., :3, :3], -1, -2)
    axis = np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    # At half a turn the axis vanishes; the small number only keeps the division defined.
    vector = axis * (angle / np.maximum(sine, 1e-9))[..., None]
    return np.concatenate([offset, _ROTATION_LENGTH * vector], axis=-1)


def pose_jacobians(links: FloatArray, tool: FloatArray, with_rotation: bool) -> FloatArray:
    """Return (..., 3 or 6, 6) derivatives of the tool's pose, rotation as in `pose_errors`."""
    axes = np.swapaxes(links[..., 1:, :3, 2], -1, -2)
    arms = tool[..., None, :3, 3] - links[..., 1:, :3, 3]
    linear = np.swapaxes(np.cross(links[..., 1:, :3, 2], arms), -1, -2)
    if not with_rotation:
        return np.asarray(linear)
    return np.concatenate([linear, _ROTATION_LENGTH * axes], axis=-2)


def _unwrapped(solutions: FloatArray, seed: FloatArray) -> FloatArray:
    """Return solutions with endless joints at the turn nearest to the seed, within limits."""
    endless = [0, 3, 5]
    turns = np.round((seed[endless] - solutions[:, endless]) / (2 * np.pi))
    moved = solutions.copy()
    moved[:, endless] += 2 * np.pi * turns
    outside = (moved < JOINT_LOWER) | (moved > JOINT_UPPER)
    return np.where(outside, solutions, moved)


def inverse_kinematics(
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    seed: ArrayLike | None = None,
    *,
    tolerance: float = 1e-5,
) -> FloatArray:
    """Return the configuration (6,) rad nearest to `seed` whose end effector is at a pose.

    Damped least squares on one batch of start configurations: the seed and a small library.

    Args:
        position: (3,) m, of the end-effector frame's origin in the base frame.
        rotation: (3, 3) of the end-effector frame, or None if any will do.
        seed: (6,) rad, near which a solution is wanted; default the first of the library.
        tolerance: m, largest error; a rotation error counts `_ROTATION_LENGTH` metres per radian.

    Raises:
        UnreachableError: no solution within the joint limits was found.
        ValueError: wrong shape, not finite, or `rotation` is not a rotation.
    """
    target = checked("position", position, (3,))
    turn = None if rotation is None else checked("rotation", rotation, (3, 3))
    if turn is not None and not (
        np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    ):
        raise ValueError(f"rotation must be a rotation matrix, got {turn}")
    near = _SEED_LIBRARY[0] if seed is None else checked("seed", seed, (6,))
    q = np.clip(np.vstack([near, _SEED_LIBRARY]), JOINT_LOWER, JOINT_UPPER)
    for _ in range(_ITERATIONS):
        links = link_transforms(q)
        tool = links[:, -1] @ END_EFFECTOR
        error = pose_errors(tool, target, turn)
        residual = np.linalg.norm(error, axis=-1)
        if (residual < tolerance).all() or residual[0] < 0.1 * tolerance:
            break
        # Damping that fades with the error: steady far away, quadratic near the solution.
        damping = _DAMPING * np.minimum(residual, 0.1) + 1e-9
        step = damped_step(pose_jacobians(links, tool, turn is not None), error, damping)
        q = np.clip(q + step, JOINT_LOWER, JOINT_UPPER)
    residual = np.linalg.norm(pose_errors(end_effector_pose(q), target, turn), axis=-1)
    solved = residual < tolerance
    if not solved.any():
        raise UnreachableError(
            f"position {target} is out of reach: the end effector stays {residual.min():.4f} m "
            f"{'' if turn is None else '(rotation included) '}away from it"
        )
    solutions = _unwrapped(q[solved], near)
    return np.asarray(solutions[np.abs(solutions - near).max(axis=1).argmin()])
