"""Particles carried to the posterior by SVGD, the paper's Algorithm 1."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from pydantic import Field, field_validator
from torch import Tensor

from smp_planner.adaptation.target import Adaptation, Good, Target
from smp_planner.inference import SVGDSettings, converged, init, named_settings, step
from smp_planner.movement_primitives import ProMP, phases

__all__ = ["Stein"]


class Stein(Adaptation):
    """Algorithm 1.

    Attributes:
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
        early_stop: whether to stop as soon as particles hardly move (`inference.converged`), if
            enough of them are good by then. They are looked at once.
        good_share: of the particles, that is enough.
    """

    inference: str = "default"
    iterations: int = Field(default=100, ge=1)
    step_size: float | None = Field(default=None, gt=0.0)
    early_stop: bool = False
    good_share: float = Field(default=0.9, gt=0.0, le=1.0)

    @field_validator("inference")
    @classmethod
    def _known(cls, name: str) -> str:
        named_settings(name)
        return name

    def _settings(self, primitive: ProMP, steps: int) -> SVGDSettings:
        settings = replace(named_settings(self.inference), iterations=self.iterations)
        if self.step_size is not None:
            settings = replace(settings, step_size=self.step_size)
        if settings.needs_metric:
            root = primitive.path_root(steps)
            settings = settings.with_metric(
                primitive.whiten_gradient(root) if settings.whiten else root
            )
        return settings

    def adapt(
        self,
        primitive: ProMP,
        latent: Tensor,
        target: Target,
        rng: np.random.Generator,
        good: Good | None = None,
    ) -> Tensor:
        """Return the particles after the last iteration; nothing is drawn from `rng`."""
        ask = good if self.early_stop else None
        settings = self._settings(primitive, target.steps)
        whiten = settings.whiten

        def whitened(particles: Tensor) -> Tensor:
            return particles if whiten else primitive.whiten(particles)

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
            if ask is not None:
                before, after = whitened(particles), whitened(state.particles)
                movement = float((after - before).square().mean(-1).sqrt().mean())
                if converged(state, movement, settings):
                    if ask(after).mean() >= self.good_share:
                        break
                    ask = None
        return whitened(state.particles)
