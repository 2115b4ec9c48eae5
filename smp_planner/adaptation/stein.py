"""Particles carried to the posterior by SVGD, the paper's Algorithm 1."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from pydantic import Field, field_validator, model_validator
from torch import Tensor

from smp_planner.adaptation.runs import Good, Runs, Target
from smp_planner.inference import State, SVGDSettings, converged, init, named_settings, step
from smp_planner.strict_settings import StrictSettings

__all__ = [
    "SteinSettings",
    "affordable",
    "edge_progress",
    "inference_for",
    "inference_of",
    "iterate",
    "stein",
]

_TIMED = 2
"""Iterations after which it is asked how many more there is time for."""


class SteinSettings(StrictSettings):
    """Settings of Algorithm 1.

    Attributes:
        inference: one of `smp_planner.inference.SETTINGS`.
        iterations: of SVGD.
        step_size: of its first iteration; None takes the inference's own.
        early_stop: whether to stop as soon as particles hardly move (`inference.converged`), if
            enough of them are good by then. They are checked once.
        good_share: of the particles, that is enough.
    """

    inference: str = "tempered"
    iterations: int = Field(default=50, ge=1)
    step_size: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    early_stop: bool = False
    good_share: float = Field(default=0.9, gt=0.0, le=1.0)

    @property
    def separate(self) -> bool:
        """Whether runs are adapted one by one, for each has its own metric or last iteration."""
        return self.early_stop or named_settings(self.inference).needs_metric

    @property
    def competes(self) -> bool:
        """Whether the particles of a problem are one population; see `SVGDSettings.competes`."""
        return inference_of(self).competes

    @property
    def overdraw(self) -> int:
        """Draws of the prior that are wanted for each particle."""
        return inference_of(self).overdraw

    @model_validator(mode="after")
    def _stops_or_competes(self) -> SteinSettings:
        if self.early_stop and self.competes:
            raise ValueError(
                f"early_stop must be off with inference {self.inference!r}, whose particles "
                "compete until the end; inference 'svgd' has it"
            )
        return self

    @field_validator("inference")
    @classmethod
    def _known(cls, name: str) -> str:
        named_settings(name)
        return name


def inference_of(settings: SteinSettings) -> SVGDSettings:
    """Return the settings of SVGD, without a metric."""
    inference = replace(named_settings(settings.inference), iterations=settings.iterations)
    if settings.step_size is not None:
        inference = replace(inference, step_size=settings.step_size)
    return inference


def inference_for(runs: Runs, settings: SteinSettings) -> SVGDSettings:
    """Return the settings of SVGD, with the metric of paths where the kernel has one."""
    inference = inference_of(settings)
    if inference.needs_metric:
        root = runs.primitives[0].path_root(runs.steps)
        if inference.whiten:
            root = runs.primitives[0].whiten_gradient(root)
        inference = inference.with_metric(root)
    return inference


def affordable(iterations: int, done: int, begin: float, until: float) -> int:
    """Return how many iterations there is time for in all, at most as many as are wanted.

    Args:
        iterations: wanted in all.
        done: of them, whose mean time the rest is taken to need, too.
        begin: time of `time.perf_counter` when the first began.
        until: time by which to return; infinity for none.
    """
    if until == math.inf or done < _TIMED:
        return iterations
    now = time.perf_counter()
    return min(iterations, done + max(0, int((until - now) * done / (now - begin))))


def edge_progress(state: State, inference: SVGDSettings) -> float:
    """Return how far the map's edge has narrowed, 0 to 1.

    Either the edge narrows or the likelihood is annealed: both would be the same thing twice, and
    weights of particles need a likelihood that nothing but its temperature changes.
    """
    if inference.annealed == "likelihood":
        return 1.0
    return state.iteration / max(inference.iterations - 1, 1)


def iterate(runs: Runs, state: State, target: Target, inference: SVGDSettings) -> State:
    """Return the state after one more iteration, without waiting for the device that it is on.

    Args:
        runs: the priors.
        state: before it.
        target: the costs.
        inference: the settings with which `state` began.
    """
    particles = state.particles
    progress = edge_progress(state, inference)
    if inference.whiten:
        gradient = target.gradient(runs.latent_trajectories(particles), progress)
        prior_score, score = -particles, -runs.latent_gradient(gradient)
    else:
        gradient = target.gradient(runs.trajectories(particles), progress)
        prior_score, score = runs.score(particles), -runs.pull_back(gradient)
    state = step(state, prior_score, score, inference, validate=False)
    if not inference.whiten:
        # Raw weights leave what conditioning made certain, the start above all.
        state = state._replace(particles=runs.project(state.particles))
    return state


def stein(
    runs: Runs,
    latent: Tensor,
    target: Target,
    rngs: Sequence[np.random.Generator],
    settings: SteinSettings,
    good: Good | None = None,
    until: float = math.inf,
    record: Callable[[int, Tensor], None] | None = None,
) -> Tensor:
    """Return particles (B, P, r) after the last iteration; an `Adapt`, which draws nothing.

    `record` is told the particles before each iteration, and its number; it must not change them.

    Where time runs short there are fewer iterations: after each, their number is set to what the
    mean time of those so far leaves room for, and the schedules to that number, so that particles
    settle before the end.
    """
    inference = inference_for(runs, settings)
    ask = settings.early_stop and good is not None

    def whitened(particles: Tensor) -> Tensor:
        return particles if inference.whiten else runs.whiten(particles)

    state = init(latent if inference.whiten else runs.unwhiten(latent), inference)
    begin = time.perf_counter()
    while state.iteration < inference.iterations:
        iterations = affordable(inference.iterations, state.iteration, begin, until)
        if iterations <= state.iteration:
            break
        if iterations < inference.iterations:
            inference = replace(inference, iterations=iterations)
        particles = state.particles
        if record is not None:
            record(state.iteration, whitened(particles))
        state = iterate(runs, state, target, inference)
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
