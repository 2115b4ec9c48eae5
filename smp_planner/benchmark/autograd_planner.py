"""A planner that leaves the gradients to autograd, as code for a paper would."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation.runs import Runs
from smp_planner.adaptation.stein import stein
from smp_planner.collision import autograd
from smp_planner.collision.autograd import by_autograd
from smp_planner.collision.costs import (
    REFERENCE_STEPS,
    CollisionCost,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
    steps_scale,
)
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planners.primitive_planner import PrimitivePlanner
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.conditioning import conditioned_parts
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.stopwatch import Stopwatch
from smp_planner.planning.target import SceneTarget, TargetBatch
from smp_planner.planning.tool_constraints import Reaching, ToolPath
from smp_planner.torch_threads import one_thread

__all__ = ["AutogradPlanner", "AutogradTarget"]


def _carried(robot: RobotModel, configurations: Tensor, point: FloatArray) -> Tensor:
    """Return where the hand carries a point (3,), (..., 3) m."""
    pose = robot.link_transforms(configurations)[..., -1, :, :]
    at = torch.as_tensor(robot.carried(point), dtype=pose.dtype)
    return pose[..., :3, :3] @ at + pose[..., :3, 3]


def _outside(points: Tensor, lower: Any, upper: Any) -> Tensor:
    low, high = (torch.as_tensor(np.asarray(x), dtype=points.dtype) for x in (lower, upper))
    return torch.relu(points - high) + torch.relu(low - points)


def _reaching(constraint: Reaching, settings: PlanSettings, trajectories: Tensor) -> Tensor:
    """Return the value (P,) of `Reaching.cost`."""
    sigma, joint = settings.sigma, []
    volumes = [
        float(np.log(goal.upper - goal.lower + np.sqrt(2.0 * np.pi) * sigma).sum())
        for goal in constraint.goals
    ]
    for goal, share, volume in zip(constraint.goals, constraint.shares, volumes, strict=True):
        ends = _carried(constraint.robot, trajectories[:, -1], goal.point)
        off = _outside(ends, goal.lower, goal.upper).square().sum(-1) / (2.0 * sigma**2)
        joint.append(float(np.log(share)) - (volume - min(volumes)) - off)
    return -torch.logsumexp(torch.stack(joint), dim=0)


def _tool_path(constraint: ToolPath, settings: PlanSettings, trajectories: Tensor) -> Tensor:
    """Return the value (P,) of `ToolPath.cost`."""
    total = trajectories.new_zeros(len(trajectories))
    for via in constraint.via_points:
        at = via.phase * (trajectories.shape[1] - 1)
        first = min(int(at), trajectories.shape[1] - 2)
        share = at - first
        due = (1.0 - share) * trajectories[:, first] + share * trajectories[:, first + 1]
        half = settings.via_share * via.tolerance
        points = _carried(constraint.robot, due, via.point)
        off = _outside(points, via.position - half, via.position + half)
        total = total + off.square().sum(-1) / (2.0 * settings.sigma**2)
    return total


class AutogradTarget(SceneTarget):
    """The costs of one problem as of `SceneTarget`, with gradients by autograd.

    Args:
        problem: of a robot.
        settings: weights and widths.
        dtype: of the tensors.
    """

    def __init__(
        self, problem: Problem, settings: PlanSettings, dtype: torch.dtype = torch.float32
    ) -> None:
        super().__init__(problem, settings)
        self._dtype = dtype
        by_type: dict[type, Callable[[Any, Tensor], Tensor]] = {
            SelfCollisionCost: autograd.self_collision,
            JointLimitCost: autograd.joint_limits,
            VelocityLimitCost: autograd.velocity_limits,
        }
        self._functions: list[tuple[float, Callable[[Tensor], Tensor]]] = []
        for name, (weight, cost) in self._terms.items():
            constraint = next((c for c in problem.constraints if c.name == name), None)
            if isinstance(constraint, Reaching):
                self._functions.append((weight, partial(_reaching, constraint, settings)))
            elif isinstance(constraint, ToolPath):
                self._functions.append((weight, partial(_tool_path, constraint, settings)))
            else:
                self._functions.append((weight, partial(by_type[type(cost)], cost)))

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs; see `SceneTarget`."""
        width = self._width(progress)
        paths = torch.as_tensor(trajectories, dtype=self._dtype)
        return by_autograd(partial(self.value, width=width), paths)[1]

    def value(self, trajectories: Tensor, width: float) -> Tensor:
        """Return the weighted sum (P,) of costs at trajectories (P, T, D).

        Args:
            trajectories: (P, T, D).
            width: of the map's edge, m.
        """
        count, settings = trajectories.shape[1], self.settings
        total = trajectories.new_zeros(len(trajectories))
        for stage, cost in self._stages:
            if not isinstance(cost, CollisionCost):
                raise TypeError(f"only the costs of robots have a twin in torch, got {cost!r}")
            part = trajectories[:, stage.steps(count)]
            share = (REFERENCE_STEPS - 1) / (count - 1) / steps_scale(part.shape[1])
            found = autograd.map_collision(cost, part, width, settings.margin)
            total = total + settings.obstacle_weight * share * found
        for weight, function in self._functions:
            total = total + weight * function(trajectories)
        return total


class AutogradPlanner:
    """Stein Movement Primitives with gradients by autograd; one try, each part on its own.

    Args:
        demonstrations: what to learn from.
        settings: as of the planner "smp".
    """

    def __init__(self, demonstrations: Demonstrations, **settings: Any) -> None:
        self._planner = PrimitivePlanner(demonstrations, "smp", settings)

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem."""
        with one_thread():
            return [self._plan(problem) for problem in problems]

    def _plan(self, problem: Problem) -> Plan:
        planner, stopwatch = self._planner, Stopwatch()
        settings = planner.plan_settings
        with stopwatch.stage("map"):
            target = AutogradTarget(problem, settings)
        with stopwatch.stage("conditioning"):
            parts = conditioned_parts(planner.prior, problem, settings)
        found, weights = [], []
        with stopwatch.stage("inference"):
            for part in parts:
                runs = Runs.of([part.primitive], settings.planning_steps)
                batch = TargetBatch([target])
                latent = stein(runs, part.latent[None], batch, (), planner.adaptation.settings)[0]  # type: ignore[arg-type]
                found.append(0.5 * latent.square().sum(-1))
                weights.append(part.primitive.unwhiten(latent))
        with stopwatch.stage("verification"):
            paths = planner.prior.single.trajectory(torch.cat(weights), settings.samples).numpy()
            plan = make_plan(problem, paths, {"prior": torch.cat(found).numpy()}, settings)
        return plan.changed(timings=stopwatch.timings)
