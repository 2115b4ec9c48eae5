"""Targets of adaptation: the weighted costs of a problem, Eq. (7), and of a batch of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.collision.costs import REFERENCE_STEPS, Cost, ValueAndGradient, steps_scale
from smp_planner.collision.moving import MovingCollisionCost
from smp_planner.planning.bodies import ObstacleCost
from smp_planner.planning.forecasting import parted, robot_of
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.settings import PlanSettings

__all__ = ["SceneTarget", "TargetBatch"]


class SceneTarget:
    """The costs of one problem with their weights, -log p(O|w) of Eq. (7).

    Args:
        problem: gives obstacles and constraints.
        settings: weights and widths.
        extra: further costs by name with their weights, functions of trajectories (P, T, D).
        maps: of standing obstacles, if there are some already.
    """

    def __init__(
        self,
        problem: Problem,
        settings: PlanSettings,
        extra: dict[str, tuple[float, Cost]] | None = None,
        maps: SceneMaps | None = None,
    ) -> None:
        self.problem, self.settings = problem, settings
        self._stages: list[tuple[Stage, ObstacleCost]] = []
        self._moving: list[tuple[Stage, MovingCollisionCost]] = []
        maps = SceneMaps(settings, problem.seed) if maps is None else maps
        for stage in problem.stages:
            standing, forecast = parted(problem, stage, settings)
            cost = stage.body.obstacle_cost(standing, stage.cloud, maps)
            if cost is not None:
                self._stages.append((stage, cost))
            if forecast is not None:
                self._moving.append((stage, MovingCollisionCost(robot_of(stage), forecast)))
        limits = problem.body.limit_costs(settings)
        self._limits = tuple(limits)
        terms = dict(limits)
        for constraint in problem.constraints:
            pull = constraint.cost(settings)
            if pull is not None:
                terms[constraint.name] = 1.0, pull
        terms |= extra or {}
        self._terms = {name: term for name, term in terms.items() if term[0] > 0.0}

    @property
    def steps(self) -> int:
        """Equal steps of phase at which it is evaluated."""
        return self.settings.planning_steps

    @property
    def pins(self) -> FloatArray:
        """Phases at which trajectories are held, ascending."""
        return self.problem.pins

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs.

        Args:
            trajectories: (P, T, D).
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        gradient = self.settings.obstacle_weight * self.obstacle_gradient(trajectories, progress)
        for name, (weight, cost) in self._terms.items():
            rest = self._rest(name, trajectories.shape[1])
            part = trajectories[:, rest]
            share = part.shape[1] / trajectories.shape[1]
            gradient[:, rest] += share * weight * cost(part)[1]
        return gradient

    def _rest(self, name: str, count: int) -> slice:
        """Return the steps that a cost sees: limits are kept by what is not done."""
        clock = self.problem.clock
        return slice(clock.first(count) if clock.phase > 0.0 and name in self._limits else 0, None)

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the collision cost alone, unweighted, as `gradient`."""
        first, last = self.settings.edge_width
        width = first * (last / first) ** progress
        return self._collision(trajectories, width, self.settings.margin)[1]

    def weighted_sum(self, trajectories: FloatArray) -> FloatArray:
        """Return the weighted sum (P,) of costs, with the map's edge at its last width."""
        width, margin = self.settings.edge_width[1], self.settings.margin
        total = self.settings.obstacle_weight * self._collision(trajectories, width, margin)[0]
        for weight, cost in self._terms.values():
            total = total + weight * cost(trajectories)[0]
        return total

    def costs(self, trajectories: FloatArray) -> dict[str, FloatArray]:
        """Return the unweighted costs (P,) by name, with the map's edge at its last width."""
        costs = {"obstacles": self._collision(trajectories, self.settings.edge_width[1], 0.0)[0]}
        return costs | {name: cost(trajectories)[0] for name, (_, cost) in self._terms.items()}

    def _collision(self, trajectories: FloatArray, width: float, margin: float) -> ValueAndGradient:
        """Return the collision cost (P,) of all stages and its gradient (P, T, D)."""
        count = trajectories.shape[1]
        value, gradient = np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        for stage, cost in self._stages:
            steps = self.problem.ahead(stage, count)
            if steps.start == steps.stop:
                continue
            part = trajectories[:, steps]
            # What lies between steps counts, not the steps: so a trajectory whose ends are clear
            # costs the same however finely it is sampled.
            share = (REFERENCE_STEPS - 1) / (count - 1) / steps_scale(part.shape[1])
            of_stage, slope = cost(part, width, margin)
            value += share * of_stage
            gradient[:, steps] += share * slope
        if self._moving:
            times = self.problem.clock.times(trajectories, self.problem.robot.velocity)
            for stage, moving in self._moving:
                steps = self.problem.ahead(stage, count)
                if steps.start == steps.stop:
                    continue
                part = trajectories[:, steps]
                share = (REFERENCE_STEPS - 1) / (count - 1) / steps_scale(part.shape[1])
                of_stage, slope = moving(part, times[:, steps], width, margin)
                value += share * of_stage
                gradient[:, steps] += share * slope
        return value, gradient


class TargetBatch:
    """The targets of B problems, evaluated together.

    Args:
        scenes: B targets of equal numbers of steps.
    """

    def __init__(self, scenes: Sequence[SceneTarget]) -> None:
        self.scenes = tuple(scenes)

    @property
    def steps(self) -> int:
        """T, equal steps of phase at which it is evaluated."""
        return self.scenes[0].steps

    def gradient(self, trajectories: Tensor, progress: float) -> Tensor:
        """Return the gradient (B, P, T, D) of the weighted sums of costs.

        Args:
            trajectories: (B, P, T, D).
            progress: see `SceneTarget.gradient`.
        """
        found = [
            scene.gradient(paths.numpy(), progress)
            for scene, paths in zip(self.scenes, trajectories, strict=True)
        ]
        return torch.from_numpy(found[0][None] if len(found) == 1 else np.stack(found))
