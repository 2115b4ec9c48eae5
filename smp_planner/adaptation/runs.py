"""State of an adaptation: B runs of particles, their paths, and the target's gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.collision.clearances import Clearances
from smp_planner.movement_primitives import ProMP, phases

__all__ = [
    "Adapt",
    "Good",
    "Runs",
    "SceneCosts",
    "StepConstraint",
    "Target",
    "latent_gradient",
]

Good = Callable[[Tensor], NDArray[np.bool_]]
"""Map from particles (B, P, r) in whitened coordinates to the mask (B, P) of those good already."""


@dataclass(frozen=True, eq=False)
class StepConstraint:
    """Clearances that must be kept at steps of a trajectory.

    Lengths are m or rad for a robot, and extents for paths in the plane or in space.

    Attributes:
        steps: at which.
        clearances: M of a configuration.
        margin: least that they should be, of all or of each (M,).
        width: scale of what is missing.
        weight: first multiplier of each clearance at each step.
    """

    steps: slice
    clearances: Clearances
    margin: float | FloatArray
    width: float
    weight: float


class SceneCosts(Protocol):
    """Costs of one scene's trajectories with their weights, the -log p(O|w) of Eq. (7)."""

    @property
    def steps(self) -> int:
        """T, equal steps of phase at which it is evaluated."""
        ...

    @property
    def pins(self) -> FloatArray:
        """Phases, ascending, at which trajectories are held: both ends, and what is passed."""
        ...

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs.

        Args:
            trajectories: (P, T, D).
            progress: 0 in the first iteration to 1 in the last; narrows the map's edge.
        """
        ...

    def evaluate(self, trajectories: FloatArray, progress: float) -> tuple[FloatArray, FloatArray]:
        """Return the weighted sum (P,) of costs and its gradient (P, T, D), as `gradient`."""
        ...

    def weighted_sum(self, trajectories: FloatArray) -> FloatArray:
        """Return the weighted sum (P,) of costs, with the map's edge at its last width."""
        ...

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the collision cost alone, unweighted."""
        ...

    def step_constraints(self) -> Sequence[StepConstraint]:
        """Return what must hold at single steps; none if nothing does."""
        ...

    def evaluate_others(
        self, trajectories: FloatArray, progress: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return `evaluate` of the costs of which `step_constraints` has nothing."""
        ...


class Target(Protocol):
    """The costs of B scenes, evaluated together."""

    @property
    def scenes(self) -> Sequence[SceneCosts]:
        """The costs of each of the B scenes."""
        ...

    @property
    def steps(self) -> int:
        """T, equal steps of phase at which it is evaluated."""
        ...

    def gradient(self, trajectories: Tensor, progress: float) -> Tensor:
        """Return the gradient (B, P, T, D) of the weighted sums of costs at (B, P, T, D)."""
        ...


Adapt = Callable[..., Tensor]
"""An adaptation: from runs, particles (B, P, r) drawn from their priors (whitened, so standard
normals), the target, a generator for each run, the adaptation's settings, and a question that may
be asked before the end, to adapted particles (B, P, r). Particles of a run see each other; runs do
not."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The priors of B independent runs, stacked: w = μ_b + L_b z, trajectories Φ w.

    Attributes:
        primitives: B priors, conditioned, of one basis and one rank r.
        steps: T, phases at which trajectories are evaluated.
        mean: (B, 1, K*D) μ.
        factor: (B, K*D, r) L, orthogonal columns.
        values: (T, K) Φ.
    """

    primitives: tuple[ProMP, ...]
    steps: int
    mean: Tensor
    factor: Tensor
    values: Tensor

    @classmethod
    def of(cls, primitives: Sequence[ProMP], steps: int) -> Runs:
        """Stack the priors of B runs.

        Args:
            primitives: of one basis and one rank.
            steps: T.
        """
        return cls(
            tuple(primitives),
            steps,
            torch.stack([p.mean for p in primitives])[:, None],
            torch.stack([p.factor for p in primitives]),
            primitives[0].basis.values(phases(steps)),
        )

    def trajectories(self, weights: Tensor) -> Tensor:
        """Return the trajectories (B, P, T, D) of weights (B, P, K*D)."""
        return self.values @ weights.unflatten(-1, (self.values.shape[1], -1))

    def pull_back(self, gradient: Tensor) -> Tensor:
        """Return the gradient (B, P, K*D) by weights of what has (B, P, T, D) by trajectories."""
        return (self.values.mT @ gradient).flatten(-2)

    def latent_trajectories(self, latent: Tensor) -> Tensor:
        """Return the trajectories (B, P, T, D) of whitened particles (B, P, r)."""
        mean, factor = self._of_latent
        return (mean + latent @ factor).unflatten(-1, (self.steps, -1))

    def latent_gradient(self, gradient: Tensor) -> Tensor:
        """Return the gradient (B, P, r) by whitened particles of one (B, P, T, D) by paths."""
        return gradient.flatten(-2) @ self._of_latent[1].mT

    @cached_property
    def _of_latent(self) -> tuple[Tensor, Tensor]:
        """Trajectories as a linear map: (B, 1, T*D) the mean's, and (B, r, T*D)."""
        columns = self.trajectories(self.factor.mT).flatten(-2)
        return self.trajectories(self.mean).flatten(-2), columns.contiguous()

    def unwhiten(self, latent: Tensor) -> Tensor:
        """Return the weights (B, P, K*D) of whitened particles (B, P, r)."""
        return self.mean + latent @ self.factor.mT

    def whiten(self, weights: Tensor) -> Tensor:
        """Return the whitened particles (B, P, r) of weights (B, P, K*D)."""
        return (weights - self.mean) @ (self.factor / self._variances)

    def whiten_gradient(self, gradient: Tensor) -> Tensor:
        """Return the gradient (B, P, r) by whitened particles of one by weights."""
        return gradient @ self.factor

    def score(self, weights: Tensor) -> Tensor:
        """Return the gradient (B, P, K*D) of the log-prior at weights."""
        return -(self.whiten(weights) / self._variances) @ self.factor.mT

    def project(self, weights: Tensor) -> Tensor:
        """Return the nearest weights (B, P, K*D) that the priors allow."""
        return self.unwhiten(self.whiten(weights))

    @property
    def _variances(self) -> Tensor:
        """(B, 1, r) squared lengths of the factors' columns."""
        return torch.linalg.vector_norm(self.factor, dim=-2, keepdim=True).square()


def latent_gradient(primitive: ProMP, latent: Tensor, scene: SceneCosts, progress: float) -> Tensor:
    """Return the gradient (P, r) of a scene's weighted costs by whitened particles.

    Args:
        primitive: the prior of one run.
        latent: (P, r).
        scene: its costs.
        progress: 0 to 1; see `SceneCosts.gradient`.
    """
    trajectories = primitive.trajectory(primitive.unwhiten(latent), scene.steps).numpy()
    gradient = torch.from_numpy(scene.gradient(trajectories, progress))
    return primitive.whiten_gradient(primitive.pull_back(gradient, scene.steps))
