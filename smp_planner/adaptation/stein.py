"""Particles carried to the posterior by SVGD, the paper's Algorithm 1."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from smp_planner.adaptation.target import Adaptation, Target
from smp_planner.inference import SVGDSettings, init, named_settings, step
from smp_planner.movement_primitives import ProMP, phases

__all__ = ["Stein"]


class Stein(Adaptation):
    """Algorithm 1.

    Attributes:
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
    """

    inference: Literal["default", "paper", "no_repulsion"] = "default"
    iterations: int = Field(default=100, ge=1)
    step_size: float | None = Field(default=None, gt=0.0)

    def _settings(self) -> SVGDSettings:
        settings = replace(named_settings(self.inference), iterations=self.iterations)
        return settings if self.step_size is None else replace(settings, step_size=self.step_size)

    def adapt(
        self, primitive: ProMP, latent: Tensor, target: Target, rng: np.random.Generator
    ) -> Tensor:
        """Return the particles after all iterations; nothing is drawn from `rng`."""
        settings = self._settings()
        whiten = settings.whiten
        # The basis is evaluated once, not in each iteration.
        values = primitive.basis.values(phases(target.steps))
        shape = (-1, primitive.basis.count, primitive.dimension)
        state = init(latent if whiten else primitive.unwhiten(latent), settings)
        for iteration in range(settings.iterations):
            particles = state.particles
            weights = primitive.unwhiten(particles) if whiten else particles
            trajectories = (values @ weights.reshape(shape)).numpy()
            progress = iteration / max(settings.iterations - 1, 1)
            gradient = torch.from_numpy(target.gradient(trajectories, progress))
            pulled = (values.mT @ gradient).flatten(-2)
            if whiten:
                prior_score, score = -particles, -primitive.whiten_gradient(pulled)
            else:
                prior_score, score = primitive.score(particles), -pulled
            state = step(state, prior_score, score, settings)
            if not whiten:
                # Raw weights leave what conditioning made certain, the start above all.
                state = state._replace(particles=primitive.project(state.particles))
        return state.particles if whiten else primitive.whiten(state.particles)
