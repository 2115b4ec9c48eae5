"""Smooth random detours: a Gaussian process along the phase, zero at both ends."""

from __future__ import annotations

import functools

import numpy as np

from smp_gym.arrays import FloatArray

__all__ = ["HARMONICS", "detour_basis", "detours", "resample", "smoothstep"]


HARMONICS = 9
"""Cosines, and as many sines, that a detour is made of."""

_DETOUR_STD = 0.2
_DETOUR_LENGTH = 0.2
"""Standard deviation (rad) and length scale (phase) of the detours, those of the primitive's smooth
covariance: what it can propose is what has to be blocked."""


def smoothstep(phase: FloatArray) -> FloatArray:
    """Minimum-jerk blend from 0 to 1 with velocity and acceleration zero at both ends."""
    return np.asarray(phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))


@functools.lru_cache(maxsize=8)
def detour_basis(samples: int) -> FloatArray:
    """Return (samples, F): a detour is this times F standard normal numbers, in units of its std.

    A stationary Gaussian process with squared-exponential kernel, written as a Fourier series of
    period 2 (twice the phase, so that its ends do not feel each other) and conditioned in closed
    form on value and velocity zero at both ends. No matrix factorisation is needed, so the result
    does not depend on the number of threads of a linear algebra library.
    """
    phase = np.linspace(0.0, 1.0, samples)
    harmonics = np.arange(HARMONICS)
    omega = np.pi * harmonics
    power = np.exp(-0.5 * (omega * _DETOUR_LENGTH) ** 2)
    power[1:] *= 2.0
    amplitude = np.sqrt(power / power.sum())

    def features(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = at[:, None] * omega
        value = np.concatenate([amplitude * np.cos(angle), amplitude * np.sin(angle)], axis=1)
        slope = np.concatenate(
            [-amplitude * omega * np.sin(angle), amplitude * omega * np.cos(angle)], axis=1
        )
        return value, slope

    ends = np.concatenate(features(np.array([0.0, 1.0])))
    value, _ = features(phase)
    gain = np.einsum("tf,cf->tc", value, ends)
    gram = np.einsum("cf,df->cd", ends, ends)
    correction = np.einsum("tc,cd,df->tf", gain, np.linalg.inv(gram), ends)
    basis: FloatArray = value - correction
    basis[[0, -1]] = 0.0
    return basis


def detours(numbers: FloatArray, samples: int) -> FloatArray:
    """Return (N, samples, 6) rad from (N, F, 6) standard normal numbers."""
    return _DETOUR_STD * np.einsum("tf,nfj->ntj", detour_basis(samples), numbers)


def resample(trajectories: FloatArray, samples: int) -> FloatArray:
    """Return (N, samples, 6): (N, T, 6) at other equal steps of phase, linearly between samples."""
    at = np.linspace(0.0, trajectories.shape[1] - 1.0, samples)
    low = np.minimum(at.astype(np.int64), trajectories.shape[1] - 2)
    part = (at - low)[:, None]
    return trajectories[:, low] * (1.0 - part) + trajectories[:, low + 1] * part
