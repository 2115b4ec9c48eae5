"""`smp`: Stein Movement Primitives, the paper's Algorithm 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from smp_gym.demonstrations import Demonstrations
from smp_gym.scene import Obstacle
from smp_planner.costs import (
    CarriedBoxCost,
    CollisionCost,
    Cost,
    GoalCost,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
)
from smp_planner.inference import init, named_settings, step
from smp_planner.movement_primitives import phases
from smp_planner.occupancy.grid import DistanceGrid, bake
from smp_planner.occupancy.neural import (
    INFLATION,
    PointNetworkMap,
    sample_labelled_points,
    train_map,
)
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.planners.base import (
    Particles,
    PlannerModel,
    PlannerSettings,
    Stopwatch,
    jaco_with,
)
from smp_planner.planners.tying import TiedPrimitive
from smp_planner.problem import Plan, Problem, Stage
from smp_planner.robot_model import RobotModel, jaco_of_spheres

__all__ = ["SMPPlanner", "SMPSettings"]

FloatArray = NDArray[np.float64]


class SMPSettings(PlannerSettings):
    """Settings of Stein Movement Primitives.

    Attributes:
        map: "shapes" composes networks trained once per obstacle shape; "points" trains one network
            from labelled points of the scene, the paper's way, which takes seconds.
        map_points: how many points "points" learns from.
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
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
        retries: how often a scene without a good particle is tried again with twice the width.
    """

    map: Literal["shapes", "points"] = "shapes"
    map_points: int = Field(default=100_000, ge=100)
    inference: Literal["default", "paper", "no_repulsion"] = "default"
    iterations: int = Field(default=100, ge=1)
    step_size: float | None = Field(default=None, gt=0.0)
    planning_steps: int = Field(default=50, ge=10)
    obstacle_weight: float = Field(default=3.0, gt=0.0)
    self_collision_weight: float = Field(default=3.0, ge=0.0)
    margin: float = Field(default=0.01, ge=0.0)
    edge_width: tuple[float, float] = (0.05, 0.01)
    goal_sigma: float = Field(default=0.005, gt=0.0)
    via_share: float = Field(default=0.5, ge=0.0, le=1.0)
    velocity_weight: float = Field(default=10.0, ge=0.0)
    limit_weight: float = Field(default=100.0, ge=0.0)
    retries: int = Field(default=1, ge=0)


class SMPPlanner(PlannerModel):
    """A particle set from the conditioned primitive, carried to the posterior by SVGD.

    With a mixture as prior, each component has its share of the particles, whitened by its own
    factor, and is a run of its own against the same likelihood. Components are so far apart, in
    units of their own spread, that the kernel and the responsibilities between them vanish: one run
    with all particles would do the same, but for a bandwidth that spans both.
    """

    name = "smp"
    Settings = SMPSettings
    settings: SMPSettings

    def __init__(
        self, demonstrations: Demonstrations, settings: PlannerSettings | None = None
    ) -> None:
        super().__init__(demonstrations, settings)
        s = self.settings
        inference = replace(named_settings(s.inference), iterations=s.iterations)
        if s.step_size is not None:
            inference = replace(inference, step_size=s.step_size)
        self._inference = inference

    def _plan(self, problem: Problem) -> Plan:
        stopwatch = Stopwatch()
        with stopwatch.stage("map"):
            robot = jaco_with(problem)
            likelihood = Likelihood(problem, robot, self.settings)
        best: Plan | None = None
        for attempt in range(self.settings.retries + 1):
            with stopwatch.stage("conditioning"):
                drawn = self.draw(problem, robot, 2.0**attempt, through=problem.via_points)
            with stopwatch.stage("inference"):
                particles, costs = self._infer_all(drawn, likelihood)
            plan = self.plan_of(problem, robot, particles, costs, stopwatch)
            if best is None or plan.good.any() > best.good.any():
                best = plan
            if best.good.any():
                break
        assert best is not None
        return replace(best, timings=stopwatch.timings)

    def _infer_all(
        self, drawn: Sequence[Particles], likelihood: Likelihood
    ) -> tuple[list[Particles], dict[str, FloatArray]]:
        """Run Algorithm 1 for each component and return particles and final costs of all."""
        inferred, costs = [], []
        for part in drawn:
            latent, costs_of_part = self._infer(part.tied, part.latent, likelihood)
            inferred.append(replace(part, latent=latent))
            costs.append(costs_of_part)
        return inferred, {name: np.concatenate([c[name] for c in costs]) for name in costs[0]}

    def _infer(
        self, tied: TiedPrimitive, latent: Tensor, likelihood: Likelihood
    ) -> tuple[Tensor, dict[str, FloatArray]]:
        """Run Algorithm 1 and return particles (P, r), whitened, and their final costs."""
        primitive, whiten = tied.primitive, self._inference.whiten
        steps = self.settings.planning_steps
        values = primitive.basis.values(phases(steps))
        shape = (-1, primitive.basis.count, primitive.dimension)
        state = init(latent if whiten else primitive.unwhiten(latent), self._inference)
        for iteration in range(self._inference.iterations):
            particles = state.particles
            weights = primitive.unwhiten(particles) if whiten else particles
            trajectories = (values @ weights.reshape(shape)).numpy()
            progress = iteration / max(self._inference.iterations - 1, 1)
            gradient = torch.from_numpy(likelihood.gradient(trajectories, progress))
            pulled = (values.mT @ gradient).flatten(-2)
            if whiten:
                prior_score, score = -particles, -primitive.whiten_gradient(pulled)
            else:
                prior_score, score = primitive.score(particles), -pulled
            state = step(state, prior_score, score, self._inference)
            if not whiten:
                # Raw weights leave what conditioning made certain, the start above all.
                state = state._replace(particles=primitive.project(state.particles))
        latent = state.particles if whiten else primitive.whiten(state.particles)
        weights = primitive.unwhiten(latent)
        return latent, likelihood.costs((values @ weights.reshape(shape)).numpy())


def _baked_map(obstacles: tuple[Obstacle, ...], seed: int, settings: SMPSettings) -> DistanceGrid:
    """Return the neural occupancy map of obstacles as a grid of distance."""
    if settings.map == "shapes":
        return bake(ShapeNetworkMap(obstacles, default_networks()))
    rng = np.random.default_rng([seed, 2])
    points, labels = sample_labelled_points(obstacles, settings.map_points, rng)
    network = train_map(points, labels, inflation=INFLATION, seed=seed % 2**63)
    return bake(PointNetworkMap.of(network))


def _via_cost(problem: Problem, robot: RobotModel, settings: SMPSettings) -> CarriedBoxCost:
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

    def __init__(self, problem: Problem, robot: RobotModel, settings: SMPSettings) -> None:
        self._settings = settings
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

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, 6) of the weighted sum of costs.

        Args:
            trajectories: (P, T, 6) rad.
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        first, last = self._settings.edge_width
        width = first * (last / first) ** progress
        _, collision = self._collision(trajectories, width, self._settings.margin)
        gradient = self._settings.obstacle_weight * collision
        for weight, cost in self._terms.values():
            gradient += weight * cost(trajectories)[1]
        return gradient

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
