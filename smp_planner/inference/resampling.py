"""Weights of a population and its resampling, as sequential Monte Carlo uses them.

Source: Del Moral, Doucet & Jasra 2006, Sec. 3; Chopin & Papaspiliopoulos 2020, Ch. 9 and 17.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from smp_gym.arrays import FloatArray

__all__ = ["effective_size", "resampled", "temperature_rise"]


def effective_size(log_weights: FloatArray) -> float:
    """Return the effective sample size (Σ W)² / Σ W² of log-weights (P,), in [1, P]."""
    weights = _weights(log_weights)
    return float(weights.sum() ** 2 / np.square(weights).sum())


def temperature_rise(log_likelihood: FloatArray, left: float, effective: float) -> float:
    """Return by how much the temperature may rise, at most what is left.

    Args:
        log_likelihood: (P,) of particles of equal weight.
        left: of the temperature, until 1.
        effective: sample size that the rise has to leave, less than P.
    """

    def excess(rise: float) -> float:
        return effective_size(rise * log_likelihood) - effective

    return left if excess(left) >= 0.0 else float(brentq(excess, 0.0, left, rtol=1e-6))


def resampled(log_weights: FloatArray, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return the ascending indices (count,) that systematic resampling chooses.

    Args:
        log_weights: (P,), of any sum.
        count: how many are chosen.
        rng: source of all randomness.
    """
    weights = _weights(log_weights)
    weights /= weights.sum()
    positions = (rng.uniform() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), len(weights) - 1)


def _weights(log_weights: FloatArray) -> FloatArray:
    """Return weights (P,), the largest of them 1."""
    return np.asarray(np.exp(log_weights - log_weights.max()))
