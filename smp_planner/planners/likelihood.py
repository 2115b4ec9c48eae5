"""The likelihood of a scene, Eq. (7): all costs of trajectories, weighted, on the scene's map."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from smp_gym.scene import Obstacle
from smp_planner.collision.costs import (
    CarriedBoxCost,
    CollisionCost,
    Cost,
    GoalCost,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
)
from smp_planner.collision.robot_model import RobotModel, jaco_of_spheres
from smp_planner.occupancy.grid import DistanceGrid, bake
from smp_planner.occupancy.neural import (
    INFLATION,
    PointNetworkMap,
    sample_labelled_points,
    train_map,
)
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.planners.base import PlannerSettings
from smp_planner.planning.problem import Problem, Stage

__all__ = ["Likelihood", "LikelihoodSettings"]

FloatArray = NDArray[np.float64]


class LikelihoodSettings(PlannerSettings):
    """Settings of the map and the costs.

    Attributes:
        map: "shapes" composes networks trained once per obstacle shape; "points" trains one network
            from labelled points of the scene, the paper's way, which takes seconds.
        map_points: how many points "points" learns from.
        planning_steps: steps of phase at which costs are evaluated.
        obstacle_weight: lambda of Eq. (12), for sums scaled to `costs.REFERENCE_STEPS` steps.
        self_collision_weight: lambda of the same cost between the arm's own links.
        margin: m, by which spheres are enlarged while planning.
        edge_width: m, width of the map's edge in the first and the last iteration.
        goal_sigma: m, tails of the smooth box prior around the goal, Eq. (14), and around the
            via-points, Eq. (13).
        via_share: half width of the box around a via-point, as a share of its tolerance.
        velocity_weight: of the excess over the joint velocity limits.
        limit_weight: of the excess over the joint limits.
    """

    map: Literal["shapes", "points"] = "shapes"
    map_points: int = Field(default=100_000, ge=100)
    planning_steps: int = Field(default=50, ge=10)
    obstacle_weight: float = Field(default=3.0, gt=0.0)
    self_collision_weight: float = Field(default=3.0, ge=0.0)
    margin: float = Field(default=0.01, ge=0.0)
    edge_width: tuple[float, float] = (0.05, 0.01)
    goal_sigma: float = Field(default=0.005, gt=0.0)
    via_share: float = Field(default=0.5, ge=0.0, le=1.0)
    velocity_weight: float = Field(default=10.0, ge=0.0)
    limit_weight: float = Field(default=100.0, ge=0.0)


def _baked_map(
    obstacles: tuple[Obstacle, ...], seed: int, settings: LikelihoodSettings
) -> DistanceGrid:
    """Return the neural occupancy map of obstacles as a grid of distance."""
    if settings.map == "shapes":
        return bake(ShapeNetworkMap(obstacles, default_networks()))
    rng = np.random.default_rng([seed, 2])
    points, labels = sample_labelled_points(obstacles, settings.map_points, rng)
    network = train_map(points, labels, inflation=INFLATION, seed=seed % 2**63)
    return bake(PointNetworkMap.of(network))


def _via_cost(problem: Problem, robot: RobotModel, settings: LikelihoodSettings) -> CarriedBoxCost:
    """Return the cost of leaving the boxes round the via-points, all of one carried point."""
    via_points = problem.via_points
    half = np.array([[settings.via_share * via.tolerance] for via in via_points])
    places = np.array([via.position for via in via_points])
    last = settings.planning_steps - 1
    return CarriedBoxCost(
        robot,
        via_points[0].point,
        np.array([round(via.phase * last) for via in via_points]),
        places - half,
        places + half,
        settings.goal_sigma,
    )


class Likelihood:
    """The likelihood of Eq. (7): all costs of a scene with their weights.

    Args:
        problem: gives obstacles and goals.
        robot: arm with all that it carries.
        settings: weights and widths.
    """

    def __init__(self, problem: Problem, robot: RobotModel, settings: LikelihoodSettings) -> None:
        self._problem, self._settings = problem, settings
        stages = problem.stages or (Stage(0.0, 1.0, robot.spheres, problem.obstacles),)
        maps: dict[tuple[Obstacle, ...], DistanceGrid] = {}
        for stage in stages:
            if stage.obstacles not in maps:
                maps[stage.obstacles] = _baked_map(stage.obstacles, problem.seed, settings)
        self._stages = [
            (stage, CollisionCost(jaco_of_spheres(stage.spheres), maps[stage.obstacles]))
            for stage in stages
        ]
        terms: dict[str, tuple[float, Cost]] = {
            "self_collision": (settings.self_collision_weight, SelfCollisionCost(robot)),
            "goal": (1.0, GoalCost(robot, problem.goals, settings.goal_sigma)),
            "velocity": (
                settings.velocity_weight,
                VelocityLimitCost(robot.velocity, settings.duration_limit),
            ),
            "joint_limits": (
                settings.limit_weight,
                JointLimitCost(robot.lower, robot.upper, margin=0.02),
            ),
        }
        if problem.via_points:
            terms["via_points"] = (1.0, _via_cost(problem, robot, settings))
        self._terms = {name: term for name, term in terms.items() if term[0] > 0.0}

    @property
    def steps(self) -> int:
        """Equal steps of phase at which it is evaluated."""
        return self._settings.planning_steps

    @property
    def pins(self) -> FloatArray:
        """Phases at which paths are held: both ends, via-points and via-poses; ascending."""
        passed = [via.phase for via in self._problem.via_points]
        passed += [via.phase for via in self._problem.via_poses]
        return np.unique(np.round([0.0, 1.0, *passed], 9))

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, 6) of the weighted sum of costs.

        Args:
            trajectories: (P, T, 6) rad.
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        gradient = self._settings.obstacle_weight * self.obstacle_gradient(trajectories, progress)
        for weight, cost in self._terms.values():
            gradient += weight * cost(trajectories)[1]
        return gradient

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, 6) of the collision cost alone, unweighted, as `gradient`."""
        first, last = self._settings.edge_width
        width = first * (last / first) ** progress
        return self._collision(trajectories, width, self._settings.margin)[1]

    def _collision(
        self, trajectories: FloatArray, width: float, margin: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the collision cost (P,) of all stages and its gradient (P, T, 6)."""
        count = trajectories.shape[1]
        value, gradient = np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        for stage, cost in self._stages:
            steps = stage.steps(count)
            part = trajectories[:, steps]
            # A cost is scaled to a number of steps: a stage has its share of them.
            share = part.shape[1] / count
            of_stage, slope = cost(part, edge_width=width, margin=margin)
            value += share * of_stage
            gradient[:, steps] += share * slope
        return value, gradient

    def costs(self, trajectories: FloatArray) -> dict[str, FloatArray]:
        """Return the unweighted costs (P,) by name, with the map's edge at its last width."""
        width = self._settings.edge_width[1]
        costs = {"obstacles": self._collision(trajectories, width, 0.0)[0]}
        return costs | {name: cost(trajectories)[0] for name, (_, cost) in self._terms.items()}
