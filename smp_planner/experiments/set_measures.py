"""Measures of a set of trajectories against draws of the posterior and against demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray, IntArray
from smp_planner.benchmark.metrics import (
    energy_distance,
    frechet,
    log_dimensionless_jerk,
    path_lengths,
    resample,
    rms_distances,
    wasserstein,
)

__all__ = ["PosteriorSample", "against_posterior", "of_trajectories", "total_variation"]


@dataclass(frozen=True)
class PosteriorSample:
    """Independent draws of the posterior of a scene.

    Attributes:
        draws: (R, T, D) rad.
        floor: (P, T, D) rad, as many others as a set has particles: the noise floor.
        radius: rad, `rms_distances` within which half of the draws have one of P further ones.
    """

    draws: FloatArray
    floor: FloatArray
    radius: float

    @classmethod
    def of(
        cls, draws: FloatArray, others: FloatArray, size: int, rng: np.random.Generator
    ) -> PosteriorSample | None:
        """Return the sample of two runs of the sampler; None where they have too few draws.

        Args:
            draws: (R, T, D) rad, of one run.
            others: (S, T, D) rad, of another.
            size: P; at most half of the others are taken.
            rng: source of all randomness.
        """
        size = min(size, len(others) // 2)
        if len(draws) < 2 or size < 2:
            return None
        chosen = rng.choice(len(others), 2 * size, replace=False)
        floor, further = others[chosen[:size]], others[chosen[size:]]
        nearest = rms_distances(resample(draws), resample(further)).min(axis=1)
        return cls(draws, floor, float(np.median(nearest)))


def against_posterior(trajectories: FloatArray, sample: PosteriorSample) -> dict[str, float]:
    """Return by name how far a set (P, T, D) rad is from the posterior; P at least 2.

    ``energy``, ``wasserstein`` and ``frechet`` are distances, mrad, of the metrics of these names;
    ``coverage`` is the share, %, of the draws that have a trajectory within the sample's radius.
    """
    set_, draws = resample(trajectories), resample(sample.draws)
    near = rms_distances(draws, set_).min(axis=1) <= sample.radius
    return {
        "energy": 1e3 * energy_distance(set_, draws),
        "wasserstein": 1e3 * wasserstein(set_, draws),
        "frechet": 1e3 * frechet(set_, draws),
        "coverage": 100.0 * float(near.mean()),
    }


def total_variation(signatures: IntArray, reference: IntArray) -> float:
    """Return half the sum of the differences of the classes' shares in two sets, in [0, 1].

    Args:
        signatures: (P, M), equal within a class, P at least 1.
        reference: (R, M) of the other set.
    """
    both = np.concatenate([signatures, reference])
    known, labels = np.unique(both, axis=0, return_inverse=True)
    first, second = (
        np.bincount(part.ravel(), minlength=len(known)) / len(part)
        for part in np.split(labels, [len(signatures)])
    )
    return float(0.5 * np.abs(first - second).sum())


def of_trajectories(
    trajectories: FloatArray, demonstrations: Sequence[FloatArray]
) -> dict[str, float]:
    """Return by name what is measured of a set (P, T, D) rad without the posterior.

    ``demonstrations`` is the Wasserstein distance, mrad, to the demonstrations (T_j, D) themselves,
    whose starts and ends are others; ``length``, rad, and ``jerk``, the log-dimensionless one
    (greater is smoother), are means.
    """
    shown = np.concatenate([resample(one[None]) for one in demonstrations])
    return {
        "demonstrations": 1e3 * wasserstein(resample(trajectories), shown),
        "length": float(path_lengths(trajectories).mean()),
        "jerk": float(log_dimensionless_jerk(trajectories).mean()),
    }
