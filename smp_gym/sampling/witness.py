"""Witnesses: the dense check of feasible reference trajectories."""

from __future__ import annotations

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.swept_path import SweptPath

__all__ = ["FIXTURE_CLEARANCE", "WITNESS_SAMPLES", "is_witness", "within_limits"]


WITNESS_SAMPLES = 200

_MAX_DURATION = 14.0
"""Seconds: longest witness, at constant speed of phase within the joint velocity limits."""

FIXTURE_CLEARANCE = 0.010
_SELF_CLEARANCE = 0.005
_LIMIT_MARGIN = 0.05
"""Witness: distance (m) to table and bin, to itself, and (rad) to the joint limits."""


def within_limits(trajectories: FloatArray, steps: float | None = None) -> BoolArray:
    """Return a mask (...) of (..., T, 6) trajectories within joint limits and quick enough.

    Args:
        trajectories: rad.
        steps: how many steps like theirs make a whole trajectory; by default they are whole.
    """
    steps = trajectories.shape[-2] - 1.0 if steps is None else steps
    low = kinematics.JOINT_LOWER + _LIMIT_MARGIN
    high = kinematics.JOINT_UPPER - _LIMIT_MARGIN
    inside = ((trajectories > low) & (trajectories < high)).all(axis=(-2, -1))
    rate = np.abs(np.diff(trajectories, axis=-2)).max(axis=-2) * steps
    duration = (rate / kinematics.JOINT_VELOCITY).max(axis=-1)
    quick: BoolArray = inside & (duration <= _MAX_DURATION)
    return quick


def is_witness(
    body: MovingBody,
    trajectory: FloatArray,
    bodies: FloatArray,
    rows: FloatArray,
    clearance: float,
    steps: float | None = None,
) -> bool:
    """Return whether a (W, 6) trajectory solves a scene of obstacles `rows`, fixtures `bodies`.

    Args:
        body: what moves.
        trajectory: rad.
        bodies: (B, 9) rows that no moving sphere may touch.
        rows: (M, 9) rows of obstacles.
        clearance: m, to the obstacles.
        steps: how many steps like the trajectory's make a whole trajectory; by default it is whole.
    """
    if not within_limits(trajectory, steps):
        return False
    path = body.paths(trajectory)
    radius = body.spheres.radius
    if not SweptPath.of(path, radius).clear(rows, clearance).all():
        return False
    # The arm's base stands on the table: only the moving spheres have to keep clear of it.
    moving = SweptPath.of(path[:, body.moving], radius[body.moving])
    if not moving.clear(bodies, FIXTURE_CLEARANCE).all():
        return False
    return bool(kernels.clear_of_itself(path, radius, body.pairs, _SELF_CLEARANCE))
