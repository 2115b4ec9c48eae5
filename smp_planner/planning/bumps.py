"""Bumps on the conditioned mean: a few numbers that say how a primitive goes round obstacles.

To the mean of the primitive, conditioned as `smp` conditions it, smooth functions of the phase are
added in each joint. Where the trajectory is held on its course (via-points, the poses of a push),
what a bump would change there is conditioned away: of a Gaussian prior, adding it before
conditioning adds (I - K H) of it afterwards. So every trajectory meets the constraints as the mean
does, and no number is lost on what they forbid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray, checked_count
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.collision.sampled_clearance import sampled_clearance
from smp_planner.collision.verification import minimum_duration, within_joint_limits
from smp_planner.movement_primitives import ProMP
from smp_planner.planning.bodies import RobotBody
from smp_planner.planning.constraints import ToolPath
from smp_planner.planning.pipeline import condition
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.torch_threads import one_thread

__all__ = [
    "BumpedMean",
    "SoftenedCheck",
    "bump_functions",
    "bumped_mean",
    "moved",
    "scale_of",
    "softened",
]

_BETWEEN = 0.003
"""Metres of clearance demanded at the samples of the softened check, for what lies between them."""


def bump_functions(count: int, samples: int) -> FloatArray:
    """Return (F, T): raised cosines at equal distances, each zero with its slope at both ends.

    Neighbours overlap by half, and away from the ends all of them sum to one.

    Args:
        count: F.
        samples: T equal steps of phase.
    """
    count = checked_count("count", count)
    phase = np.linspace(0.0, 1.0, samples)
    centre = np.arange(1, count + 1)[:, None] / (count + 1)
    reach = np.clip((phase - centre) * (count + 1), -1.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(math.pi * reach)))


@dataclass(frozen=True, eq=False)
class BumpedMean:
    """The conditioned mean of a problem, and how numbers change it.

    Attributes:
        problem: that was conditioned on.
        posterior: the primitive, conditioned.
        changes: (F, K*D) by which the weights change for each number, functions first.
        mean: (T, D) rad.
        directions: (F, T, D) rad, by which the mean changes for each number.
    """

    problem: Problem
    posterior: ProMP
    changes: Tensor
    mean: FloatArray
    directions: FloatArray

    def trajectories(self, numbers: FloatArray, stride: int = 1) -> FloatArray:
        """Return the trajectories (C, T, D) rad of numbers (C, F), or every so many samples."""
        return moved(self.mean[::stride], self.directions[:, ::stride], numbers)

    def weights(self, numbers: FloatArray) -> Tensor:
        """Return the weights (C, K*D) of numbers (C, F)."""
        return self.posterior.mean + torch.from_numpy(numbers) @ self.changes

    def surprise(self, numbers: FloatArray) -> FloatArray:
        """Return -log of the density (C,) of numbers (C, F) under the primitive, less a constant.

        It is that of the nearest weights that are possible.
        """
        latent = self.posterior.whiten(self.weights(numbers))
        return np.asarray(0.5 * latent.square().sum(-1).numpy())


def moved(mean: FloatArray, directions: FloatArray, numbers: FloatArray) -> FloatArray:
    """Return mean (T, D) + numbers (C, F) times directions (F, T, D), as (C, T, D)."""
    changed = numbers @ directions.reshape(len(directions), -1)
    return np.asarray(mean + changed.reshape(len(numbers), *mean.shape))


def bumped_mean(
    prior: ProMP, problem: Problem, settings: PlanSettings, functions: FloatArray
) -> BumpedMean | None:
    """Return the conditioned mean of a problem, or None if its goal is out of reach.

    Of goals or poses between which the primitive may choose it is the likeliest.

    Args:
        prior: a component of it.
        problem: to be conditioned on.
        settings: widths of the constraints.
        functions: (B, T) of the phase, at equal steps; F is B times D.
    """
    samples = functions.shape[1]
    with one_thread():
        try:
            branches = condition(prior, problem.constraints, settings)
        except UnreachableError:
            return None
        posterior = max(branches, key=lambda branch: branch[1])[0]
        changes = _changes(prior, posterior, torch.from_numpy(functions))
        mean = posterior.trajectory(posterior.mean, samples).numpy()
        directions = prior.trajectory(changes, samples).numpy()
    return BumpedMean(problem, posterior, changes, mean, directions)


def _changes(prior: ProMP, posterior: ProMP, functions: Tensor) -> Tensor:
    """Return (F, K*D): what (I - K H) leaves of each function in each joint."""
    phase = torch.linspace(0.0, 1.0, functions.shape[1], dtype=torch.float64)
    values = prior.basis.values(phase)
    weights = torch.linalg.lstsq(values, functions.mT).solution.mT
    joints = torch.eye(prior.dimension, dtype=torch.float64)
    # Function by joint by weight (basis first, joint last).
    added = torch.einsum("fk,jd->fjkd", weights, joints).flatten(0, 1).flatten(1)
    latent = prior.whiten(prior.mean + added)
    kept = posterior.whiten_gradient(latent @ (prior.factor / prior.factor.square().sum(0)).mT)
    return kept @ posterior.factor.mT


class SoftenedCheck:
    """The planners' exact check at the samples of trajectories alone, quickly, and softened.

    Distances to obstacles are exact, and so are joint limits, duration and via-points; a trajectory
    whose clearance at its samples is above a few millimetres is taken to be clear between them.

    Args:
        problem: to be solved; its obstacles are taken to stand where they are.
        samples: T of the trajectories.
        floor: m, least clearance told apart.
        duration_limit: s, within which a trajectory must be feasible.
    """

    def __init__(
        self, problem: Problem, samples: int, floor: float = -0.03, duration_limit: float = 15.0
    ) -> None:
        self.problem, self.floor, self._duration_limit = problem, floor, duration_limit
        self._parts = [
            (stage.body.model, PackedObstacles.of(stage.obstacles), stage.steps(samples))
            for stage in problem.stages
            if isinstance(stage.body, RobotBody)
        ]
        self._via = [c for c in problem.constraints if isinstance(c, ToolPath)]

    def clearance(self, trajectories: FloatArray) -> FloatArray:
        """Return the clearance (C,) m of trajectories (C, T, n) rad beyond what is demanded.

        It is the floor where they break a limit, miss a via-point or touch themselves.
        """
        robot = self.problem.robot
        valid = within_joint_limits(trajectories, robot)
        valid &= minimum_duration(trajectories, robot.velocity) <= self._duration_limit
        for constraint in self._via:
            valid &= constraint.missed(trajectories) <= 0.0
        least = self.floor
        clearance = np.where(valid, -least, least)
        for model, obstacles, steps in self._parts:
            open_ = np.flatnonzero(clearance > least)
            part = trajectories[open_, steps]
            found = sampled_clearance(part, model, obstacles, least, -least)
            clearance[open_] = np.minimum(clearance[open_], found)
        return np.asarray(np.where(clearance > least, clearance - _BETWEEN, least))

    def score(self, trajectories: FloatArray, softness: float) -> FloatArray:
        """Return (C,) in [0, 1]: a sigmoid of the clearance, 0 at the floor.

        Args:
            trajectories: (C, T, n) rad.
            softness: m of clearance.
        """
        clearance = self.clearance(trajectories)
        return softened(clearance, self.floor, softness)


def softened(clearance: FloatArray, floor: float, softness: float) -> FloatArray:
    """Return a sigmoid of clearances (C,) m, 0 at the floor."""
    score = 1.0 / (1.0 + np.exp(-clearance / softness))
    return np.asarray(np.where(clearance > floor, score, 0.0))


def scale_of(found: Sequence[BumpedMean]) -> FloatArray:
    """Return (F,) numbers that move a joint by about 1 rad: more where much is conditioned away."""
    moved_by = [np.abs(each.directions).max(axis=(1, 2)) for each in found]
    return np.asarray(1.0 / np.maximum(np.median(moved_by, axis=0), 1e-2))
