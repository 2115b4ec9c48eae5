"""The exponential method of multipliers for constraints h(x) <= 0.

To the objective is added, for each constraint, nu phi(h / s) with a multiplier nu and a scale s; x
minimises the sum, nu is multiplied by phi'(h / s), and so on. Where x minimises, nu phi'(h / s) / s
is the Lagrange multiplier: nearly zero where a constraint is kept with room, whatever nu is (Kort &
Bertsekas 1972; Bertsekas 1982, Ch. 5, where phi is e^u - 1). As in Ben-Tal & Zibulevsky 1997, phi
goes on as a quadratic where the exponential grows too fast.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["penalty", "penalty_slope", "updated_multipliers"]

_BEND = 1.0
"""Excess from which on the penalty is a quadratic."""

_MOST_CHANGE = 2.0
"""Factor by which a multiplier grows or falls at most in one update."""


def penalty(excess: Tensor) -> Tensor:
    """Return phi, e^u - 1 up to u = 1 and its quadratic from there on, (...) -> (...).

    Args:
        excess: u, by how many scales a constraint is missed; negative where it is kept.
    """
    # Two clamps would both pass a gradient at the bend.
    low = torch.where(excess < _BEND, excess, _BEND).exp()
    over = (excess - _BEND).clamp(min=0.0)
    return low - 1.0 + math.exp(_BEND) * (over + 0.5 * over.square())


def penalty_slope(excess: Tensor) -> Tensor:
    """Return phi'(u) > 0 of `penalty`, (...) -> (...)."""
    low = excess.clamp(max=_BEND).exp()
    return low * (1.0 + (excess - _BEND).clamp(min=0.0))


def updated_multipliers(
    multipliers: Tensor, excess: Tensor, least: float, largest: float
) -> Tensor:
    """Return multipliers after one update, nu phi'(u), (...) -> (...).

    Args:
        multipliers: (...) nu, positive.
        excess: (...) u where the last sum was minimised.
        least: to which they may fall, above 0: what is far away stays in sight.
        largest: to which they may grow.

    Raises:
        ValueError: the bounds are not positive and in order.
    """
    if not 0.0 < least <= largest:
        raise ValueError(
            f"least and largest must be positive and in order, got {least} and {largest}"
        )
    slope = penalty_slope(excess).clamp(1.0 / _MOST_CHANGE, _MOST_CHANGE)
    return (multipliers * slope).clamp(least, largest)
