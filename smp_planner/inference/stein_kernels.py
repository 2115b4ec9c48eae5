"""Kernels of Stein variational gradient descent, in closed form, and rules for their bandwidth.

A kernel is any callable that takes particles (..., P, d) and returns a `KernelTerms`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

__all__ = [
    "RBF",
    "BandwidthRule",
    "InverseMultiquadric",
    "Kernel",
    "KernelTerms",
    "MetricKernel",
    "median_bandwidth",
    "median_over_log_bandwidth",
]

BandwidthRule = Callable[[Tensor], Tensor]
"""Rule from squared distances (..., P, P) of particles to the bandwidth h (...), in their unit."""


class KernelTerms(NamedTuple):
    """Values of a kernel that one iteration needs.

    Attributes:
        gram: (..., P, P) k(x_j, x_i) in row i and column j.
        repulsion: (..., P, d) Σ_j ∇_{x_j} k(x_j, x_i) in row i.
    """

    gram: Tensor
    repulsion: Tensor


class Kernel(Protocol):
    """Protocol of positive definite kernels with their gradients."""

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


def _check_bandwidth(bandwidth: float | BandwidthRule) -> None:
    if not callable(bandwidth) and not (math.isfinite(bandwidth) and bandwidth > 0):
        raise ValueError(f"bandwidth must be positive and finite, got {bandwidth}")


def _inverse_bandwidth(bandwidth: float | BandwidthRule, squared: Tensor) -> Tensor:
    """Return 1 / h, (..., 1, 1) or one number, from the squared distances (..., P, P)."""
    if callable(bandwidth):
        return bandwidth(squared).reciprocal()[..., None, None]
    return squared.new_tensor(1.0 / bandwidth)


def _repulsion(slopes: Tensor, inverse: Tensor, particles: Tensor) -> Tensor:
    """Return Σ_j ∇_{x_j} k of a kernel f(|x_j - x_i|² / h), (..., P, d).

    Args:
        slopes: (..., P, P) -f', symmetric.
        inverse: 1 / h.
        particles: (..., P, d).
    """
    pull = slopes @ particles - slopes.sum(-1, keepdim=True) * particles
    return -2.0 * inverse * pull


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
        _check_bandwidth(self.bandwidth)

    def __call__(self, particles: Tensor) -> KernelTerms:
        """Return the kernel between all particles, (..., P, d)."""
        squared = _squared_distances(particles)
        inverse = _inverse_bandwidth(self.bandwidth, squared)
        gram = torch.exp(-squared * inverse)
        return KernelTerms(gram, _repulsion(gram, inverse, particles))


@dataclass(frozen=True)
class InverseMultiquadric:
    """The inverse multi-quadric kernel k(x, y) = (1 + |x - y|² / h)^(-1/2).

    Its tails are long, so that far particles still see each other. The Stein discrepancy with it
    controls convergence, which that with `RBF` does not in three or more dimensions (Gorham &
    Mackey 2017, Measuring Sample Quality with Kernels).

    Attributes:
        bandwidth: h, as of `RBF`.

    Raises:
        ValueError: `bandwidth` is a number that is not positive.
    """

    bandwidth: float | BandwidthRule = median_bandwidth

    def __post_init__(self) -> None:
        _check_bandwidth(self.bandwidth)

    def __call__(self, particles: Tensor) -> KernelTerms:
        """Return the kernel between all particles, (..., P, d)."""
        squared = _squared_distances(particles)
        inverse = _inverse_bandwidth(self.bandwidth, squared)
        gram = (1.0 + squared * inverse).rsqrt()
        return KernelTerms(gram, _repulsion(0.5 * gram**3, inverse, particles))


@dataclass(frozen=True, eq=False)
class MetricKernel:
    """A kernel of the distance |R (x - y)|: in the metric M = Rᵀ R in place of the identity.

    With the R of `ProMP.path_root` it measures how far apart two paths are, not two weights; with
    the R L of its factor L it does so in whitened coordinates. What R maps to zero makes no
    distance, so particles do not repel each other there.

    Attributes:
        root: (m, d) R, of any rank; None until it is known.
        kernel: of the vectors R x, with a bandwidth in the unit of their squares.

    Raises:
        ValueError: `root` is not a matrix, or not finite.
    """

    root: Tensor | None = None
    kernel: Kernel = field(default_factory=RBF)

    def __post_init__(self) -> None:
        if self.root is None:
            return
        if self.root.ndim != 2:
            raise ValueError(f"root must have shape (m, d), got {tuple(self.root.shape)}")
        if not bool(torch.isfinite(self.root).all()):
            raise ValueError("root must be finite, got NaN or infinity")

    def __call__(self, particles: Tensor) -> KernelTerms:
        """Return the kernel between all particles, (..., P, d).

        Raises:
            ValueError: `root` is not known, or does not fit the particles.
        """
        if self.root is None:
            raise ValueError("root of a MetricKernel must be given before it is used, got None")
        if self.root.shape[1] != particles.shape[-1]:
            raise ValueError(
                f"root must have shape (m, {particles.shape[-1]}) for these particles, "
                f"got {tuple(self.root.shape)}"
            )
        gram, repulsion = self.kernel(particles @ self.root.mT)
        return KernelTerms(gram, repulsion @ self.root)
