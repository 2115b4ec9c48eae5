"""The smooth box prior of Eq. (14): uniform in a box, with Gaussian tails outside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["SmoothBox", "box_offset"]

Array = TypeVar("Array", Tensor, NDArray[np.float64])


def box_offset(value: Array, lower: Array, upper: Array) -> Array:
    """Return the signed distance to a box in each dimension, the d of Eq. (14); 0 inside.

    Args:
        value: (..., D), an array or a tensor.
        lower: (D,) lower corner, or (..., D).
        upper: (D,) upper corner, or (..., D).
    """
    return value - value.clip(lower, upper)


@dataclass(frozen=True, eq=False)
class SmoothBox:
    """A distribution that is flat inside a box and falls off smoothly outside, Eq. (14).

    The log-density is -d² / (2 σ²) for each dimension plus a constant, where d is the distance to
    the box in that dimension. It is continuously differentiable and its gradient is zero inside.
    Eq. (14) prints √2 σ² where the Gaussian tail has 2 σ²; `paper_scale` takes it as printed.

    Attributes:
        lower: (D,) lower corner, in the unit of what is constrained (rad or m).
        upper: (D,) upper corner; equal to `lower` in a dimension, the box is a Gaussian there.
        sigma: (D,) or one number, standard deviation of the tails, same unit.
        paper_scale: divide d² by √2 σ² instead of 2 σ².

    Raises:
        ValueError: corners are not finite vectors of one length, `lower` exceeds `upper`, or
            `sigma` is not positive.
    """

    lower: Tensor
    upper: Tensor
    sigma: Tensor
    paper_scale: bool = False

    def __post_init__(self) -> None:
        lower = torch.as_tensor(self.lower)
        if not lower.is_floating_point():
            lower = lower.double()
        upper = torch.as_tensor(self.upper, dtype=lower.dtype, device=lower.device)
        sigma = torch.as_tensor(self.sigma, dtype=lower.dtype, device=lower.device)
        if lower.ndim != 1 or upper.shape != lower.shape:
            raise ValueError(
                f"lower and upper must be vectors of one length, got shapes "
                f"{tuple(lower.shape)} and {tuple(upper.shape)}"
            )
        if not bool((torch.isfinite(lower) & torch.isfinite(upper) & (lower <= upper)).all()):
            raise ValueError(f"lower must be finite and not exceed upper, got {lower} and {upper}")
        if sigma.shape not in ((), lower.shape):
            raise ValueError(
                f"sigma must be one number or have shape {tuple(lower.shape)}, "
                f"got {tuple(sigma.shape)}"
            )
        if not bool((torch.isfinite(sigma) & (sigma > 0)).all()):
            raise ValueError(f"sigma must be positive and finite, got {sigma}")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)
        object.__setattr__(self, "sigma", sigma.expand_as(lower))

    @property
    def variance(self) -> Tensor:
        """(D,) variance of the tails: σ², or σ²/√2 as printed in the paper."""
        return self.sigma.square() / (math.sqrt(2.0) if self.paper_scale else 1.0)

    def distance(self, value: Tensor) -> Tensor:
        """Return the signed distance to the box in each dimension: 0 inside, (..., D) -> (..., D).

        Raises:
            ValueError: the last dimension of `value` is not D.
        """
        if value.shape[-1:] != self.lower.shape:
            raise ValueError(
                f"value must have shape (..., {len(self.lower)}), got {tuple(value.shape)}"
            )
        return box_offset(value, self.lower, self.upper)

    def contains(self, value: Tensor) -> Tensor:
        """Return whether points lie in the box, (..., D) -> (...) of bool."""
        return (self.distance(value) == 0).all(-1)

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-density, (..., D) -> (...)."""
        volume = (self.upper - self.lower) + (2.0 * math.pi * self.variance).sqrt()
        exponent = -0.5 * self.distance(value).square() / self.variance
        return (exponent - volume.log()).sum(-1)

    def score(self, value: Tensor) -> Tensor:
        """Return the gradient of the log-density, (..., D) -> (..., D)."""
        return -self.distance(value) / self.variance
