"""Targets of adaptation: the weighted costs of a problem, Eq. (7), and of a batch of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import StepConstraint
from smp_planner.collision.clearances import JointLimitClearances
from smp_planner.collision.costs import (
    REFERENCE_STEPS,
    CollisionCost,
    CompiledCost,
    Cost,
    JointLimitCost,
    ValueAndGradient,
    steps_scale,
)
from smp_planner.collision.moving_cost import MovingCollisionCost
from smp_planner.planning.bodies import ObstacleCost
from smp_planner.planning.forecasting import parted, robot_of
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.threads import MOST_THREADS, Threads

__all__ = ["SceneTarget", "TargetBatch"]

_FIRST_MULTIPLIER = 0.1
"""Share of an obstacle's weight: unlike an occupancy, what is missing grows with the depth."""

_LIMIT_WIDTH = 0.02
"""Rad, scale of what is missing to joint limits."""


class SceneTarget:
    """The costs of one problem with their weights, -log p(O|w) of Eq. (7).

    Args:
        problem: gives obstacles and constraints.
        settings: weights and widths.
        extra: further costs by name with their weights, functions of trajectories (P, T, D).
        threads: that share the particles; by default, the caller's alone.
        maps: of standing obstacles, if there are some already.
    """

    def __init__(
        self,
        problem: Problem,
        settings: PlanSettings,
        extra: dict[str, tuple[float, Cost]] | None = None,
        threads: Threads | None = None,
        maps: SceneMaps | None = None,
    ) -> None:
        self.problem, self.settings = problem, settings
        self._margin = settings.margin + problem.doubt
        self._threads = threads or Threads(1)
        self._stages: list[tuple[Stage, ObstacleCost]] = []
        self._moving: list[tuple[Stage, MovingCollisionCost]] = []
        if maps is None:
            maps = SceneMaps(settings, problem.seed, threads=self._threads)
        # Maps of few obstacles first: those of more begin with them.
        for stage in sorted(problem.stages, key=lambda stage: len(stage.obstacles)):
            standing, forecast = parted(problem, stage, settings)
            cost = stage.body.obstacle_cost(standing, stage.cloud, maps)
            if cost is not None:
                self._stages.append((stage, cost))
            if forecast is not None:
                self._moving.append((stage, MovingCollisionCost(robot_of(stage), forecast)))
        limits = problem.body.limit_costs(settings)
        self._limits = tuple(limits)
        self._constrained = frozenset(
            name
            for name, (weight, cost) in limits.items()
            if isinstance(cost, JointLimitCost) and weight > 0.0
        )
        terms = dict(limits)
        for constraint in problem.constraints:
            pull = constraint.cost(settings)
            if pull is not None:
                terms[constraint.name] = 1.0, pull
        terms |= extra or {}
        self._terms = {name: term for name, term in terms.items() if term[0] > 0.0}
        # A check against a protocol takes long, so it is made once.
        self._compiled = {
            name: cost for name, (_, cost) in self._terms.items() if isinstance(cost, CompiledCost)
        }

    @property
    def steps(self) -> int:
        """Equal steps of phase at which it is evaluated."""
        return self.settings.planning_steps

    @property
    def pins(self) -> FloatArray:
        """Phases at which trajectories are held, ascending."""
        return self.problem.pins

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs; nothing is checked.

        Args:
            trajectories: (P, T, D), contiguous.
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        return self._weighted(trajectories, self._width(progress))[1]

    def evaluate(self, trajectories: FloatArray, progress: float) -> ValueAndGradient:
        """Return the weighted sum (P,) of costs and its gradient (P, T, D), as `gradient`."""
        return self._weighted(trajectories, self._width(progress))

    def step_constraints(self) -> list[StepConstraint]:
        """Return clearances to standing obstacles, and the joints' to their limits, by step.

        Obstacles begin with `_FIRST_MULTIPLIER` of the weight of their cost, on the scale of the
        last width of the map's edge; joints with the cost of limits `_LIMIT_WIDTH` beyond them.
        """
        settings, count = self.settings, self.steps
        found = []
        share = _FIRST_MULTIPLIER * settings.obstacle_weight * (REFERENCE_STEPS - 1) / (count - 1)
        for stage, cost in self._stages:
            found.append(
                StepConstraint(
                    self.problem.ahead(stage, count),
                    cost.clearances,
                    self._margin,
                    settings.edge_width[1],
                    share * cost.scale,
                )
            )
        for name in self._constrained:
            weight, limits = self._terms[name]
            assert isinstance(limits, JointLimitCost)
            found.append(
                StepConstraint(
                    self._rest(name, count),
                    JointLimitClearances(limits.lower, limits.upper),
                    # Of the lower limits, then of the upper ones.
                    limits.margin if np.ndim(limits.margin) == 0 else np.tile(limits.margin, 2),
                    _LIMIT_WIDTH,
                    weight * _LIMIT_WIDTH**2 * steps_scale(count),
                )
            )
        return found

    def evaluate_others(self, trajectories: FloatArray, progress: float) -> ValueAndGradient:
        """Return `evaluate` of the costs of which `step_constraints` has nothing."""
        return self._weighted(trajectories, self._width(progress), others=True)

    def _rest(self, name: str, count: int) -> slice:
        """Return the steps that a cost sees: limits are kept by what is not done."""
        return self.problem.rest(count) if name in self._limits else slice(0, None)

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the collision cost alone, unweighted, as `gradient`."""
        return self._collision(trajectories, self._width(progress), self._margin)[1]

    def weighted_sum(self, trajectories: FloatArray) -> FloatArray:
        """Return the weighted sum (P,) of costs, with the map's edge at its last width."""
        return self._weighted(trajectories, self.settings.edge_width[1])[0]

    def costs(self, trajectories: FloatArray) -> dict[str, FloatArray]:
        """Return the unweighted costs (P,) by name, with the map's edge at its last width."""
        costs = {"obstacles": self._collision(trajectories, self.settings.edge_width[1], 0.0)[0]}
        return costs | {name: cost(trajectories)[0] for name, (_, cost) in self._terms.items()}

    def _width(self, progress: float) -> float:
        first, last = self.settings.edge_width
        return float(first * (last / first) ** progress)

    def _weighted(
        self, trajectories: FloatArray, width: float, others: bool = False
    ) -> ValueAndGradient:
        """Return the weighted sum (P,) of costs and its gradient (P, T, D).

        Args:
            trajectories: (P, T, D).
            width: of the map's edge.
            others: leave out what is among `step_constraints`.
        """
        left_out = self._constrained if others else frozenset()
        value, gradient = np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        settings = self.settings

        def add(rows: slice) -> None:
            part, total, slope = trajectories[rows], value[rows], gradient[rows]
            self._add_collision(
                part, width, self._margin, settings.obstacle_weight, total, slope, others
            )
            for name, cost in self._compiled.items():
                if self._rest(name, count).start == 0 and name not in left_out:
                    cost.add(part, self._terms[name][0], total, slope)

        count = trajectories.shape[1]
        # The same parts for any number of threads: how the kernels round a row depends on the rows
        # that they are given together with.
        size = -(-len(trajectories) // MOST_THREADS)
        parts = [slice(k, k + size) for k in range(0, len(trajectories), size)]

        def add_all(mine: slice) -> None:
            for rows in parts[mine]:
                add(rows)

        self._threads.over(len(parts), add_all)
        for name, (weight, cost) in self._terms.items():
            rest = self._rest(name, count)
            if name in left_out:
                continue
            if name not in self._compiled or rest.start > 0:
                found, slope = cost(np.ascontiguousarray(trajectories[:, rest]))
                scale = weight * slope.shape[1] / count
                value += scale * found
                gradient[:, rest] += scale * slope
        return value, gradient

    def _collision(self, trajectories: FloatArray, width: float, margin: float) -> ValueAndGradient:
        """Return the collision cost (P,) of all stages and its gradient (P, T, D)."""
        value, gradient = np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        self._add_collision(trajectories, width, margin, 1.0, value, gradient)
        return value, gradient

    def _add_collision(
        self,
        trajectories: FloatArray,
        width: float,
        margin: float,
        weight: float,
        value: FloatArray,
        gradient: FloatArray,
        moving_only: bool = False,
    ) -> None:
        """Add the weighted collision cost of all stages to value (P,) and gradient (P, T, D)."""
        count = trajectories.shape[1]
        # What lies between steps counts, not the steps: so a trajectory whose ends are clear
        # costs the same however finely it is sampled.
        share = weight * (REFERENCE_STEPS - 1) / (count - 1)
        for stage, cost in () if moving_only else self._stages:
            steps = self.problem.ahead(stage, count)
            if steps.start == steps.stop:
                continue
            if isinstance(cost, CollisionCost):
                cost.add_stretch(
                    trajectories, steps.start, steps.stop, width, margin, share, value, gradient
                )
                continue
            of_stage, slope = cost(trajectories[:, steps], width, margin)
            scale = share / steps_scale(slope.shape[1])
            value += scale * of_stage
            gradient[:, steps] += scale * slope
        if not self._moving:
            return
        times = self.problem.clock.times(trajectories, self.problem.robot.velocity)
        for stage, moving in self._moving:
            steps = self.problem.ahead(stage, count)
            if steps.start == steps.stop:
                continue
            of_stage, slope = moving(trajectories[:, steps], times[:, steps], width, margin)
            scale = share / steps_scale(slope.shape[1])
            value += scale * of_stage
            gradient[:, steps] += scale * slope


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
