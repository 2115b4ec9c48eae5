"""The unscented transform: moments of a function of a Gaussian from its values at a few points.

Julier & Uhlmann 1997, with a weight of the middle that is never negative, so that variances are not
either.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["sigma_points", "unscented_moments"]

_CENTRE = 1.0
"""kappa of the transform: the middle weighs kappa / (D + kappa), each other point half of 1 / (D +
kappa)."""


def sigma_points(mean: Tensor, covariance: Tensor) -> Tensor:
    """Return the sigma points of Gaussians, differentiable by autograd.

    Args:
        mean: (..., D).
        covariance: (..., D, D), positive definite.

    Returns:
        (..., 2 D + 1, D): the mean, and to both sides of it the columns of the Cholesky factor
        times sqrt(D + kappa), kappa = 1.

    Raises:
        ValueError: the shapes do not fit, or a covariance is not positive definite.
    """
    dimension = mean.shape[-1]
    if covariance.shape != (*mean.shape, dimension):
        raise ValueError(
            f"covariance must have shape {(*mean.shape, dimension)}, got {tuple(covariance.shape)}"
        )
    root, failed = torch.linalg.cholesky_ex(covariance)
    if bool((failed > 0).any()):
        raise ValueError("covariance must be positive definite, got one that is not")
    offsets = math.sqrt(dimension + _CENTRE) * root.mT
    middle = mean[..., None, :]
    return torch.cat([middle, middle + offsets, middle - offsets], -2)


def unscented_moments(values: Tensor) -> tuple[Tensor, Tensor]:
    """Return means and variances of functions of a Gaussian; exact for linear functions.

    Args:
        values: (..., 2 D + 1, M) of M functions at the sigma points of `sigma_points`.

    Returns:
        (..., M) means, exact for quadratic functions, too, and (..., M) variances.

    Raises:
        ValueError: the points are not odd in number, or fewer than 3.
    """
    count = values.shape[-2] if values.ndim > 1 else 0
    if count < 3 or count % 2 == 0:
        raise ValueError(f"values must have shape (..., 2 D + 1, M), got {tuple(values.shape)}")
    outer = 0.5 / ((count - 1) / 2 + _CENTRE)
    weights = values.new_full((count, 1), outer)
    weights[0] = 2.0 * _CENTRE * outer
    mean = (weights * values).sum(-2)
    return mean, (weights * (values - mean[..., None, :]).square()).sum(-2)
