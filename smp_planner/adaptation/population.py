"""Particles of all parts of a problem, whose costs are evaluated together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.runs import Runs, SceneCosts
from smp_planner.inference import State, SVGDSettings, step

__all__ = ["Members", "Population"]


@dataclass(eq=False)
class Members:
    """The particles (P_c, r_c) of a population that share a prior.

    Attributes:
        runs: the prior, one run.
        inference: settings of SVGD, without annealing: the temperature is put into the score.
        particles: (P_c, r_c) in whitened coordinates.
        value: (P_c,) their potential -log p(O|w), as it was last evaluated.
        gradient: (P_c, r_c) its gradient.
        memory: of the optimiser.
    """

    runs: Runs
    inference: SVGDSettings
    particles: FloatArray
    value: FloatArray
    gradient: FloatArray
    memory: Any

    @classmethod
    def of(cls, runs: Runs, latent: Tensor, inference: SVGDSettings, memory: Any = None) -> Members:
        """Return the members that begin with particles (P_c, r_c), not evaluated yet.

        Args:
            runs: the prior, one run.
            latent: (P_c, r_c).
            inference: settings of SVGD, without annealing.
            memory: of the optimiser for these particles; by default it begins anew.
        """
        if memory is None:
            memory = inference.optimizer.init(latent[None])
        particles = latent.numpy()
        value, gradient = np.full(len(particles), np.nan), np.full(particles.shape, np.nan)
        return cls(runs, inference, particles, value, gradient, memory)

    def paths(self, particles: FloatArray) -> FloatArray:
        """Return the trajectories (P, T, D) of whitened particles (P, r_c)."""
        return self.runs.latent_trajectories(torch.from_numpy(particles)[None])[0].numpy()

    def pulled_back(self, slope: FloatArray) -> FloatArray:
        """Return the gradient (P, r_c) by whitened particles of one (P, T, D) by trajectories."""
        return self.runs.latent_gradient(torch.from_numpy(slope)[None])[0].numpy()

    def descend(self, temperature: float, iteration: int) -> None:
        """Take one iteration of SVGD from where the potential was evaluated, at a temperature."""
        particles = torch.from_numpy(self.particles)[None]
        score = torch.from_numpy(self.gradient)[None] * -temperature
        state = State(particles, self.memory, iteration)
        state = step(state, -particles, score, self.inference, validate=False)
        self.particles, self.memory = state.particles[0].numpy(), state.memory

    def take(self, chosen: NDArray[np.intp]) -> None:
        """Keep the particles chosen, one as often as it is chosen, with all that is known."""
        self.particles = self.particles[chosen]
        self.value, self.gradient = self.value[chosen], self.gradient[chosen]
        self.memory = _taken(self.memory, chosen)


def _taken(memory: Any, chosen: NDArray[np.intp]) -> Any:
    """Return what an optimiser remembers of the particles chosen."""
    if isinstance(memory, Tensor):
        return memory[:, torch.from_numpy(chosen)]
    if isinstance(memory, tuple):
        return tuple(_taken(value, chosen) for value in memory)
    return memory


class Population:
    """The particles of all parts of a problem.

    Args:
        parts: the members of each part.
        scene: the costs.
    """

    def __init__(self, parts: Sequence[Members], scene: SceneCosts) -> None:
        self.parts, self.scene = parts, scene

    @property
    def present(self) -> list[Members]:
        """The parts that have particles."""
        return [part for part in self.parts if len(part.particles)]

    @property
    def values(self) -> FloatArray:
        """(P,) potential of all particles, as it was last evaluated."""
        return np.concatenate([part.value for part in self.present])

    def weighted_sums(self) -> FloatArray:
        """Return the potential (P,) of all particles, and keep nothing of it."""
        paths = [part.paths(part.particles) for part in self.present]
        return self.scene.weighted_sum(np.concatenate(paths))

    def evaluate(self) -> None:
        """Find the potential of all particles, and its gradient.

        Raises:
            ValueError: the gradient is not finite.
        """
        found = self.evaluated([part.particles for part in self.present])
        for part, (value, gradient) in zip(self.present, found, strict=True):
            part.value, part.gradient = value, gradient

    def evaluate_some(self, rows: Sequence[NDArray[np.intp]]) -> None:
        """Do as `evaluate`, for some rows of each present part."""
        parts = self.present
        found = self.evaluated([part.particles[own] for part, own in zip(parts, rows, strict=True)])
        for part, own, (value, gradient) in zip(parts, rows, found, strict=True):
            part.value[own], part.gradient[own] = value, gradient

    def evaluated(self, particles: Sequence[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
        """Return the potential (P_c,) of particles (P_c, r_c) and its gradient, by present parts.

        Raises:
            ValueError: the gradient is not finite.
        """
        parts = self.present
        paths = [part.paths(rows) for part, rows in zip(parts, particles, strict=True)]
        together = paths[0] if len(paths) == 1 else np.concatenate(paths)
        value, slope = self.scene.evaluate(together, 1.0)
        # The sum is finite only if every entry is, and is cheaper to check.
        if not math.isfinite(slope.sum()):
            raise ValueError("the costs' gradient must be finite, got NaN or infinity")
        last = np.cumsum([len(rows) for rows in paths])[:-1]
        return [
            (of_part, part.pulled_back(of_paths))
            for part, of_part, of_paths in zip(
                parts, np.split(value, last), np.split(slope, last), strict=True
            )
        ]
