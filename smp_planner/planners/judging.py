"""What finished trajectories are worth: where they end, what they miss, which of them is best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_planner.problem import Problem
from smp_planner.robot_model import RobotModel
from smp_planner.verification import Verification

__all__ = ["SAFE_CLEARANCE", "VIA_WINDOW", "choose", "goal_distance", "missed_via_points"]

FloatArray = NDArray[np.float64]

SAFE_CLEARANCE = 0.01
"""Clearance, m, beyond which more of it makes a particle no better."""

VIA_WINDOW = 0.06
"""Phase by which a via-point may be passed sooner or later than it is due."""


def goal_distance(problem: Problem, robot: RobotModel, ends: FloatArray) -> FloatArray:
    """Return the distance (P,) m of carried points to the nearest goal region."""
    errors = []
    for goal in problem.goals:
        points = robot.carried_points(ends, goal.point)[0]
        errors.append(np.linalg.norm(points - np.clip(points, goal.lower, goal.upper), axis=-1))
    return np.asarray(np.min(errors, axis=0))


def missed_via_points(problem: Problem, robot: RobotModel, trajectories: FloatArray) -> FloatArray:
    """Return by how much (P,) m trajectories miss the via-point that they miss most, 0 if none."""
    phase = np.linspace(0.0, 1.0, trajectories.shape[1])
    missed = np.zeros(len(trajectories))
    for via in problem.via_points:
        due = np.abs(phase - via.phase) <= VIA_WINDOW
        points = robot.carried_points(trajectories[:, due], via.point)[0]
        distance = np.linalg.norm(points - via.position, axis=-1).min(axis=1)
        missed = np.maximum(missed, distance - via.tolerance)
    return missed


def choose(
    verdict: Verification, goal_error: FloatArray, missed: FloatArray, costs: dict[str, FloatArray]
) -> int:
    """Return the best particle: what is demanded first, then likeness to the demonstrations."""
    free, clearance = verdict.collision_free, verdict.clearance
    demanded = 4.0 * free + 3.0 * (missed <= 0.0)
    demanded += 2.0 * verdict.executable + 1.0 * (goal_error < 0.005)
    unsafe = np.where(free, np.maximum(SAFE_CLEARANCE - clearance, 0.0), -clearance)
    # One unit of the prior is worth a tenth of a millimetre of missing clearance.
    merit = -costs["prior"] - 1e4 * unsafe - 1e3 * goal_error - 1e3 * missed
    return int(np.lexsort((merit, demanded))[-1])
