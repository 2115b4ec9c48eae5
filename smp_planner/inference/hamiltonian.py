"""Hamiltonian Monte Carlo whose flow keeps a standard normal prior exactly.

Particles z with the target p(z) ∝ N(z; 0, I) exp(-Φ(z)) and momenta v ~ N(0, I) move on the
Hamiltonian ½|z|² + ½|v|² + Φ(z). It is split into the rotation of (z, v), which is exact, and kicks
by ∇Φ (Beskos, Pinski, Sanz-Serna & Stuart 2011): the error of the flow, and so the share of moves
that is refused, comes from Φ alone, however many dimensions the prior has.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from smp_gym.arrays import FloatArray

__all__ = ["Evaluated", "Potential", "hamiltonian_moves"]

Potential = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Map from particles (P, r) to Φ (P,) and its gradient (P, r)."""

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
        particles: (P, r).
        value: (P,) Φ.
        gradient: (P, r) ∇Φ.
    """

    particles: FloatArray
    value: FloatArray
    gradient: FloatArray


def hamiltonian_moves(
    start: Evaluated,
    potential: Potential,
    rng: np.random.Generator,
    *,
    moves: int,
    leapfrogs: int,
    step: float,
) -> tuple[Evaluated, FloatArray]:
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
    now, steps = start, np.full(len(start.value), step)
    shares = []
    for _ in range(moves):
        momentum = rng.standard_normal(now.particles.shape)
        # Angles that differ from move to move keep particles from coming back to where they were.
        angle = steps[:, None] * rng.uniform(0.8, 1.2)
        offered, moved = _flow(now, momentum, angle, potential, leapfrogs)
        change = _energy(now, momentum) - _energy(offered, moved)
        accepted = np.log(rng.uniform(size=len(change))) < change
        now = Evaluated(
            np.where(accepted[:, None], offered.particles, now.particles),
            np.where(accepted, offered.value, now.value),
            np.where(accepted[:, None], offered.gradient, now.gradient),
        )
        chance = np.exp(np.minimum(change, 0.0))
        steps = np.clip(steps * np.exp(_ADAPTATION_GAIN * (chance - _TARGET_ACCEPTANCE)), *_STEPS)
        shares.append(accepted.mean())
    return now, np.array(shares)


def _flow(
    start: Evaluated,
    momentum: FloatArray,
    angle: FloatArray,
    potential: Potential,
    leapfrogs: int,
) -> tuple[Evaluated, FloatArray]:
    """Return particles and momenta (P, r) after some steps of the flow, angles (P, 1) each.

    A flow that diverges, as it may where the potential is steep and the step long, goes on from its
    start and has an infinite potential in the end, so that its move is refused.
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    now, diverged = start, np.zeros(len(angle), np.bool_)
    for _ in range(leapfrogs):
        momentum = momentum - 0.5 * angle * now.gradient
        particles = cosine * now.particles + sine * momentum
        momentum = cosine * momentum - sine * now.particles
        # Neither is infinity or NaN within the bound.
        diverged |= ~(np.abs([particles, momentum]) <= _FARTHEST).all(axis=(0, 2))
        particles = np.where(diverged[:, None], start.particles, particles)
        momentum = np.where(diverged[:, None], 0.0, momentum)
        now = Evaluated(particles, *potential(particles))
        momentum = momentum - 0.5 * angle * now.gradient
    return now._replace(value=np.where(diverged, np.inf, now.value)), momentum


def _energy(at: Evaluated, momentum: FloatArray) -> FloatArray:
    squares = np.square(at.particles).sum(axis=1) + np.square(momentum).sum(axis=1)
    return np.asarray(at.value + 0.5 * squares)
