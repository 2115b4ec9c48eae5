"""Configurations that bring the hand where a problem demands it, found by inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import UnreachableError, damped_step, inverse_kinematics
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.tool_goals import GoalRegion

__all__ = ["final_posture", "pose_chain", "reaching"]

REGION_TOLERANCE = 0.02
"""Distance, m, from a region up to which a posture is taken to reach it."""

_ITERATIONS = 30
_DAMPING = 1e-6
_AT_REST = 1e-9
"""Rad, change of a configuration below which a search has ended."""

_POSITION_TOLERANCE = 1e-3
"""Metres up to which a point is taken to be where it should."""


def reaching(
    regions: Sequence[GoalRegion],
    robot: RobotModel,
    seeds: ArrayLike,
    near: ArrayLike,
    rng: np.random.Generator,
) -> FloatArray:
    """Return configurations that reach one of several regions.

    Damped least squares from given configurations to random points of the inner half of the
    regions, which take turns; what orientation the hand keeps is left to the seeds.

    Args:
        regions: at least one.
        robot: the arm.
        seeds: (N,n) rad, from each of which one configuration is sought.
        near: (n,) rad; endless joints are turned to be within half a turn of it.
        rng: source of all randomness.

    Returns:
        (G,n) rad, G at most N, within the joint limits, in the order of the seeds, not checked for
        collisions; possibly none.

    Raises:
        ValueError: `seeds` has the wrong shape or is not finite.
    """
    q, close = np.array(seeds, np.float64), np.asarray(near, np.float64)
    if q.ndim != 2 or q.shape[1] != robot.joints or not len(q):
        raise ValueError(f"seeds must have shape (N, {robot.joints}), got {q.shape}")
    if not np.isfinite(q).all():
        raise ValueError("seeds must be finite, got NaN or infinity")
    of_region = np.arange(len(q)) % len(regions)
    inner = 0.25 + 0.5 * rng.random((len(q), 3))
    error = np.full(len(q), np.inf)
    for index, region in enumerate(regions[: len(q)]):
        mine = of_region == index
        target = region.lower + inner[mine] * (region.upper - region.lower)
        q[mine], error[mine] = _moved(robot, q[mine], region.point, target)
    turns = np.where(robot.endless, np.round((q - close) / (2 * np.pi)), 0.0)
    turned = q - 2 * np.pi * turns
    within = (turned >= robot.lower) & (turned <= robot.upper)
    return np.where(within, turned, q)[error < _POSITION_TOLERANCE]


def _moved(
    robot: RobotModel, q: FloatArray, point: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return configurations (N,n) that carry a point to (N,3) m, and by how much they fail."""
    for _ in range(_ITERATIONS):
        here, jacobian = robot.carried_points(q, point)
        change = damped_step(jacobian, target - here, _DAMPING)
        q = np.clip(q + change, robot.lower, robot.upper)
        if np.abs(change).max() < 1e-6:
            break
    return q, np.linalg.norm(target - robot.carried_points(q, point)[0], axis=1)


def pose_chain(poses: Sequence[FloatArray], near: ArrayLike) -> FloatArray:
    """Return configurations (H,6) rad that take poses one after the other.

    A pose leaves an arm of six joints nothing but the choice of a branch: that nearest to a
    given configuration is taken, and kept.

    Args:
        poses: H of the end effector (4, 4) in the base frame, at least one.
        near: (6,) rad, about where the last pose is taken.

    Raises:
        UnreachableError: a pose is out of reach.
    """
    chain = []
    # The last one first: the arm is stretched there, and away from its joint limits.
    for pose in reversed(poses):
        near = inverse_kinematics(pose[:3, 3], pose[:3, :3], seed=near)
        chain.append(near)
    return np.array(chain[::-1])


def final_posture(
    mean: FloatArray,
    covariance: FloatArray,
    regions: Sequence[GoalRegion],
    robot: RobotModel,
    std: float,
) -> FloatArray:
    """Return the configuration (n,) that reaches a region and is most likely under a Gaussian.

    Gauss-Newton on the negative log-posterior of the configuration, given that the carried point is
    in the middle of the region up to `std`. Of several regions the likeliest is taken.

    Args:
        mean: (n,) rad.
        covariance: (n, n).
        regions: at least one.
        robot: the arm.
        std: m.

    Raises:
        UnreachableError: no region is reached.
    """
    precision = np.linalg.inv(covariance)
    best: tuple[float, FloatArray] | None = None
    nearest = np.inf
    for region in regions:
        # Approaching the goal in steps keeps each linearisation close to the truth.
        posture = np.clip(mean, robot.lower, robot.upper)
        origin = robot.carried_points(posture, region.point)[0]
        for share in (*np.linspace(0.2, 1.0, 5), 1.0, 1.0, 1.0, 1.0, 1.0):
            target = origin + share * (region.center - origin)
            point, jacobian = robot.carried_points(posture, region.point)
            scaled = jacobian / std
            hessian = scaled.T @ scaled + precision
            slope = scaled.T @ (point - target) / std + precision @ (posture - mean)
            change = np.linalg.solve(hessian, slope)
            change *= min(1.0, 0.3 / max(np.abs(change).max(), 1e-12))
            posture = np.clip(posture - change, robot.lower, robot.upper)
            if share == 1.0 and np.abs(change).max() < _AT_REST:
                break
        error = float(region.distance(robot.carried_points(posture, region.point)[0]))
        nearest = min(nearest, error)
        energy = float((posture - mean) @ precision @ (posture - mean))
        if error <= REGION_TOLERANCE and (best is None or energy < best[0]):
            best = energy, posture
    if best is None:
        named = ", ".join(f"{np.round(region.center, 3)}" for region in regions)
        raise UnreachableError(
            f"goal {named} is out of reach: the arm stays {nearest:.3f} m away from it"
        )
    return best[1]
