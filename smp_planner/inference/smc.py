"""Draws from a posterior as exact as time allows: sequential Monte Carlo by tempering.

Particles of the prior N(0, I) are carried through p_τ(z) ∝ exp(τ log p(O|z)) N(z; 0, I) from τ = 0
to 1 (Del Moral, Doucet & Jasra 2006; Chopin & Papaspiliopoulos 2020, Alg. 17.1). Each τ is as far
ahead as leaves a given effective sample size; particles are then resampled, and moved by the
preconditioned Crank-Nicolson kernel (Cotter et al. 2013), which leaves p_τ invariant and whose
acceptance does not fall with the number of dimensions alone. Modes keep their weights, because
particles are weighed against each other at every τ: a reference for what is faster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from smp_gym.arrays import FloatArray
from smp_planner.inference.resampling import resampled, temperature_rise

__all__ = ["LogLikelihood", "Posterior", "SMCSettings", "sample_posterior"]

LogLikelihood = Callable[[FloatArray], FloatArray]
"""Log-likelihood: from standard normals (P, d) to log p(O|z), (P,), finite."""

_TARGET_ACCEPTANCE = 0.3
"""Share of moves to accept, to which the step is adapted. Near the best of random-walk kernels."""

_ADAPTATION_GAIN = 0.5
"""Change of the step's logarithm for each unit by which the acceptance is off."""


@dataclass(frozen=True)
class SMCSettings:
    """Settings of sequential Monte Carlo.

    Attributes:
        particles: P, at least 2.
        effective: effective sample size at each temperature, as a share of P, in (0, 1).
        moves: of every particle at each temperature, at least 1.
        last_moves: of every particle at the last one, where duplicates have to part.

    Raises:
        ValueError: a number is out of range.
    """

    particles: int = 2000
    effective: float = 0.7
    moves: int = 20
    last_moves: int = 200

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise ValueError(f"particles must be at least 2, got {self.particles}")
        if not 0.0 < self.effective < 1.0:
            raise ValueError(f"effective must be in (0, 1), got {self.effective}")
        for name in ("moves", "last_moves"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")


class Posterior(NamedTuple):
    """Draws from a posterior.

    Attributes:
        particles: (P, d), all of one weight.
        log_evidence: estimate of log p(O) = log ∫ p(O|z) N(z; 0, I) dz.
        temperatures: (S,) τ, ascending to 1.
        acceptance: (S,) share of accepted moves at each.
    """

    particles: FloatArray
    log_evidence: float
    temperatures: FloatArray
    acceptance: FloatArray


def sample_posterior(
    log_likelihood: LogLikelihood,
    dimension: int,
    rng: np.random.Generator,
    settings: SMCSettings | None = None,
) -> Posterior:
    """Return draws from p(z|O) ∝ p(O|z) N(z; 0, I).

    Args:
        log_likelihood: log p(O|z).
        dimension: d, at least 1.
        rng: source of all randomness.
        settings: default `SMCSettings()`.

    Raises:
        ValueError: `dimension` is less than 1, or the likelihood is not (P,) finite numbers.
    """
    if dimension < 1:
        raise ValueError(f"dimension must be at least 1, got {dimension}")
    settings = settings or SMCSettings()
    particles = rng.standard_normal((settings.particles, dimension))
    values = _evaluate(log_likelihood, particles)
    temperature, log_evidence, step = 0.0, 0.0, 0.5
    temperatures, acceptance = [], []
    while temperature < 1.0:
        rise = temperature_rise(values, 1.0 - temperature, settings.effective * settings.particles)
        last = rise == 1.0 - temperature
        temperature = 1.0 if last else temperature + rise
        log_weights = rise * values
        log_evidence += float(logsumexp(log_weights)) - np.log(settings.particles)
        chosen = resampled(log_weights, settings.particles, rng)
        particles, values = particles[chosen], values[chosen]
        shares = []
        for _ in range(settings.last_moves if last else settings.moves):
            proposed = np.sqrt(1.0 - step**2) * particles
            proposed += step * rng.standard_normal(particles.shape)
            offered = _evaluate(log_likelihood, proposed)
            accepted = np.log(rng.uniform(size=len(values))) < temperature * (offered - values)
            particles = np.where(accepted[:, None], proposed, particles)
            values = np.where(accepted, offered, values)
            shares.append(accepted.mean())
            step = min(
                1.0, step * float(np.exp(_ADAPTATION_GAIN * (shares[-1] - _TARGET_ACCEPTANCE)))
            )
        temperatures.append(temperature)
        acceptance.append(np.mean(shares))
    return Posterior(particles, log_evidence, np.array(temperatures), np.array(acceptance))


def _evaluate(log_likelihood: LogLikelihood, particles: FloatArray) -> FloatArray:
    values = np.asarray(log_likelihood(particles), np.float64)
    if values.shape != particles.shape[:1] or not np.isfinite(values).all():
        raise ValueError(
            f"log_likelihood must return ({len(particles)},) finite numbers, got shape "
            f"{values.shape}, {np.count_nonzero(~np.isfinite(values))} of them not finite"
        )
    return values
