"""Stein variational gradient descent that goes on, from particles and the optimiser's memory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from smp_planner.adaptation.runs import Runs, Target
from smp_planner.adaptation.stein import SteinSettings, inference_for
from smp_planner.inference import State, init, step

__all__ = ["continue_stein", "moved_memory"]


def moved_memory(memory: Any, change: Tensor) -> Any:
    """Return what Adam remembers, in other coordinates.

    A mean direction is a displacement and is mapped as such. Of the mean squares only the diagonal
    is known, so that of the map's image is taken as if coordinates were uncorrelated.

    Args:
        memory: two tensors (P, r), the averages of directions and of their squares.
        change: (s, r), from old to new coordinates.
    """
    if not (isinstance(memory, tuple) and len(memory) == 2):
        return None
    first, second = memory
    return first @ change.mT, second @ change.square().mT


def continue_stein(
    runs: Runs,
    latent: Tensor,
    target: Target,
    settings: SteinSettings,
    iterations: int,
    step_size: float,
    memory: Any = None,
    done: int = 0,
) -> tuple[Tensor, Any]:
    """Return particles (B, P, r) after some more iterations, and what the optimiser remembers.

    The target is met as at the end of a run: nothing is annealed, the map's edge is narrow, and
    steps keep their size.

    Args:
        runs: the priors.
        latent: (B, P, r) whitened particles.
        target: the costs.
        settings: of the run before.
        iterations: how many.
        step_size: of each.
        memory: of the optimiser, in these coordinates; None begins anew.
        done: how many iterations the memory is of.
    """
    first = 0 if memory is None else done
    inference = replace(
        inference_for(runs, settings),
        whiten=True,
        iterations=first + iterations,
        annealing=0.0,
        step_size=step_size,
        final_step=1.0,
    )
    state = init(latent, inference)
    if memory is not None:
        state = State(latent, memory, first)
    for _ in range(iterations):
        weights = runs.unwhiten(state.particles)
        gradient = target.gradient(runs.trajectories(weights), 1.0)
        score = -runs.whiten_gradient(runs.pull_back(gradient))
        state = step(state, -state.particles, score, inference, validate=False)
    if not bool(torch.isfinite(state.particles).all()):
        raise ValueError("the costs' gradient must be finite, got NaN or infinity")
    return state.particles, state.memory
