"""The Gaussian nearest to the prior that keeps chance constraints. The baseline CProMPs of Frank.

The method is that of Frank, Paraschos, van der Smagt & Cseke, Constrained Probabilistic Movement
Primitives for Robot Trajectory Adaptation, IEEE T-RO 2022: the divergence from the primitive is
minimised subject to bounds on the probability of what must not happen, by L-BFGS and multipliers
that are updated by factors; moments of what is not linear in the weights are those of the unscented
transform. Read from there are the objective, chance constraints, unscented transform and L-BFGS.
The reading is ours where this says: each sphere at each step has a constraint of its own, with one
risk for all; a clearance is taken to be normal, so that the constraint is mean - z std >= margin;
the factors of the multipliers are those of the exponential method (`inference.multipliers`); the
risk falls to its value round by round, so that the path is never far from what is allowed;
multipliers have a floor, since a sphere that an obstacle is far from now may meet it later; and
what is no constraint here (the robot's own links, velocities, goals and via-points beyond what was
conditioned on, obstacles that move) keeps its cost, averaged over draws that stay the same.

The transform sees a clearance at 13 configurations of six joints, most of them 2.6 standard
deviations from the mean. With a prior that is wide for the obstacles they may all be free while
draws between them are not: constraints are then met by the transform's moments alone.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import Field
from scipy.optimize import minimize
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.gaussian import one_gaussian
from smp_planner.adaptation.runs import SceneCosts, StepConstraint
from smp_planner.collision.clearances import Clearances
from smp_planner.inference.multipliers import penalty, penalty_slope, updated_multipliers
from smp_planner.inference.unscented import sigma_points, unscented_moments
from smp_planner.movement_primitives import ProMP
from smp_planner.strict_settings import StrictSettings

__all__ = [
    "ChanceSettings",
    "ConstrainedGaussian",
    "Lagrangian",
    "chance_constrained",
    "constrained_gaussian",
]

_LEAST_STD = 1e-5
"""Rad or extents, added to what joints deviate by: where a path is held, a covariance is zero."""

_LEAST_CLEARANCE_STD = 1e-6
"""M, rad or extents: the square root has no slope at zero."""

_TIGHT = 2.0 / 3.0
"""Share of the rounds after which the risk is that asked for."""

_HELD = 1e-6
"""Rad or extents: a step at which the prior deviates by no more is as it is."""


class ChanceSettings(StrictSettings):
    """Settings of the constrained Gaussian.

    Attributes:
        risk: α, probability with which a sphere at a step may be nearer than the margin. It falls
            to that from 1 - α, its quantile evenly, and stays in the last third of the rounds.
        rounds: updates of the multipliers.
        iterations: of L-BFGS in each round, at most.
        draws: of each sign, over which the costs that are no constraints are averaged.
        growth: of a multiplier at most, as a multiple of its first value: so far goes what a
            constraint that cannot be kept asks for.
        decay: of a multiplier at most, as a share of its first value: where the path is not, an
            obstacle must not be forgotten. What needs a smaller one is kept with some room.
    """

    risk: float = Field(default=0.01, gt=0.0, lt=0.5)
    rounds: int = Field(default=20, ge=1)
    iterations: int = Field(default=20, ge=1)
    draws: int = Field(default=10, ge=1)
    growth: float = Field(default=30.0, ge=1.0, allow_inf_nan=False)
    decay: float = Field(default=0.3, gt=0.0, le=1.0)


class ConstrainedGaussian(NamedTuple):
    """A Gaussian with the multipliers of its constraints.

    Attributes:
        mean: (r,) in the prior's whitened coordinates.
        factor: (r, r) lower triangular.
        multipliers: Lagrange's of each constraint of the scene, (S, M), per m, rad or extent:
            steps, without those at which the path is held, and clearances.
    """

    mean: Tensor
    factor: Tensor
    multipliers: tuple[Tensor, ...]


class _Constraint(NamedTuple):
    """A constraint of the scene with the steps at which it can be acted upon."""

    of_scene: StepConstraint
    steps: Tensor


class _Clear(torch.autograd.Function):
    """Clearances (..., M) of configurations (..., D)."""

    @staticmethod
    def forward(ctx: Any, configurations: Tensor, clearances: Clearances) -> Tensor:
        flat = np.ascontiguousarray(configurations.detach().flatten(0, -2).numpy())
        ctx.flat, ctx.clearances, ctx.shape = flat, clearances, configurations.shape
        return torch.from_numpy(clearances(flat)).unflatten(0, configurations.shape[:-1])

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None]:
        by_clearance = np.ascontiguousarray(slopes[0].flatten(0, -2).numpy())
        gradient = ctx.clearances.pull_back(ctx.flat, by_clearance)
        return torch.from_numpy(gradient).reshape(ctx.shape), None


class _MeanCost(torch.autograd.Function):
    """Mean cost of trajectories (P, T, D) by a function of them and its gradient."""

    @staticmethod
    def forward(
        ctx: Any,
        trajectories: Tensor,
        cost: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    ) -> Tensor:
        value, gradient = cost(np.ascontiguousarray(trajectories.detach().numpy()))
        ctx.save_for_backward(torch.from_numpy(gradient / len(gradient)))
        return trajectories.new_tensor(value.mean())

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None]:
        return slopes[0] * ctx.saved_tensors[0], None


class Lagrangian:
    """KL(q || p) with the penalties of constraints, and the mean of what costs besides.

    A function of the parameters (r + r (r + 1) / 2,) of q: its mean, the logarithms of the diagonal
    of its factor and the rest of that by rows, in the coordinates in which p is N(0, I).

    Args:
        primitive: p.
        scene: gives constraints and costs.
        noise: (P, r) standard normals at which the costs are taken.
        quantile: of the first round.

    Attributes:
        constraints: of the scene, those that can be acted upon.
        multipliers: ν of each, (S, M).
        progress: 0 in the first round to 1 in the last.
        quantile: standard deviations that a mean clearance must exceed its margin by.
    """

    def __init__(self, primitive: ProMP, scene: SceneCosts, noise: Tensor, quantile: float) -> None:
        self._rank, self._noise, self._scene = primitive.rank, noise, scene
        self._mean = primitive.trajectory(primitive.mean, scene.steps)
        columns = primitive.trajectory(primitive.factor.mT.contiguous(), scene.steps)
        self._columns = columns.permute(1, 2, 0).contiguous()
        self._below = torch.tril_indices(self._rank, self._rank, -1)
        moves = self._columns.square().sum(-1).amax(-1).sqrt() > _HELD
        steps = torch.arange(scene.steps)
        self.constraints: list[_Constraint] = []
        self.multipliers: list[Tensor] = []
        self.progress, self.quantile = 0.0, quantile
        for constraint in scene.step_constraints():
            own = steps[constraint.steps]
            own = own[moves[own]]
            if len(own):
                count = constraint.clearances(self._mean[own[:1]].numpy()).shape[1]
                self.constraints.append(_Constraint(constraint, own))
                self.multipliers.append(
                    torch.full((len(own), count), constraint.weight, dtype=torch.float64)
                )

    def prior(self) -> FloatArray:
        """Return the parameters of the prior."""
        return np.zeros(2 * self._rank + self._below.shape[1])

    def gaussian(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean (r,) and factor (r, r) of parameters."""
        mean, logarithms, below = parameters.split([self._rank, self._rank, self._below.shape[1]])
        factor = torch.diag(logarithms.exp()).index_put(tuple(self._below), below)
        return mean, factor

    def excesses(self, mean: Tensor, factor: Tensor) -> list[Tensor]:
        """Return by how many widths the constraints are missed, (S, M) each."""
        paths = self._mean + self._columns @ mean
        roots = self._columns @ factor
        least = _LEAST_STD**2 * torch.eye(paths.shape[-1], dtype=paths.dtype)
        points = sigma_points(paths, roots @ roots.mT + least)
        found = []
        for constraint in self.constraints:
            own: Tensor = _Clear.apply(points[constraint.steps], constraint.of_scene.clearances)
            middle, variance = unscented_moments(own)
            std = (variance + _LEAST_CLEARANCE_STD**2).sqrt()
            margin = torch.as_tensor(constraint.of_scene.margin, dtype=middle.dtype)
            missed = margin + self.quantile * std - middle
            found.append(missed / constraint.of_scene.width)
        return found

    def __call__(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """Return the value and its gradient by the parameters."""
        given = torch.from_numpy(parameters).clone().requires_grad_()
        with torch.enable_grad():
            mean, factor = self.gaussian(given)
            value = 0.5 * (mean.square().sum() + factor.square().sum() - self._rank)
            value = value - given[self._rank : 2 * self._rank].sum()
            for multipliers, excess in zip(
                self.multipliers, self.excesses(mean, factor), strict=True
            ):
                value = value + (multipliers * penalty(excess)).sum()
            latent = mean + self._noise @ factor.mT
            flat = self._columns.flatten(0, 1)
            drawn = self._mean + (latent @ flat.mT).unflatten(-1, self._mean.shape)
            value = value + _MeanCost.apply(drawn, self._other_costs)
            (gradient,) = torch.autograd.grad(value, given)
        return float(value.detach()), gradient.numpy()

    def _other_costs(self, trajectories: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._scene.evaluate_others(trajectories, self.progress)

    def lagrange_multipliers(self, parameters: FloatArray) -> tuple[Tensor, ...]:
        """Return Lagrange's multipliers, (S, M) each, where the parameters are a minimum."""
        excesses = self.excesses(*self.gaussian(torch.from_numpy(parameters)))
        return tuple(
            nu * penalty_slope(excess) / constraint.of_scene.width
            for nu, excess, constraint in zip(
                self.multipliers, excesses, self.constraints, strict=True
            )
        )

    def update(self, parameters: FloatArray, settings: ChanceSettings) -> None:
        """Update the multipliers ν where the Lagrangian was minimised.

        Args:
            parameters: that minimise it.
            settings: bounds of the multipliers.
        """
        excesses = self.excesses(*self.gaussian(torch.from_numpy(parameters)))
        for index, (constraint, excess) in enumerate(zip(self.constraints, excesses, strict=True)):
            first = constraint.of_scene.weight
            self.multipliers[index] = updated_multipliers(
                self.multipliers[index], excess, settings.decay * first, settings.growth * first
            )


def constrained_gaussian(
    primitive: ProMP, scene: SceneCosts, rng: np.random.Generator, settings: ChanceSettings
) -> ConstrainedGaussian:
    """Return the Gaussian that is nearest to the prior, KL(q || p), and keeps the constraints.

    In each round L-BFGS goes on from the last one's mean and full lower triangular factor, in the
    whitened coordinates of the prior, with multipliers and the risk brought up to date.

    Args:
        primitive: the prior.
        scene: gives the constraints, and costs for all else.
        rng: draws the standard normals at which those are taken.
        settings: risk, rounds and iterations.
    """
    half = torch.from_numpy(rng.standard_normal((settings.draws, primitive.rank)))
    quantile = NormalDist().inv_cdf(1.0 - settings.risk)
    lagrangian = Lagrangian(primitive, scene, torch.cat([half, -half]), -quantile)
    parameters = lagrangian.prior()
    for round_ in range(settings.rounds):
        last = settings.rounds - 1
        lagrangian.progress = round_ / last if last else 1.0
        tightened = min(lagrangian.progress / _TIGHT, 1.0)
        lagrangian.quantile = (2.0 * tightened - 1.0) * quantile
        limits = {"maxiter": settings.iterations, "maxfun": 2 * settings.iterations}
        found = minimize(lagrangian, parameters, jac=True, method="L-BFGS-B", options=limits)
        parameters = found.x
        if round_ < settings.rounds - 1:
            lagrangian.update(parameters, settings)
    mean, factor = lagrangian.gaussian(torch.from_numpy(parameters))
    return ConstrainedGaussian(mean, factor, lagrangian.lagrange_multipliers(parameters))


@one_gaussian
def chance_constrained(
    primitive: ProMP, scene: SceneCosts, rng: np.random.Generator, settings: ChanceSettings
) -> tuple[Tensor, Tensor]:
    """Return mean and factor of `constrained_gaussian`."""
    found = constrained_gaussian(primitive, scene, rng, settings)
    return found.mean, found.factor
