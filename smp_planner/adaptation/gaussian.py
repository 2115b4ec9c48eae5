"""What the paper's baselines share: adapt as they may, they keep one Gaussian over the weights."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from torch import Tensor

from smp_planner.adaptation.target import Adaptation, Good, Target
from smp_planner.movement_primitives import ProMP

__all__ = ["GaussianAdaptation"]


class GaussianAdaptation(Adaptation):
    """Carries draws of the prior to a Gaussian that was adapted to the target.

    One that leaves the Gaussian as it was ends with the draws that it began with.
    """

    def adapt(
        self,
        primitive: ProMP,
        latent: Tensor,
        target: Target,
        rng: np.random.Generator,
        good: Good | None = None,
    ) -> Tensor:
        """Return the draws, carried to the adapted Gaussian; `good` is not asked."""
        mean, factor = self.adapt_gaussian(primitive, target, rng)
        return mean + latent @ factor.mT

    @abstractmethod
    def adapt_gaussian(
        self, primitive: ProMP, target: Target, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return mean (r,) and factor (r, r) of the Gaussian, in whitened coordinates.

        There the prior is N(0, I).

        Args:
            primitive: the prior, conditioned on what is certain.
            target: what is wanted beside being likely under the prior.
            rng: source of all randomness.
        """
