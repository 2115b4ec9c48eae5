"""What finished trajectories are worth: where they end, what they miss, how they go, their rank."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import RobotModel, jaco_of_spheres
from smp_planner.collision.verification import Verification
from smp_planner.planning.modes import signatures_3d
from smp_planner.planning.problem import Problem, Stage

__all__ = [
    "REACHED",
    "SAFE_CLEARANCE",
    "free_waypoints",
    "goal_distances",
    "missed_via_points",
    "rank",
    "signatures",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SAFE_CLEARANCE = 0.01
"""Clearance, m, beyond which more of it makes a particle no better."""

REACHED = 0.005
"""Distance, m, of the end from a goal region up to which a trajectory counts as ending there."""

_ASIDE = np.array([1.1e-6, 0.7e-6, 0.0])
"""By how much, m, the middles of obstacles are moved for signatures: in a scene made by hand, a
trajectory may lead right through one, where it has no side."""


_WAY_SAMPLES = 50
"""Samples of a way that decide its signature. Between them it goes on by about 2 cm: finer ones
cost more time, and class otherwise only what passes close to an edge or through an obstacle."""


def goal_distances(problem: Problem, robot: RobotModel, ends: FloatArray) -> FloatArray:
    """Return the distances (G, P) m of carried points at the ends (P, D) to each goal region."""
    distances = []
    for goal in problem.goals:
        points = robot.carried_points(ends, goal.point)[0]
        outside = points - np.clip(points, goal.lower, goal.upper)
        distances.append(np.linalg.norm(outside, axis=-1))
    return np.array(distances)


def free_waypoints(problem: Problem, robot: RobotModel, trajectories: FloatArray) -> BoolArray:
    """Return (P, T) whether the configurations of trajectories (P, T, D) rad touch nothing."""
    count = trajectories.shape[1]
    free = np.ones(trajectories.shape[:2], np.bool_)
    stages = problem.stages or (Stage(0.0, 1.0, robot.spheres, problem.obstacles),)
    for stage in stages:
        part = trajectories[:, stage.steps(count)]
        checker = EdgeChecker(jaco_of_spheres(stage.spheres), stage.obstacles)
        found = checker.configurations_free(part.reshape(-1, part.shape[-1]))
        free[:, stage.steps(count)] &= found.reshape(part.shape[:2])
    return free


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


def rank(
    verdict: Verification, goal_error: FloatArray, missed: FloatArray, costs: dict[str, FloatArray]
) -> IntArray:
    """Return the place (P,) of each particle, the best having 0.

    What is demanded comes first, then likeness to the demonstrations.
    """
    free, clearance = verdict.collision_free, verdict.clearance
    demanded = 4.0 * free + 3.0 * (missed <= 0.0)
    demanded += 2.0 * verdict.executable + 1.0 * (goal_error < REACHED)
    unsafe = np.where(free, np.maximum(SAFE_CLEARANCE - clearance, 0.0), -clearance)
    # One unit of the prior is worth a tenth of a millimetre of missing clearance.
    merit = -costs["prior"] - 1e4 * unsafe - 1e3 * goal_error - 1e3 * missed
    order = np.lexsort((merit, demanded))[::-1]
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order))
    return places


def signatures(
    problem: Problem, robot: RobotModel, trajectories: FloatArray, ending_at: IntArray
) -> IntArray:
    """Return which way trajectories go, (P, 1 + 2 M), see `Plan.signatures`.

    The way is that of the carried point. Trajectories with one goal are compared with each other,
    for the signatures of different ends are not comparable. Over or under an obstacle is what
    crosses the circle around its outline as seen from above.

    Args:
        problem: whose `movable` obstacles are looked at.
        robot: arm with all that it carries.
        trajectories: (P, T, D) rad.
        ending_at: (P,) index of the goal region that each ends nearest to.
    """
    movable = problem.movable
    passed = np.empty((len(trajectories), len(movable), 2), np.int64)
    last = trajectories.shape[1] - 1
    steps = np.unique(np.linspace(0, last, min(_WAY_SAMPLES, last + 1)).round().astype(np.int64))
    centers = np.array([o.position for o in movable]).reshape(-1, 3) + _ASIDE
    extents = np.array([_extents(o) for o in movable]).reshape(-1, 2)
    for number in np.unique(ending_at):
        of_goal = ending_at == number
        point = problem.goals[number].point
        paths = robot.carried_points(trajectories[of_goal][:, steps], point)[0]
        passed[of_goal] = signatures_3d(paths, centers, extents[:, 1], extents[:, 0])
    return np.column_stack([ending_at, passed.reshape(len(passed), -1)]).astype(np.int64)


def _extents(obstacle: Obstacle) -> tuple[float, float]:
    """Return radius and half height, m, of an upright cylinder around an obstacle."""
    rotation = Rotation.from_quat(obstacle.quaternion).as_matrix()
    return REGISTRY[obstacle.shape].upright(rotation, np.array(obstacle.size))
