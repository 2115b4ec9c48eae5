"""`smp`: Stein Movement Primitives, the paper's Algorithm 1."""

from __future__ import annotations

from dataclasses import replace

import torch
from pydantic import Field, field_validator
from torch import Tensor

from smp_gym.demonstrations import Demonstrations
from smp_planner.inference import init, named_settings, step
from smp_planner.movement_primitives import phases
from smp_planner.planners.adapting import AdaptingPlanner, AdaptingSettings
from smp_planner.planners.base import Particles, PlannerSettings
from smp_planner.planners.likelihood import Likelihood
from smp_planner.problem import Problem

__all__ = ["SMPPlanner", "SMPSettings"]


class SMPSettings(AdaptingSettings):
    """Settings of Stein Movement Primitives.

    Attributes:
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
    """

    inference: str = "default"
    iterations: int = Field(default=100, ge=1)
    step_size: float | None = Field(default=None, gt=0.0)

    @field_validator("inference")
    @classmethod
    def _known(cls, value: str) -> str:
        named_settings(value)
        return value


class SMPPlanner(AdaptingPlanner):
    """A particle set from the conditioned primitive, carried to the posterior by SVGD.

    With a mixture as prior, each component has its share of the particles, whitened by its own
    factor, and is a run of its own against the same likelihood. Components are so far apart, in
    units of their own spread, that the kernel and the responsibilities between them vanish: one run
    with all particles would do the same, but for a bandwidth that spans both.
    """

    name = "smp"
    Settings = SMPSettings
    settings: SMPSettings

    def __init__(
        self, demonstrations: Demonstrations, settings: PlannerSettings | None = None
    ) -> None:
        super().__init__(demonstrations, settings)
        s = self.settings
        inference = replace(named_settings(s.inference), iterations=s.iterations)
        if s.step_size is not None:
            inference = replace(inference, step_size=s.step_size)
        self._inference = inference

    def _adapt(self, problem: Problem, drawn: Particles, likelihood: Likelihood) -> Tensor:
        """Run Algorithm 1."""
        primitive, whiten = drawn.tied.primitive, self._inference.whiten
        values = primitive.basis.values(phases(self.settings.planning_steps))
        shape = (-1, primitive.basis.count, primitive.dimension)
        inference = self._inference
        if inference.needs_metric:
            root = primitive.path_root(self.settings.planning_steps)
            inference = inference.with_metric(primitive.whiten_gradient(root) if whiten else root)
        state = init(drawn.latent if whiten else primitive.unwhiten(drawn.latent), inference)
        for iteration in range(inference.iterations):
            particles = state.particles
            weights = primitive.unwhiten(particles) if whiten else particles
            trajectories = (values @ weights.reshape(shape)).numpy()
            progress = iteration / max(inference.iterations - 1, 1)
            gradient = torch.from_numpy(likelihood.gradient(trajectories, progress))
            pulled = (values.mT @ gradient).flatten(-2)
            if whiten:
                prior_score, score = -particles, -primitive.whiten_gradient(pulled)
            else:
                prior_score, score = primitive.score(particles), -pulled
            state = step(state, prior_score, score, inference)
            if not whiten:
                # Raw weights leave what conditioning made certain, the start above all.
                state = state._replace(particles=primitive.project(state.particles))
        return state.particles if whiten else primitive.whiten(state.particles)
