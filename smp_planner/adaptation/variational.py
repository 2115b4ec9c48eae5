"""Gaussian variational inference over the weights. The baseline CProMPs."""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_planner.adaptation.gaussian import one_gaussian
from smp_planner.adaptation.runs import SceneCosts, latent_gradient
from smp_planner.inference import GaussianVISettings, init_gaussian, step_gaussian
from smp_planner.movement_primitives import ProMP
from smp_planner.strict_settings import StrictSettings

__all__ = ["VariationalSettings", "gaussian_vi"]


class VariationalSettings(StrictSettings):
    """Settings of Gaussian variational inference.

    Attributes:
        iterations: of the optimiser.
        step_size: of its first iteration, in standard deviations of the prior.
        draws: standard normals in each iteration, over which the costs are averaged.
    """

    iterations: int = Field(default=200, ge=1)
    step_size: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    draws: int = Field(default=42, ge=1)


@one_gaussian
def gaussian_vi(
    primitive: ProMP,
    scene: SceneCosts,
    rng: np.random.Generator,
    settings: VariationalSettings,
) -> tuple[Tensor, Tensor]:
    """Return the Gaussian that is nearest to the posterior, Eq. (9), Q being all Gaussians.

    Minimised is λ E[C(m + L ε)] + KL(q || p) (Eq. (10), read as the expectation of the negative
    log-likelihood), over mean and a full Cholesky factor, in the whitened coordinates of the prior.
    """
    inference = GaussianVISettings(step_size=settings.step_size, iterations=settings.iterations)
    state = init_gaussian(primitive.rank, inference)
    for iteration in range(settings.iterations):
        noise = torch.from_numpy(rng.standard_normal((settings.draws, primitive.rank)))
        progress = iteration / max(settings.iterations - 1, 1)
        gradient = latent_gradient(primitive, state.particles(noise), scene, progress)
        state = step_gaussian(state, noise, gradient, inference)
    return state.mean, state.factor
