"""Conditioning: draws of the prior that obey the constraints of a problem, Eq. (13).

The posterior of a Gaussian and a choice of places is a mixture, so one component of the prior
becomes several parts, each with its share of the particles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planning.constraints import Constraint
from smp_planner.planning.prior import Prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings

__all__ = ["Part", "condition", "conditioned_parts"]


@dataclass(frozen=True, eq=False)
class Part:
    """The particles of a plan that have one prior.

    That is a component, conditioned on one option of each constraint.

    Attributes:
        component: index of the component.
        branch: numbers that tell it from others of its component and width; none if it is the only
            one.
        primitive: the component, conditioned.
        latent: (P_c, r) particles in its whitened coordinates.
        memory: what the optimiser remembers of them; None if nothing.
        iteration: how many iterations of inference they went through that are remembered.
        width: factor of the added deviation that the component was widened by.
        log_volume: logarithm of the primitive's standard deviations' product, less that of the
            narrowest part.
    """

    component: int
    branch: tuple[int, ...]
    primitive: ProMP
    latent: Tensor
    memory: Any = None
    iteration: int = 0
    width: float = 1.0
    log_volume: float = 0.0

    @property
    def surprise(self) -> FloatArray:
        """(P_c,) -log of the density of the particles under the primitive, less a constant."""
        return np.asarray(0.5 * self.latent.square().sum(-1).numpy() + self.log_volume)


def condition(
    primitive: ProMP, constraints: Sequence[Constraint], settings: PlanSettings
) -> list[tuple[ProMP, float]]:
    """Return the posterior of a primitive conditioned on constraints, in closed form.

    The posterior of a Gaussian and a mixture of places is a mixture: one branch for each choice of
    options, its share π_h times the density of the place under the primitive. Branches that would
    get no particle are left out.

    Args:
        primitive: the prior.
        constraints: in the order in which they are conditioned on.
        settings: their widths, and how many particles will be shared out.

    Returns:
        Posteriors with their shares, which need not sum to one.

    Raises:
        UnreachableError: a pose or all goal regions are out of reach.
    """
    found = [(primitive, 0.0)]
    for constraint in constraints:
        grown = [
            (conditioned, weight + evidence)
            for posterior, weight in found
            for conditioned, evidence in constraint.condition(posterior, settings)
        ]
        best = max(weight for _, weight in grown)
        found = [
            (posterior, weight - best)
            for posterior, weight in grown
            if weight - best > -math.log(2.0 * settings.particles)
        ]
    return [(posterior, math.exp(weight)) for posterior, weight in found]


def conditioned_parts(
    prior: Prior, problem: Problem, settings: PlanSettings, width: float = 1.0
) -> list[Part]:
    """Return P draws of the prior, conditioned on the constraints of a problem.

    Each component of the prior has its share of the particles; one that reaches no goal gets none,
    and the others share them out.

    Args:
        prior: learned from demonstrations.
        problem: to be solved.
        settings: number of particles, and whether constraints are conditioned on.
        width: factor of the prior's added standard deviation, at least 1.

    Raises:
        UnreachableError: no component reaches a goal.
    """
    constraints = problem.constraints if settings.modulation == "exact" else ()
    found: list[tuple[int, float, list[tuple[ProMP, float]]]] = []
    unreachable: UnreachableError | None = None
    for factor in settings.widths:
        for index, component in enumerate(prior.components(width * factor)):
            try:
                found.append((index, factor, condition(component, constraints, settings)))
            except UnreachableError as error:
                unreachable = error
    if not found:
        assert unreachable is not None
        raise unreachable
    shares = [float(prior.used.shares[index]) for index, _, _ in found]
    volumes = [branches[0][0].log_volume for _, _, branches in found]
    rng = np.random.default_rng(problem.seed)
    parts = []
    for (index, factor, branches), count in zip(
        found, shared_out(settings.particles, shares), strict=True
    ):
        counts = shared_out(count, [share for _, share in branches])
        for number, ((primitive, _), drawn) in enumerate(zip(branches, counts, strict=True)):
            if drawn:
                latent = torch.from_numpy(rng.standard_normal((drawn, primitive.rank)))
                branch = (number,) if len(branches) > 1 else ()
                volume = primitive.log_volume - min(volumes) if len(settings.widths) > 1 else 0.0
                parts.append(
                    Part(
                        index,
                        branch,
                        primitive,
                        latent,
                        width=width * factor,
                        log_volume=volume,
                    )
                )
    return parts
