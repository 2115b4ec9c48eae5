"""The mean carried by a flow out of the obstacles. The baseline ProMPs-Diff."""

from __future__ import annotations

import math

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.gaussian import one_gaussian
from smp_planner.adaptation.runs import SceneCosts
from smp_planner.collision.costs import REFERENCE_STEPS
from smp_planner.movement_primitives import ProMP, phases
from smp_planner.strict_settings import StrictSettings

__all__ = ["FlowSettings", "flow"]


class FlowSettings(StrictSettings):
    """Settings of ProMPs-Diff.

    Attributes:
        iterations: steps in which the flow is followed.
        flow_time: longest step, in the flow's own time.
        longest_move: rad (or the unit of the path), by which no coordinate of any waypoint moves
            farther in a step.
        fit_std: same unit, by which the weights' path may miss the one that the flow leads to, at
            each of `costs.REFERENCE_STEPS` steps.
        taper: phase from a pinned one over which the flow rises to its full strength.
    """

    iterations: int = Field(default=100, ge=1)
    flow_time: float = Field(default=0.1, gt=0.0, allow_inf_nan=False)
    longest_move: float = Field(default=0.02, gt=0.0, allow_inf_nan=False)
    fit_std: float = Field(default=0.1, gt=0.0, allow_inf_nan=False)
    taper: float = Field(default=0.15, gt=0.0, le=0.5)


@one_gaussian
def flow(
    primitive: ProMP,
    scene: SceneCosts,
    rng: np.random.Generator,
    settings: FlowSettings,
) -> tuple[Tensor, Tensor]:
    """Return a Gaussian whose mean left the obstacles along a flow, with the prior's covariance.

    Each waypoint y of the mean path follows dy/ds = -b(t) ∇f_map(y), which is a diffeomorphism of
    the configurations as long as the flow is followed in short steps; f_map is the squared
    occupancy of all spheres, Eq. (12). b is zero at what is pinned: both ends, and what must be
    passed. The path is then fitted by weights, by least squares with the prior as regulariser:
    without it, a path that the flow tore has weights far from all that was demonstrated.
    """
    at = phases(scene.steps)
    strength = _strength(at.numpy(), scene.pins, settings.taper)
    path = primitive.trajectory(primitive.mean, at).numpy()
    for iteration in range(settings.iterations):
        progress = iteration / max(settings.iterations - 1, 1)
        slope = scene.obstacle_gradient(path[None], progress)[0]
        velocity = -strength[:, None] * slope
        fastest = np.abs(velocity).max()
        longest = settings.longest_move / max(fastest, 1e-12)
        path = path + min(settings.flow_time, longest) * velocity
    return _fitted(primitive, torch.from_numpy(path), settings.fit_std), torch.eye(
        primitive.rank, dtype=torch.float64
    )


def _strength(at: FloatArray, pins: FloatArray, taper: float) -> FloatArray:
    """Return b (T,) at phases (T,): 0 at what is pinned, smoothly rising to 1 a taper away.

    Where pins are nearer to each other than two tapers, the taper is half their least distance.
    """
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
