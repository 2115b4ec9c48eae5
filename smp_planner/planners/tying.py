"""Tying a primitive to a problem: conditioned on its start, via-points, via-poses and goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from smp_gym.robot.kinematics import UnreachableError
from smp_planner.collision.robot_model import RobotModel
from smp_planner.movement_primitives import ProMP
from smp_planner.planners.rrt_connect.postures import pose_chain
from smp_planner.planning.problem import GoalRegion, Problem, ViaPoint

__all__ = ["TiedPrimitive", "tie_primitive", "tie_to_goals"]

FloatArray = NDArray[np.float64]

GOAL_STD = 0.005
"""Standard deviation, m, with which the primitive is conditioned on the goal point."""

POSTURE_STD = 0.1
"""Standard deviation, rad, that the final posture keeps around the one found for the goal."""

VIA_POSE_STD = 0.002
"""Standard deviation, rad, with which the primitive is conditioned on a via-pose."""

REACHED = 0.02
"""Distance, m, from a goal region up to which a posture is taken to reach it."""

VIA_STD = 0.02
"""Standard deviation, m, with which the primitive is conditioned on via-points."""

_VIA_ITERATIONS = 8


@dataclass(frozen=True)
class TiedPrimitive:
    """A primitive conditioned on the start and the goal of a problem.

    Attributes:
        primitive: its whitened coordinates are those in which planners work.
        posture: (n,) rad, the final configuration that it was conditioned on.
    """

    primitive: ProMP
    posture: FloatArray


def tie_primitive(
    primitive: ProMP, problem: Problem, robot: RobotModel, through: Sequence[ViaPoint]
) -> TiedPrimitive:
    """Condition on what is certain (start, rest at both ends), then on via-points and a goal.

    Args:
        primitive: of D = 6 joints.
        problem: gives start, via-poses and goals; of the goals, the likeliest is taken.
        robot: arm with all that it carries.
        through: via-points to condition on, too.

    Raises:
        UnreachableError: a via-pose or all goals are out of reach.
    """
    rest = torch.zeros(primitive.dimension, dtype=torch.float64)
    start = torch.from_numpy(problem.start)
    tied = primitive.condition(0.0, start).condition(0.0, rest, derivative=True)
    tied = tied.condition(1.0, rest, derivative=True)
    tied = _through_poses(tied, problem)
    if through:
        tied = _through(tied, through, robot)
    return tie_to_goals(tied, problem.goals, robot)


def tie_to_goals(primitive: ProMP, goals: Sequence[GoalRegion], robot: RobotModel) -> TiedPrimitive:
    """Condition on the final posture that is likeliest of those that reach a goal.

    Args:
        primitive: of the joints.
        goals: at least one region; the likeliest is taken.
        robot: arm with all that it carries.

    Raises:
        UnreachableError: all goals are out of reach.
    """
    posture = _final_posture(primitive, goals, robot)
    goal = min(
        goals,
        key=lambda g: float(np.linalg.norm(robot.carried_points(posture, g.point)[0] - g.center)),
    )
    jacobian = robot.carried_points(posture, goal.point)[1] / GOAL_STD
    information = jacobian.T @ jacobian + np.eye(len(posture)) / POSTURE_STD**2
    covariance = torch.from_numpy(np.linalg.inv(information))
    tied = primitive.condition(1.0, torch.from_numpy(posture), (covariance + covariance.mT) / 2)
    return TiedPrimitive(tied, posture)


def _final_posture(primitive: ProMP, goals: Sequence[GoalRegion], robot: RobotModel) -> FloatArray:
    """Return the configuration (n,) that reaches a goal and is most likely under the primitive.

    Gauss-Newton on the negative log-posterior of the final configuration, given that the carried
    point is in the middle of the region up to `GOAL_STD`. Of several goals the likeliest is taken.

    Raises:
        UnreachableError: no goal is reached.
    """
    mean_tensor, covariance = primitive.marginal(1.0)
    mean, precision = mean_tensor.numpy(), np.linalg.inv(covariance.numpy())
    best: tuple[float, FloatArray] | None = None
    nearest = np.inf
    for goal in goals:
        # Approaching the goal in steps keeps each linearisation close to the truth.
        posture = np.clip(mean, robot.lower, robot.upper)
        origin = robot.carried_points(posture, goal.point)[0]
        for share in (*np.linspace(0.2, 1.0, 5), 1.0, 1.0, 1.0, 1.0, 1.0):
            target = origin + share * (goal.center - origin)
            point, jacobian = robot.carried_points(posture, goal.point)
            scaled = jacobian / GOAL_STD
            hessian = scaled.T @ scaled + precision
            slope = scaled.T @ (point - target) / GOAL_STD + precision @ (posture - mean)
            change = np.linalg.solve(hessian, slope)
            change *= min(1.0, 0.3 / max(np.abs(change).max(), 1e-12))
            posture = np.clip(posture - change, robot.lower, robot.upper)
        point = robot.carried_points(posture, goal.point)[0]
        error = float(np.linalg.norm(point - np.clip(point, goal.lower, goal.upper)))
        nearest = min(nearest, error)
        energy = float((posture - mean) @ precision @ (posture - mean))
        if error <= REACHED and (best is None or energy < best[0]):
            best = energy, posture
    if best is None:
        regions = ", ".join(f"{np.round(goal.center, 3)}" for goal in goals)
        raise UnreachableError(
            f"goal {regions} is out of reach: the arm stays {nearest:.3f} m away from it"
        )
    return best[1]


def _through(primitive: ProMP, via_points: Sequence[ViaPoint], robot: RobotModel) -> ProMP:
    """Return the primitive conditioned on via-points, linearised where they are met.

    The most likely trajectory that passes them up to `VIA_STD` is found by Gauss-Newton in whitened
    coordinates; about it the pen's place is taken to be linear in the weights (Laplace's way).
    """
    places = np.array([via.position for via in via_points])
    at = torch.tensor([via.phase for via in via_points], dtype=primitive.mean.dtype)
    identity = torch.eye(primitive.dimension, dtype=at.dtype)
    values = primitive.basis.values(at)
    latent = torch.zeros(primitive.rank, dtype=at.dtype)
    unit = torch.eye(primitive.rank, dtype=at.dtype)
    rows, value = torch.empty(0), torch.empty(0)
    for _ in range(_VIA_ITERATIONS):
        q = (values @ primitive.unwhiten(latent).reshape(-1, primitive.dimension)).numpy()
        reached = [robot.carried_points(q[k], via_points[k].point) for k in range(len(via_points))]
        jacobian = np.array([j for _, j in reached])
        target = places - np.array([p for p, _ in reached]) + np.einsum("kij,kj->ki", jacobian, q)
        by_joint = torch.einsum("kij,kb,jd->kibd", torch.from_numpy(jacobian), values, identity)
        rows, value = (
            by_joint.reshape(-1, primitive.mean.shape[-1]),
            torch.from_numpy(target).ravel(),
        )
        scaled = rows @ primitive.factor / VIA_STD
        residual = (value - rows @ primitive.mean) / VIA_STD
        latent = torch.linalg.solve(scaled.mT @ scaled + unit, scaled.mT @ residual)
    noise = torch.full((len(rows),), VIA_STD**2, dtype=at.dtype)
    return primitive.observe(rows, value, noise)


def _through_poses(primitive: ProMP, problem: Problem) -> ProMP:
    """Return the primitive conditioned on the via-poses of a problem.

    Raises:
        UnreachableError: a via-pose is out of reach.
    """
    if not problem.via_poses:
        return primitive
    rest = torch.zeros(primitive.dimension, dtype=torch.float64)
    spread = VIA_POSE_STD**2 * torch.eye(primitive.dimension, dtype=torch.float64)
    expected = primitive.marginal(problem.via_poses[-1].phase)[0].numpy()
    chain = pose_chain(problem.via_poses, expected)
    for via, configuration in zip(problem.via_poses, chain, strict=True):
        primitive = primitive.condition(via.phase, torch.from_numpy(configuration), spread)
        if via.rest:
            primitive = primitive.condition(via.phase, rest, derivative=True)
    return primitive
