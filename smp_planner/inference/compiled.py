"""Compiled twins of the Stein direction and of Adam, for the sets of one plan on the processor.

Forty particles make matrices so small that torch spends its time on calling itself. The arithmetic
is that of `smp_planner.inference.svgd.stein_direction` with `RBF(median_bandwidth)`, and of `Adam`.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel

__all__ = ["adam_change", "fits", "median_rbf_direction"]

MOST_PARTICLES = 128
"""Particles beyond which products of whole matrices are faster."""

_LEAST_BANDWIDTH = float(np.finfo(np.float64).tiny)


def fits(*tensors: Tensor) -> bool:
    """Return whether the twins take tensors (..., P, d): float64 on the processor, few rows."""
    return all(
        tensor.device.type == "cpu"
        and tensor.dtype == torch.float64
        and not tensor.requires_grad
        and tensor.is_contiguous()
        and tensor.ndim > 1
        and 1 <= tensor.shape[-2] <= MOST_PARTICLES
        for tensor in tensors
    )


@kernel(fastmath=FAST)
def _direction(particles, score, attraction, direction):
    """Write the direction (P, d) of Eq. (5).

    Args:
        particles: (P, d).
        score: (P, d).
        attraction: factor of the attractive term.
        direction: (P, d), written.
    """
    count, size = particles.shape
    squared = np.zeros((count, count))
    between = np.empty(count * (count - 1) // 2)
    pair = 0
    for i in range(count):
        for j in range(i):
            total = 0.0
            for k in range(size):
                apart = particles[i, k] - particles[j, k]
                total += apart * apart
            squared[i, j] = squared[j, i] = total
            between[pair] = total
            pair += 1
    bandwidth = 1.0
    if count > 1:
        middle = (len(between) - 1) // 2
        bandwidth = max(np.partition(between, middle)[middle], _LEAST_BANDWIDTH)
    inverse = 1.0 / bandwidth
    pull = np.empty(size)
    for i in range(count):
        row = direction[i]
        row[:] = 0.0
        pull[:] = 0.0
        for j in range(count):
            weight = math.exp(-squared[i, j] * inverse)
            for k in range(size):
                row[k] += weight * score[j, k]
                pull[k] += weight * (particles[j, k] - particles[i, k])
        for k in range(size):
            row[k] = (attraction * row[k] - 2.0 * inverse * pull[k]) / count


def median_rbf_direction(particles: Tensor, score: Tensor, attraction: float) -> Tensor:
    """Return `stein_direction` with `RBF(median_bandwidth)`, of what `fits`.

    Args:
        particles: (..., P, d).
        score: (..., P, d).
        attraction: factor of the attractive term.
    """
    shape = particles.shape
    points, slopes = (of.numpy().reshape(-1, *shape[-2:]) for of in (particles, score))
    direction: FloatArray = np.empty(points.shape)
    for run in range(len(points)):
        _direction(points[run], slopes[run], float(attraction), direction[run])
    return torch.from_numpy(direction.reshape(shape))


@kernel(fastmath=FAST)
def _adam(direction, first, second, momentum, decay, epsilon, taken, change, mean, square):
    """Write change, mean and mean square (N,) of directions (N,) after so many were taken."""
    of_mean, of_square = 1.0 / (1.0 - momentum**taken), 1.0 / (1.0 - decay**taken)
    for i in range(len(direction)):
        step = direction[i]
        mean[i] = step + momentum * (first[i] - step)
        square[i] = step * step + decay * (second[i] - step * step)
        change[i] = of_mean * mean[i] / (math.sqrt(of_square * square[i]) + epsilon)


def adam_change(
    direction: Tensor,
    memory: tuple[Tensor, Tensor],
    taken: int,
    momentum: float,
    decay: float,
    epsilon: float,
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Return `Adam.update` of what `fits`.

    Args:
        direction: (..., P, d).
        memory: averages of directions and of their squares.
        taken: directions so far, this one included.
        momentum: β₁.
        decay: β₂.
        epsilon: see `Adam`.
    """
    parts = [of.numpy().reshape(-1) for of in (direction, *memory)]
    written: list[FloatArray] = [np.empty(direction.numel()) for _ in range(3)]
    _adam(*parts, momentum, decay, epsilon, taken, *written)
    change, mean, square = (torch.from_numpy(of.reshape(direction.shape)) for of in written)
    return change, (mean, square)
