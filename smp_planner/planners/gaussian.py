"""What the baselines of the paper share: adapt as they may, they keep one Gaussian over weights."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from smp_planner.movement_primitives import ProMP, ProMPMixture
from smp_planner.planners.adapting import AdaptingPlanner, AdaptingSettings
from smp_planner.planners.base import Particles, PlannerSettings
from smp_planner.planners.likelihood import Likelihood
from smp_planner.problem import Problem

__all__ = ["GaussianPlanner", "GaussianSettings", "latent_gradient"]


class GaussianSettings(AdaptingSettings):
    """Settings of planners that keep one Gaussian over the weights.

    Attributes:
        per_component: with demonstrations that go more than one way, whether each component of
            their mixture is adapted on its own, with its share of the particles; if not, one
            Gaussian is learned from all of them, as the paper's baselines have it.
    """

    per_component: bool = True


class GaussianPlanner(AdaptingPlanner):
    """Draws from a Gaussian over the weights that was adapted to the scene.

    The standard normals that are carried to it are those of the control `promp`: a planner that
    leaves the Gaussian as it was ends with the same particles.
    """

    Settings: ClassVar[type[PlannerSettings]] = GaussianSettings
    settings: GaussianSettings

    def _learn_mixture(self) -> ProMPMixture:
        if self.settings.per_component:
            return super()._learn_mixture()
        return ProMPMixture((self.primitive,), torch.ones(1))

    def _adapt(self, problem: Problem, drawn: Particles, likelihood: Likelihood) -> Tensor:
        rng = np.random.default_rng([problem.seed, 3, drawn.component])
        mean, factor = self._adapt_gaussian(problem, drawn.tied.primitive, likelihood, rng)
        return mean + drawn.latent @ factor.mT

    @abstractmethod
    def _adapt_gaussian(
        self,
        problem: Problem,
        primitive: ProMP,
        likelihood: Likelihood,
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        """Return mean (r,) and factor (r, r) of the Gaussian, in whitened coordinates.

        There the prior is N(0, I).

        Args:
            problem: to be solved.
            primitive: the prior, tied to start and goal.
            likelihood: of the scene.
            rng: source of all randomness.
        """


def latent_gradient(
    primitive: ProMP, latent: Tensor, likelihood: Likelihood, steps: int, progress: float
) -> Tensor:
    """Return the gradient (P, r) of the weighted costs at particles, in whitened coordinates.

    Args:
        primitive: the prior.
        latent: (P, r).
        likelihood: of the scene.
        steps: of phase at which costs are evaluated.
        progress: of the run, 0 to 1; see `Likelihood.gradient`.
    """
    trajectories = primitive.trajectory(primitive.unwhiten(latent), steps).numpy()
    gradient = torch.from_numpy(likelihood.gradient(trajectories, progress))
    return primitive.whiten_gradient(primitive.pull_back(gradient, steps))
