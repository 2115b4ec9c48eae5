"""Particles carried to the posterior by SVGD, the paper's Algorithm 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, field_validator
from torch import Tensor

from smp_planner.adaptation.runs import Good, Runs, Target
from smp_planner.inference import SVGDSettings, converged, init, named_settings, step

__all__ = ["SteinSettings", "inference_of", "stein"]


class SteinSettings(BaseModel):
    """Settings of Algorithm 1.

    Attributes:
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
        early_stop: whether to stop as soon as particles hardly move (`inference.converged`), if
            enough of them are good by then. They are checked once.
        good_share: of the particles, that is enough.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    inference: str = "default"
    iterations: int = Field(default=100, ge=1)
    step_size: float | None = Field(default=None, gt=0.0)
    early_stop: bool = False
    good_share: float = Field(default=0.9, gt=0.0, le=1.0)

    @property
    def separate(self) -> bool:
        """Whether runs are adapted one by one, for each has its own metric or last iteration."""
        return self.early_stop or named_settings(self.inference).needs_metric

    @field_validator("inference")
    @classmethod
    def _known(cls, name: str) -> str:
        named_settings(name)
        return name


def inference_of(runs: Runs, settings: SteinSettings) -> SVGDSettings:
    """Return the settings of inference that settings of Algorithm 1 name."""
    inference = replace(named_settings(settings.inference), iterations=settings.iterations)
    if settings.step_size is not None:
        inference = replace(inference, step_size=settings.step_size)
    if inference.needs_metric:
        root = runs.primitives[0].path_root(runs.steps)
        if inference.whiten:
            root = runs.primitives[0].whiten_gradient(root)
        inference = inference.with_metric(root)
    return inference


def stein(
    runs: Runs,
    latent: Tensor,
    target: Target,
    rngs: Sequence[np.random.Generator],
    settings: SteinSettings,
    good: Good | None = None,
) -> Tensor:
    """Return particles (B, P, r) after the last iteration; an `Adapt`, which draws nothing."""
    inference = inference_of(runs, settings)
    whiten = inference.whiten
    ask = settings.early_stop and good is not None

    def whitened(particles: Tensor) -> Tensor:
        return particles if whiten else runs.whiten(particles)

    state = init(latent if whiten else runs.unwhiten(latent), inference)
    for iteration in range(inference.iterations):
        particles = state.particles
        weights = runs.unwhiten(particles) if whiten else particles
        progress = iteration / max(inference.iterations - 1, 1)
        gradient = target.gradient(runs.trajectories(weights), progress)
        pulled = runs.pull_back(gradient)
        if whiten:
            prior_score, score = -particles, -runs.whiten_gradient(pulled)
        else:
            prior_score, score = runs.score(particles), -pulled
        state = step(state, prior_score, score, inference, validate=False)
        if not whiten:
            # Raw weights leave what conditioning made certain, the start above all.
            state = state._replace(particles=runs.project(state.particles))
        if ask:
            before, after = whitened(particles), whitened(state.particles)
            movement = float((after - before).square().mean(-1).sqrt().mean())
            if converged(state, movement, inference):
                assert good is not None
                if good(after).mean() >= settings.good_share:
                    break
                ask = False
    final = whitened(state.particles)
    if not bool(torch.isfinite(final).all()):
        raise ValueError("the costs' gradient must be finite, got NaN or infinity")
    return final
