"""`cpromp`: Gaussian variational inference over the weights. The baseline CProMPs."""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_planner.inference import GaussianVISettings, init_gaussian, step_gaussian
from smp_planner.movement_primitives import ProMP
from smp_planner.planners.gaussian import GaussianPlanner, GaussianSettings, latent_gradient
from smp_planner.planners.likelihood import Likelihood
from smp_planner.problem import Problem

__all__ = ["CProMPPlanner", "CProMPSettings"]


class CProMPSettings(GaussianSettings):
    """Settings of CProMPs.

    Attributes:
        iterations: of the optimiser.
        step_size: of its first iteration, in standard deviations of the prior.
        draws: standard normals in each iteration, over which the costs are averaged.
    """

    iterations: int = Field(default=200, ge=1)
    step_size: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    draws: int = Field(default=42, ge=1)


class CProMPPlanner(GaussianPlanner):
    """The Gaussian that is nearest to the posterior, Eq. (9), Q being all Gaussians.

    Minimised is λ E[C(m + L ε)] + KL(q || p) (Eq. (10), read as the expectation of the negative
    log-likelihood), over mean and a full Cholesky factor, in the whitened coordinates of the prior.
    """

    name = "cpromp"
    Settings = CProMPSettings
    settings: CProMPSettings

    def _adapt_gaussian(
        self,
        problem: Problem,
        primitive: ProMP,
        likelihood: Likelihood,
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        s = self.settings
        inference = GaussianVISettings(step_size=s.step_size, iterations=s.iterations)
        state = init_gaussian(primitive.rank, inference)
        for iteration in range(s.iterations):
            noise = torch.from_numpy(rng.standard_normal((s.draws, primitive.rank)))
            gradient = latent_gradient(
                primitive,
                state.particles(noise),
                likelihood,
                s.planning_steps,
                iteration / max(s.iterations - 1, 1),
            )
            state = step_gaussian(state, noise, gradient, inference)
        return state.mean, state.factor
