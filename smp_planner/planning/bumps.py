"""Bumps on the conditioned mean: a few numbers that say how a primitive goes round obstacles.

To the mean of the primitive, conditioned as `smp` conditions it, smooth functions of the phase are
added in each joint. Where the trajectory is held on its course (via-points, the poses of a push),
they vanish: bumps of the primitive's own shape do by themselves, and of given functions what they
would change there is conditioned away: of a Gaussian prior, adding one before conditioning adds
(I - K H) of it afterwards. So every trajectory meets the constraints as the mean does, and no
number is lost on what they forbid, but for what conditioning leaves uncertain or takes to be
linear, such as the posture at a goal: large numbers can miss it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray, checked_count
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.collision.sampled_clearance import sampled_clearance
from smp_planner.collision.verification import minimum_duration, within_joint_limits
from smp_planner.movement_primitives import ProMP
from smp_planner.planning.conditioning import condition
from smp_planner.planning.problem import Problem
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.settings import PlanSettings
from smp_planner.torch_threads import one_thread

__all__ = [
    "BumpedMean",
    "SoftenedCheck",
    "bump_phases",
    "bumped_mean",
    "mean_with_functions",
    "moved",
    "scale_of",
    "softened",
]

_BETWEEN = 0.003
"""Metres of clearance demanded at the samples of the softened check, for what lies between them."""


def bump_phases(count: int) -> FloatArray:
    """Return the phases (B,) of so many bumps, at equal distances from each other and the ends."""
    count = checked_count("count", count)
    return np.arange(1, count + 1) / (count + 1)


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

    def trajectories(self, numbers: FloatArray) -> FloatArray:
        """Return the trajectories (C, T, D) rad of numbers (C, F)."""
        return moved(self.mean, self.directions, numbers)

    def resampled(self, samples: int) -> BumpedMean:
        """Return the same with as many equal steps of phase, from 0 to 1."""
        mean = self.posterior.trajectory(self.posterior.mean, samples).numpy()
        directions = self.posterior.trajectory(self.changes, samples).numpy()
        return replace(self, mean=mean, directions=directions)

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
    prior: ProMP, problem: Problem, settings: PlanSettings, phases: FloatArray, samples: int = 200
) -> BumpedMean | None:
    """Return the conditioned mean with bumps of the primitive's own shape, or None out of reach.

    A bump is how the conditioned primitive changes when one joint is observed elsewhere at one
    phase, the covariance of the weights with the joint there: as smooth, and as wide, as the
    primitive itself, and gone where it is held.

    Args:
        prior: a component of it.
        problem: to be conditioned on; None is returned where its goal is out of reach.
        settings: widths of the constraints.
        phases: (B,) of the bumps; F is B times D. A number of 1 would move a joint by 1 rad there,
            were there no constraints.
        samples: T equal steps of phase.
    """
    posterior = _conditioned(prior, problem, settings)
    if posterior is None:
        return None
    with one_thread():
        at = prior.basis.values(torch.from_numpy(phases))
        joints = torch.eye(prior.dimension, dtype=at.dtype)
        rows = torch.einsum("bk,jd->bjkd", at, joints).flatten(0, 1).flatten(1)
        variance = (rows @ prior.factor).square().sum(-1, keepdim=True)
        changes = rows @ posterior.factor @ posterior.factor.mT / variance
        return _changed(prior, posterior, problem, changes, samples)


def mean_with_functions(
    prior: ProMP, problem: Problem, settings: PlanSettings, functions: FloatArray
) -> BumpedMean | None:
    """Return the conditioned mean with given functions of the phase, or None out of reach.

    Args:
        prior: a component of it.
        problem: to be conditioned on; None is returned where its goal is out of reach.
        settings: widths of the constraints.
        functions: (B, T) of the phase, at equal steps; F is B times D.
    """
    posterior = _conditioned(prior, problem, settings)
    if posterior is None:
        return None
    with one_thread():
        changes = _left_of(prior, posterior, torch.from_numpy(functions))
        return _changed(prior, posterior, problem, changes, functions.shape[1])


def _conditioned(prior: ProMP, problem: Problem, settings: PlanSettings) -> ProMP | None:
    """Return the likeliest branch of the conditioned primitive, or None if there is none."""
    with one_thread():
        try:
            branches = condition(prior, problem.constraints, settings)
        except UnreachableError:
            return None
    return max(branches, key=lambda branch: branch[1])[0]


def _changed(
    prior: ProMP, posterior: ProMP, problem: Problem, changes: Tensor, samples: int
) -> BumpedMean:
    mean = posterior.trajectory(posterior.mean, samples).numpy()
    directions = prior.trajectory(changes, samples).numpy()
    return BumpedMean(problem, posterior, changes, mean, directions)


def _left_of(prior: ProMP, posterior: ProMP, functions: Tensor) -> Tensor:
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

    Distances to obstacles are exact, and so are joint limits, duration and constraints; what is
    clear by more than a few millimetres at its samples is taken to be clear between them.

    Args:
        problem: to be solved; its obstacles are taken to stand where they are.
        samples: T of the trajectories, at equal steps of phase from 0 to 1.
        floor: m, least clearance told apart.
        settings: limit of the duration, and what constraints may be missed by; by default those of
            `PlanSettings`.
    """

    def __init__(
        self,
        problem: Problem,
        samples: int,
        floor: float = -0.03,
        settings: PlanSettings | None = None,
    ) -> None:
        self.problem, self.floor = problem, floor
        self._settings = settings or PlanSettings()
        self._parts = [
            (stage.body.model, PackedObstacles.of(stage.obstacles), stage.steps(samples))
            for stage in problem.stages
            if isinstance(stage.body, RobotBody)
        ]

    def clearance(self, trajectories: FloatArray) -> FloatArray:
        """Return the clearance (C,) m of trajectories (C, T, n) rad beyond what is demanded.

        What a constraint is missed by, beyond its slack, is clearance that lacks. It is the floor
        where they break a limit or touch themselves.
        """
        robot, settings = self.problem.robot, self._settings
        valid = within_joint_limits(trajectories, robot)
        valid &= minimum_duration(trajectories, robot.velocity) <= settings.duration_limit
        least = self.floor
        clearance = np.where(valid, -least, least)
        for constraint in self.problem.constraints:
            beyond = constraint.missed(trajectories) - constraint.slack(settings)
            clearance = np.where(beyond > 0.0, np.minimum(clearance, -beyond), clearance)
        clearance = np.maximum(clearance, least)
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
