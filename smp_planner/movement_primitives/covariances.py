"""Covariances of weights: smooth ones, checks of given ones, and factors L with Σ = L Lᵀ."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_planner.movement_primitives.basis import GaussianBasis

__all__ = [
    "checked_covariance",
    "checked_std",
    "orthogonal_columns",
    "rounding",
    "smooth_covariance",
    "square_root",
]


def smooth_covariance(
    basis: GaussianBasis,
    dimension: int,
    std: float | ArrayLike,
    length_scale: float,
    like: Tensor | None = None,
) -> Tensor:
    """Return a covariance of weights that is smooth along the phase.

    Weights of one dimension covary as exp(-(c - c')² / (2 ℓ²)) with the distance of their centres;
    weights of different dimensions do not. The scale is such that a trajectory at phase 1/2 has the
    standard deviation `std`.

    Args:
        basis: K basis functions.
        dimension: D.
        std: of the trajectory, in its unit; 0 or more. Of every dimension, or of each (D,).
        length_scale: ℓ, in phase.
        like: gives dtype and device (default: float64 on CPU).

    Returns:
        (K*D, K*D), positive semi-definite.

    Raises:
        ValueError: `std` is negative or of another shape, or `length_scale` is not positive.
    """
    std = checked_std("std", std, dimension)
    length_scale = checked_number("length_scale", length_scale, above=0.0)
    centers = basis.centers(like)
    distance = (centers[:, None] - centers) / length_scale
    along_phase = torch.exp(-0.5 * distance.square())
    middle = basis.values(centers.new_tensor(0.5))
    identity = torch.eye(dimension, dtype=centers.dtype, device=centers.device)
    if isinstance(std, float):
        along_phase = along_phase * (std**2 / (middle @ along_phase @ middle))
        return torch.kron(along_phase, identity)
    along_phase = along_phase / (middle @ along_phase @ middle)
    return torch.kron(along_phase, identity * torch.as_tensor(std**2).to(identity))


def checked_std(name: str, value: Any, dimension: int) -> float | FloatArray:
    """Return a standard deviation of all dimensions, or of each (D,).

    Args:
        name: of the argument, for the message.
        value: one number, or D of them.
        dimension: D.

    Raises:
        ValueError: neither of them, negative, or not finite.
    """
    if np.ndim(value) == 0:
        return checked_number(name, value, least=0.0)
    found = checked_array(name, value, (dimension,))
    if (found < 0.0).any():
        raise ValueError(f"{name} must be at least 0, got {found.tolist()}")
    return found


def rounding(like: Tensor) -> float:
    """Return the size, relative to the largest, under which a standard deviation is rounding."""
    return 1e3 * torch.finfo(like.dtype).eps


def orthogonal_columns(factor: Tensor) -> Tensor:
    """Return L' with L' L'ᵀ = L Lᵀ, orthogonal columns of falling length, zeros dropped."""
    if 0 in factor.shape:
        return factor
    left, singular, _ = torch.linalg.svd(factor, full_matrices=False)
    keep = singular > rounding(factor) * singular[0]
    return (left * singular)[:, keep]


def square_root(covariance: Tensor) -> Tensor:
    """Return L, (n, r), with L Lᵀ = `covariance`, leaving out eigenvalues that are rounding."""
    eigenvalues, eigenvectors = torch.linalg.eigh(covariance)
    keep = eigenvalues > rounding(covariance) * eigenvalues[-1].clamp_min(0.0)
    return eigenvectors[:, keep] * eigenvalues[keep].sqrt()


def checked_covariance(name: str, value: Any, size: int, like: Tensor) -> Tensor:
    """Check a covariance (size, size), or the diagonal (size,) of one, and return it in full."""
    matrix = torch.as_tensor(value, dtype=like.dtype, device=like.device)
    if matrix.shape == (size,):
        matrix = torch.diag(matrix)
    if matrix.shape != (size, size):
        raise ValueError(
            f"{name} must have shape ({size}, {size}) or ({size},), got {tuple(matrix.shape)}"
        )
    if not bool(torch.isfinite(matrix).all()):
        raise ValueError(f"{name} must be finite, got {matrix}")
    tolerance = math.sqrt(torch.finfo(matrix.dtype).eps) * matrix.abs().max()
    if bool(((matrix - matrix.mT).abs() > tolerance).any()):
        raise ValueError(f"{name} must be symmetric, got {matrix}")
    smallest = torch.linalg.eigvalsh(matrix)[0]
    if bool(smallest < -tolerance):
        raise ValueError(
            f"{name} must be positive semi-definite, got an eigenvalue of {smallest.item():.3g}"
        )
    return (matrix + matrix.mT) / 2
