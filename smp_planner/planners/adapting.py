"""What all planners share that adapt the primitive to obstacles: one likelihood, and more tries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from smp_gym.robot.kinematics import UnreachableError
from smp_planner.adaptation import Adaptation
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planners.base import (
    SAMPLES,
    Particles,
    PlannerModel,
    PlannerSettings,
    Stopwatch,
    jaco_with,
)
from smp_planner.planners.likelihood import Likelihood, LikelihoodSettings
from smp_planner.planning.problem import Plan, Problem

__all__ = ["AdaptingPlanner", "AdaptingSettings"]

FloatArray = NDArray[np.float64]


class AdaptingSettings(LikelihoodSettings, Adaptation):
    """Settings of planners that adapt the primitive: the way they do it, and how often they try.

    Attributes:
        retries: how often a scene without a good particle is tried again with twice the width.
    """

    retries: int = Field(default=1, ge=0)


class AdaptingPlanner(PlannerModel):
    """A particle set from the conditioned primitive, adapted to the likelihood of the scene.

    With a mixture as prior, each component has its share of the particles and is adapted on its
    own against the same likelihood.
    """

    Settings: ClassVar[type[PlannerSettings]] = AdaptingSettings
    settings: AdaptingSettings

    def _plan(self, problem: Problem) -> Plan:
        stopwatch = Stopwatch()
        with stopwatch.stage("map"):
            robot = jaco_with(problem)
            likelihood = Likelihood(problem, robot, self.settings)
        best: Plan | None = None
        for attempt in range(self.settings.retries + 1):
            try:
                with stopwatch.stage("conditioning"):
                    drawn = self.draw(problem, robot, 2.0**attempt, through=problem.via_points)
            except UnreachableError:
                # So wide a primitive may be led astray from a goal that it reached before.
                if best is None:
                    raise
                break
            with stopwatch.stage("inference"):
                particles = [self._adapted(problem, robot, part, likelihood) for part in drawn]
                costs = self._costs(particles, likelihood)
            plan = self.plan_of(problem, robot, particles, costs, stopwatch)
            if best is None or plan.good.any() > best.good.any():
                best = plan
            if best.good.any():
                break
        assert best is not None
        return replace(best, timings=stopwatch.timings)

    def _adapted(
        self, problem: Problem, robot: RobotModel, drawn: Particles, likelihood: Likelihood
    ) -> Particles:
        primitive = drawn.tied.primitive
        rng = np.random.default_rng([problem.seed, 3, drawn.component])

        def good(latent: Tensor) -> NDArray[np.bool_]:
            trajectories = primitive.trajectory(primitive.unwhiten(latent), SAMPLES).numpy()
            return self.good(problem, robot, trajectories)

        latent = self.settings.adapt(primitive, drawn.latent, likelihood, rng, good)
        return replace(drawn, latent=latent)

    def _costs(
        self, particles: Sequence[Particles], likelihood: Likelihood
    ) -> dict[str, FloatArray]:
        """Return the costs (P,) by name of the particles of all components."""
        costs = []
        for part in particles:
            primitive = part.tied.primitive
            trajectories = primitive.trajectory(
                primitive.unwhiten(part.latent), self.settings.planning_steps
            )
            costs.append(likelihood.costs(trajectories.numpy()))
        return {name: np.concatenate([c[name] for c in costs]) for name in costs[0]}
