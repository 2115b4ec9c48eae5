"""Draws optimised one by one, and the mean moved to theirs. The baseline ProMPT-O."""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_planner.adaptation.gaussian import GaussianAdaptation
from smp_planner.adaptation.target import Target, latent_gradient
from smp_planner.inference.annealing import linear_decay
from smp_planner.inference.optimizers import Adam
from smp_planner.movement_primitives import ProMP

__all__ = ["OptimisedMean"]


class OptimisedMean(GaussianAdaptation):
    """A Gaussian whose mean is that of optimised draws, and whose covariance is the prior's.

    Each draw descends costs and negative log-prior together, in the prior's whitened coordinates:
    by the weights, that is CHOMP's covariant gradient with the prior's precision as its metric.
    Draws come in mirrored pairs, so that chance alone does not move the mean.

    Attributes:
        rounds: how often draws are made, optimised and averaged; once is not enough, because the
            mean of ways round both sides of an obstacle goes through it.
        iterations: of the optimiser in each round.
        step_size: of its first iteration, in standard deviations of the prior.
        pairs: mirrored pairs of draws in each round.
    """

    rounds: int = Field(default=8, ge=1)
    iterations: int = Field(default=10, ge=1)
    step_size: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    pairs: int = Field(default=21, ge=1)

    def adapt_gaussian(
        self, primitive: ProMP, target: Target, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return the mean of the last round's draws, and the prior's factor."""
        mean = torch.zeros(primitive.rank, dtype=torch.float64)
        for round_ in range(self.rounds):
            half = torch.from_numpy(rng.standard_normal((self.pairs, primitive.rank)))
            drawn = mean + torch.cat([half, -half])
            progress = round_ / max(self.rounds - 1, 1)
            mean = self._optimise(primitive, drawn, target, progress).mean(0)
        return mean, torch.eye(primitive.rank, dtype=torch.float64)

    def _optimise(
        self, primitive: ProMP, latent: Tensor, target: Target, progress: float
    ) -> Tensor:
        """Return particles (P, r) after a descent of costs and negative log-prior from `latent`."""
        optimizer = Adam()
        memory = optimizer.init(latent)
        for iteration in range(self.iterations):
            gradient = latent_gradient(primitive, latent, target, progress)
            change, memory = optimizer.update(-(gradient + latent), memory, iteration)
            decay = linear_decay(iteration, self.iterations, 0.1)
            latent = latent + self.step_size * decay * change
        return latent
