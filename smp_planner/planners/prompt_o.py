"""`prompt_o`: draws optimised one by one, and the mean moved to theirs. The baseline ProMPT-O."""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_planner.inference.annealing import linear_decay
from smp_planner.inference.optimizers import Adam
from smp_planner.movement_primitives import ProMP
from smp_planner.planners.gaussian import GaussianPlanner, GaussianSettings, latent_gradient
from smp_planner.planners.likelihood import Likelihood
from smp_planner.problem import Problem

__all__ = ["ProMPTOPlanner", "ProMPTOSettings"]


class ProMPTOSettings(GaussianSettings):
    """Settings of ProMPT-O.

    Attributes:
        obstacle_weight: see `LikelihoodSettings`; more than usual, because only the mean gives way,
            and draws around it that keep the prior's spread need room.
        rounds: how often draws are made, optimised and averaged; once is not enough, because the
            mean of ways round both sides of an obstacle goes through it.
        iterations: of the optimiser in each round.
        step_size: of its first iteration, in standard deviations of the prior.
        pairs: mirrored pairs of draws in each round.
    """

    obstacle_weight: float = Field(default=10.0, gt=0.0)
    rounds: int = Field(default=8, ge=1)
    iterations: int = Field(default=10, ge=1)
    step_size: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    pairs: int = Field(default=21, ge=1)


class ProMPTOPlanner(GaussianPlanner):
    """A Gaussian whose mean is that of optimised draws, and whose covariance is the prior's.

    Each draw descends costs and negative log-prior together, in the prior's whitened coordinates:
    by the weights, that is CHOMP's covariant gradient with the prior's precision as its metric.
    Draws come in mirrored pairs, so that chance alone does not move the mean.
    """

    name = "prompt_o"
    Settings = ProMPTOSettings
    settings: ProMPTOSettings

    def _adapt_gaussian(
        self,
        problem: Problem,
        primitive: ProMP,
        likelihood: Likelihood,
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        s = self.settings
        mean = torch.zeros(primitive.rank, dtype=torch.float64)
        for round_ in range(s.rounds):
            half = torch.from_numpy(rng.standard_normal((s.pairs, primitive.rank)))
            drawn = mean + torch.cat([half, -half])
            progress = round_ / max(s.rounds - 1, 1)
            mean = self._optimise(primitive, drawn, likelihood, progress).mean(0)
        return mean, torch.eye(primitive.rank, dtype=torch.float64)

    def _optimise(
        self, primitive: ProMP, latent: Tensor, likelihood: Likelihood, progress: float
    ) -> Tensor:
        """Return particles (P, r) after a descent of costs and negative log-prior from `latent`."""
        s = self.settings
        optimizer = Adam()
        memory = optimizer.init(latent)
        for iteration in range(s.iterations):
            gradient = latent_gradient(primitive, latent, likelihood, s.planning_steps, progress)
            change, memory = optimizer.update(-(gradient + latent), memory, iteration)
            decay = linear_decay(iteration, s.iterations, 0.1)
            latent = latent + s.step_size * decay * change
        return latent
