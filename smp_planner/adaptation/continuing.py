"""Stein variational gradient descent that goes on, from particles and the optimiser's memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from smp_planner.adaptation.population import Members, Population
from smp_planner.adaptation.runs import Runs, SceneCosts
from smp_planner.adaptation.stein import SteinSettings, inference_for

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
    runs: Sequence[Runs],
    latent: Sequence[Tensor],
    scene: SceneCosts,
    settings: SteinSettings,
    iterations: int,
    step_size: float,
    memories: Sequence[Any],
    done: Sequence[int],
) -> list[tuple[Tensor, Any]]:
    """Return the particles of all parts after some more iterations, with the optimiser's memory.

    The target is met as at the end of a run: nothing is annealed, the map's edge is narrow, and
    steps keep their size.

    Args:
        runs: the prior of each part, one run each.
        latent: of each part, (P_c, r_c) whitened particles.
        scene: the costs.
        settings: of the run before.
        iterations: how many.
        step_size: of each.
        memories: of the optimiser, for each part, in these coordinates; None begins anew.
        done: how many iterations each memory is of.

    Raises:
        ValueError: a gradient is not finite.
    """
    first = [0 if memory is None else own for memory, own in zip(memories, done, strict=True)]
    parts = [
        Members.of(
            run,
            particles,
            replace(
                inference_for(run, settings),
                whiten=True,
                iterations=begin + iterations,
                annealing=0.0,
                step_size=step_size,
                final_step=1.0,
                fading=False,
            ),
            None if memory is None else tuple(average[None] for average in memory),
        )
        for run, particles, memory, begin in zip(runs, latent, memories, first, strict=True)
    ]
    population = Population(parts, scene)
    for iteration in range(iterations):
        population.evaluate()
        for part, begin in zip(parts, first, strict=True):
            part.descend(1.0, begin + iteration)
    return [(torch.from_numpy(part.particles), _of_one_run(part.memory)) for part in parts]


def _of_one_run(memory: Any) -> Any:
    """Return what the optimiser remembers, without the dimension of runs; None if it cannot be."""
    return tuple(average[0] for average in memory) if isinstance(memory, tuple) else None
