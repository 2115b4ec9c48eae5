"""Hamiltonian Monte Carlo whose flow keeps a standard normal prior exactly.

Particles z with the target p(z) ∝ N(z; 0, I) exp(-Φ(z)) and momenta v ~ N(0, I) move on the
Hamiltonian ½|z|² + ½|v|² + Φ(z). It is split into the rotation of (z, v), which is exact, and kicks
by ∇Φ (Beskos, Pinski, Sanz-Serna & Stuart 2011): the error of the flow, and so the share of moves
that is refused, comes from Φ alone, however many dimensions the prior has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch

__all__ = ["Array", "Draws", "Evaluated", "Potential", "hamiltonian_moves"]

Array = Any
"""An array of NumPy or of torch; all of one call are of one kind. Torch's may be on a device, which
is not waited for."""

Potential = Callable[[Array], tuple[Array, Array]]
"""Map from particles (..., P, r) to Φ (..., P) and its gradient (..., P, r)."""


class Draws(Protocol):
    """Source of randomness; NumPy's generators are one."""

    def standard_normal(self, size: tuple[int, ...]) -> Array:
        """Return standard normal numbers."""
        ...

    def uniform(self, low: float, high: float, size: tuple[int, ...]) -> Array:
        """Return numbers between two bounds."""
        ...


_TARGET_ACCEPTANCE = 0.7
"""Share of moves to accept, to which steps are adapted. Beskos et al. (2013): near 0.65."""

_ADAPTATION_GAIN = 0.5
"""Change of a step's logarithm for each unit by which the acceptance is off."""

_STEPS = 0.01, 1.0

_FARTHEST = 1e3
"""Coordinate of a particle beyond which its flow has diverged: the prior has none there."""


class Evaluated(NamedTuple):
    """Particles with their potential.

    Attributes:
        particles: (..., P, r).
        value: (..., P) Φ.
        gradient: (..., P, r) ∇Φ.
    """

    particles: Array
    value: Array
    gradient: Array


def _library(of: Array) -> Any:
    """Return the library of an array; what is used of them here has the same names in both."""
    return torch if isinstance(of, torch.Tensor) else np


def hamiltonian_moves(
    start: Evaluated,
    potential: Potential,
    rng: Draws,
    *,
    moves: int,
    leapfrogs: int,
    step: float,
) -> tuple[Evaluated, Array]:
    """Return particles after moves that leave p(z) ∝ N(z; 0, I) exp(-Φ(z)) as it is.

    Each particle has a step of its own, which follows the share of its moves that are accepted.

    Args:
        start: before the first move.
        potential: Φ, evaluated `moves` times `leapfrogs` times.
        rng: source of all randomness.
        moves: proposals for each particle.
        leapfrogs: steps of the flow in each, at least 1.
        step: angle, rad, by which the flow first rotates in one step, in (0, 1].

    Returns:
        The particles, and (moves,) the share of them that moved.
    """
    of = _library(start.value)
    now, steps = start, of.full_like(start.value, step)
    several = start.value.shape[:-1]
    shares = []
    for _ in range(moves):
        momentum = rng.standard_normal(now.particles.shape)
        # Angles that differ from move to move keep particles from coming back to where they were.
        angle = steps[..., None] * rng.uniform(0.8, 1.2, (*several, 1, 1))
        offered, moved = _flow(now, momentum, angle, potential, leapfrogs)
        change = _energy(now, momentum) - _energy(offered, moved)
        accepted = of.log(rng.uniform(0.0, 1.0, change.shape)) < change
        now = Evaluated(
            of.where(accepted[..., None], offered.particles, now.particles),
            of.where(accepted, offered.value, now.value),
            of.where(accepted[..., None], offered.gradient, now.gradient),
        )
        chance = of.exp(of.clip(change, None, 0.0))
        steps = steps * of.exp(_ADAPTATION_GAIN * (chance - _TARGET_ACCEPTANCE))
        steps = of.clip(steps, *_STEPS)
        shares.append((accepted * 1.0).mean())
    return now, of.stack(shares) if shares else start.value[:0]


def _flow(
    start: Evaluated,
    momentum: Array,
    angle: Array,
    potential: Potential,
    leapfrogs: int,
) -> tuple[Evaluated, Array]:
    """Return particles and momenta (..., P, r) after steps of the flow, angles (..., P, 1) each.

    A flow that diverges, as it may where the potential is steep and the step long, goes on from its
    start and has an infinite potential in the end, so that its move is refused.
    """
    of = _library(angle)
    cosine, sine = of.cos(angle), of.sin(angle)
    now, diverged = start, angle < 0.0
    for _ in range(leapfrogs):
        momentum = momentum - 0.5 * angle * now.gradient
        particles = cosine * now.particles + sine * momentum
        momentum = cosine * momentum - sine * now.particles
        # Neither is infinity or NaN within the bound.
        within = (abs(particles) <= _FARTHEST) & (abs(momentum) <= _FARTHEST)
        diverged = diverged | ~within.all(-1)[..., None]
        particles = of.where(diverged, start.particles, particles)
        momentum = of.where(diverged, 0.0, momentum)
        now = Evaluated(particles, *potential(particles))
        momentum = momentum - 0.5 * angle * now.gradient
    value = of.where(diverged[..., 0], math.inf, now.value)
    return now._replace(value=value), momentum


def _energy(at: Evaluated, momentum: Array) -> Array:
    squares = (at.particles * at.particles).sum(-1) + (momentum * momentum).sum(-1)
    return at.value + 0.5 * squares
