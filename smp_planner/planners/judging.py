"""What finished trajectories are worth: where they end, what they miss, which of them is best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_planner.problem import Problem
from smp_planner.robot_model import RobotModel
from smp_planner.verification import Verification

__all__ = ["REACHED", "SAFE_CLEARANCE", "choose", "goal_distance", "missed_via_points"]

FloatArray = NDArray[np.float64]

SAFE_CLEARANCE = 0.01
"""Clearance, m, beyond which more of it makes a particle no better."""

REACHED = 0.005
"""Distance, m, of the nearest goal region up to which a particle reaches it."""


def goal_distance(problem: Problem, robot: RobotModel, ends: FloatArray) -> FloatArray:
    """Return the distance (P,) m of carried points to the nearest goal region."""
    errors = []
    for goal in problem.goals:
        points = robot.carried_points(ends, goal.point)[0]
        errors.append(np.linalg.norm(points - np.clip(points, goal.lower, goal.upper), axis=-1))
    return np.asarray(np.min(errors, axis=0))


def missed_via_points(problem: Problem, robot: RobotModel, trajectories: FloatArray) -> FloatArray:
    """Return by how much (P,) m trajectories miss the via-point that they miss most, 0 if none.

    Via-points are to be passed in their order: each is passed not before the one before it. Of all
    such ways to pass them, that whose worst miss is the least counts.
    """
    worst = np.zeros(trajectories.shape[:2])
    for via in problem.via_points:
        points = robot.carried_points(trajectories, via.point)[0]
        missed = np.linalg.norm(points - via.position, axis=-1) - via.tolerance
        worst = np.minimum.accumulate(np.maximum(worst, missed), axis=1)
    return np.asarray(worst.min(axis=1))


def choose(
    verdict: Verification, goal_error: FloatArray, missed: FloatArray, costs: dict[str, FloatArray]
) -> int:
    """Return the best particle: what is demanded first, then likeness to the demonstrations."""
    free, clearance = verdict.collision_free, verdict.clearance
    demanded = 4.0 * free + 3.0 * (missed <= 0.0)
    demanded += 2.0 * verdict.executable + 1.0 * (goal_error < REACHED)
    unsafe = np.where(free, np.maximum(SAFE_CLEARANCE - clearance, 0.0), -clearance)
    # One unit of the prior is worth a tenth of a millimetre of missing clearance.
    merit = -costs["prior"] - 1e4 * unsafe - 1e3 * goal_error - 1e3 * missed
    return int(np.lexsort((merit, demanded))[-1])
