"""What an adaptation is carried out against: the weighted costs of trajectories."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from torch import Tensor

from smp_planner.movement_primitives import ProMP

__all__ = ["Adaptation", "Good", "Target", "latent_gradient"]

FloatArray = NDArray[np.float64]

Good = Callable[[Tensor], NDArray[np.bool_]]
"""From particles (P, r) in whitened coordinates to which of them, (P,), are good as they are."""


class Target(Protocol):
    """Costs of trajectories with their weights, the -log p(O|w) of Eq. (7)."""

    @property
    def steps(self) -> int:
        """T, equal steps of phase at which it is evaluated."""
        ...

    @property
    def pins(self) -> FloatArray:
        """Phases, ascending, at which paths are held: both ends, and what must be passed."""
        ...

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs.

        Args:
            trajectories: (P, T, D).
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        ...

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the collision cost alone, unweighted."""
        ...


class Adaptation(BaseModel, ABC):
    """A way to carry draws of a primitive to a target; its fields are its settings."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @abstractmethod
    def adapt(
        self,
        primitive: ProMP,
        latent: Tensor,
        target: Target,
        rng: np.random.Generator,
        good: Good | None = None,
    ) -> Tensor:
        """Return the adapted particles (P, r), in the primitive's whitened coordinates.

        Args:
            primitive: the prior, conditioned on what is certain.
            latent: (P, r) draws from it, standard normals.
            target: what is wanted beside being likely under the prior.
            rng: source of all further randomness.
            good: may be asked before the end, by ways that can stop early.
        """


def latent_gradient(primitive: ProMP, latent: Tensor, target: Target, progress: float) -> Tensor:
    """Return the gradient (P, r) of the weighted costs at particles, in whitened coordinates.

    Args:
        primitive: the prior.
        latent: (P, r).
        target: of the scene.
        progress: of the run, 0 to 1; see `Target.gradient`.
    """
    trajectories = primitive.trajectory(primitive.unwhiten(latent), target.steps).numpy()
    gradient = torch.from_numpy(target.gradient(trajectories, progress))
    return primitive.whiten_gradient(primitive.pull_back(gradient, target.steps))
