"""`promp_diff`: the mean carried by a flow out of the obstacles. The baseline ProMPs-Diff."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from smp_planner.costs import REFERENCE_STEPS
from smp_planner.movement_primitives import ProMP, phases
from smp_planner.planners.gaussian import GaussianPlanner, GaussianSettings
from smp_planner.planners.likelihood import Likelihood
from smp_planner.problem import Problem

__all__ = ["ProMPDiffPlanner", "ProMPDiffSettings"]

FloatArray = NDArray[np.float64]


class ProMPDiffSettings(GaussianSettings):
    """Settings of ProMPs-Diff.

    Attributes:
        margin: see `LikelihoodSettings`; more than usual, because the flow ends where the map
            does, and draws around the mean that keep the prior's spread need room.
        edge_width: see `LikelihoodSettings`; wider at first, for the same reason.
        iterations: steps in which the flow is followed.
        flow_time: longest step, in the flow's own time.
        longest_move: rad, by which no joint of any waypoint moves farther in a step.
        fit_std: rad, by which the weights' path may miss the one that the flow leads to, at each of
            `costs.REFERENCE_STEPS` steps.
        taper: phase from a pinned one over which the flow rises to its full strength.
    """

    margin: float = Field(default=0.03, ge=0.0)
    edge_width: tuple[float, float] = (0.1, 0.01)
    iterations: int = Field(default=100, ge=1)
    flow_time: float = Field(default=0.1, gt=0.0, allow_inf_nan=False)
    longest_move: float = Field(default=0.02, gt=0.0, allow_inf_nan=False)
    fit_std: float = Field(default=0.1, gt=0.0, allow_inf_nan=False)
    taper: float = Field(default=0.15, gt=0.0, le=0.5)


class ProMPDiffPlanner(GaussianPlanner):
    """A Gaussian whose mean left the obstacles along a flow, and whose covariance is the prior's.

    Each waypoint y of the mean path follows dy/ds = -b(t) ∇f_map(y), which is a diffeomorphism of
    the configurations as long as the flow is followed in short steps; f_map is the squared
    occupancy of all spheres, Eq. (12). b is zero at what is pinned: both ends, via-points and
    via-poses. The path is then fitted by weights, by least squares with the prior as regulariser:
    without it, a path that the flow tore has weights far from all that was demonstrated.
    """

    name = "promp_diff"
    Settings = ProMPDiffSettings
    settings: ProMPDiffSettings

    def _adapt_gaussian(
        self,
        problem: Problem,
        primitive: ProMP,
        likelihood: Likelihood,
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        s = self.settings
        at = phases(s.planning_steps)
        strength = _strength(at.numpy(), problem, s.taper)
        path = primitive.trajectory(primitive.mean, at).numpy()
        for iteration in range(s.iterations):
            progress = iteration / max(s.iterations - 1, 1)
            slope = likelihood.obstacle_gradient(path[None], progress)[0]
            velocity = -strength[:, None] * slope
            fastest = np.abs(velocity).max()
            path = path + min(s.flow_time, s.longest_move / max(fastest, 1e-12)) * velocity
        return _fitted(primitive, torch.from_numpy(path), s.fit_std), torch.eye(
            primitive.rank, dtype=torch.float64
        )


def _strength(at: FloatArray, problem: Problem, taper: float) -> FloatArray:
    """Return b (T,) at phases (T,): 0 at what is pinned, smoothly rising to 1 a taper away.

    Where pins are nearer to each other than two tapers, the taper is half their least distance.
    """
    passed = [via.phase for via in problem.via_points] + [via.phase for via in problem.via_poses]
    pins = np.unique(np.round([0.0, 1.0, *passed], 9))
    width = min(taper, np.diff(pins).min() / 2)
    share = np.clip(np.abs(at[:, None] - pins).min(axis=1) / width, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def _fitted(primitive: ProMP, path: Tensor, std: float) -> Tensor:
    """Return the weights that fit a path (T, D) best, in whitened coordinates (r,).

    They minimise |Φ w - y|² / `std`² - 2 log p(w), ridge regression with the prior for a ridge; the
    sum of squares is scaled to `REFERENCE_STEPS` steps.
    """
    steps = len(path)
    scale = math.sqrt(REFERENCE_STEPS / steps) / std
    by_direction = primitive.basis.values(phases(steps)) @ primitive.factor.mT.unflatten(
        -1, (primitive.basis.count, primitive.dimension)
    )
    columns = by_direction.flatten(-2).mT * scale
    missing = (path - primitive.trajectory(primitive.mean, steps)).flatten() * scale
    identity = torch.eye(primitive.rank, dtype=missing.dtype)
    return torch.linalg.solve(columns.mT @ columns + identity, columns.mT @ missing)
