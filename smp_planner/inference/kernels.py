"""Kernels of Stein variational gradient descent, in closed form, and rules for their bandwidth.

A kernel is any callable that takes particles (..., P, d) and returns a `KernelTerms`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

__all__ = [
    "RBF",
    "BandwidthRule",
    "Kernel",
    "KernelTerms",
    "median_bandwidth",
    "median_over_log_bandwidth",
]

BandwidthRule = Callable[[Tensor], Tensor]
"""From squared distances (..., P, P) of particles to the bandwidth h (...), their unit squared."""


class KernelTerms(NamedTuple):
    """What one iteration needs to know of a kernel.

    Attributes:
        gram: (..., P, P) k(x_j, x_i) in row i and column j.
        repulsion: (..., P, d) Σ_j ∇_{x_j} k(x_j, x_i) in row i.
    """

    gram: Tensor
    repulsion: Tensor


class Kernel(Protocol):
    """A positive definite kernel with its gradient."""

    def __call__(self, particles: Tensor) -> KernelTerms:
        """Return the kernel between all particles, (..., P, d)."""
        ...


def median_bandwidth(squared_distances: Tensor) -> Tensor:
    """Return the squared median distance of two particles: the scale of the set itself.

    Args:
        squared_distances: (..., P, P), zero on the diagonal.

    Returns:
        (...), positive also if particles coincide; 1 for a single particle. For an even number of
        pairs it is the lower of the two medians.
    """
    count = squared_distances.shape[-1]
    flat = squared_distances.flatten(-2)
    if count < 2:
        return flat.new_ones(flat.shape[:-1])
    pairs = count * (count - 1) // 2
    # The diagonal holds the `count` smallest entries, and every pair stands there twice.
    rank = count + 2 * ((pairs - 1) // 2) + 1
    return flat.kthvalue(rank, -1).values.clamp_min(torch.finfo(flat.dtype).tiny)


def median_over_log_bandwidth(squared_distances: Tensor) -> Tensor:
    """Return med² / log P, with which the kernel of the median pair is 1 / P.

    A particle then weighs about as much as all others together (Liu & Wang 2016, Sec. 5).

    Args:
        squared_distances: (..., P, P), zero on the diagonal.

    Returns:
        (...), as `median_bandwidth`.
    """
    count = squared_distances.shape[-1]
    return median_bandwidth(squared_distances) / (math.log(count) if count > 1 else 1.0)


def _squared_distances(particles: Tensor) -> Tensor:
    """Return |x_i - x_j|², (..., P, P), zero on the diagonal."""
    # Centred, so that a set far from the origin loses no digits to |x|² - 2 x·y + |y|².
    centred = particles - particles.mean(-2, keepdim=True)
    products = centred @ centred.mT
    norms = products.diagonal(dim1=-2, dim2=-1)
    squared = (norms.unsqueeze(-1) + norms.unsqueeze(-2) - 2.0 * products).clamp_min_(0.0)
    squared.diagonal(dim1=-2, dim2=-1).zero_()
    return squared


@dataclass(frozen=True)
class RBF:
    """The squared exponential kernel k(x, y) = exp(-|x - y|² / h) (Sec. III-B).

    Attributes:
        bandwidth: h as a number, or the rule that finds it from the particles at every iteration.
            The kernel's gradient takes h as a constant, as is usual.

    Raises:
        ValueError: `bandwidth` is a number that is not positive.
    """

    bandwidth: float | BandwidthRule = median_bandwidth

    def __post_init__(self) -> None:
        if not callable(self.bandwidth) and not (
            math.isfinite(self.bandwidth) and self.bandwidth > 0
        ):
            raise ValueError(f"bandwidth must be positive and finite, got {self.bandwidth}")

    def __call__(self, particles: Tensor) -> KernelTerms:
        """Return the kernel between all particles, (..., P, d)."""
        squared = _squared_distances(particles)
        if callable(self.bandwidth):
            inverse = self.bandwidth(squared).reciprocal()[..., None, None]
        else:
            inverse = particles.new_tensor(1.0 / self.bandwidth)
        gram = torch.exp(-squared * inverse)
        pull = gram @ particles - gram.sum(-1, keepdim=True) * particles
        return KernelTerms(gram, -2.0 * inverse * pull)
