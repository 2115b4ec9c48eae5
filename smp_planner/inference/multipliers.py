"""The exponential method of multipliers for constraints h(x) <= 0.

To the objective is added, for each constraint, nu phi(h / s) with a multiplier nu and a scale s; x
minimises the sum, nu is multiplied by phi'(h / s), and so on. At a fixed point nu h = 0, and nu / s
is the Lagrange multiplier (Kort & Bertsekas 1972; Bertsekas 1982, Ch. 5, where phi is e^u - 1). As
in Ben-Tal & Zibulevsky 1997, phi goes on as a quadratic where the exponential grows too fast.
"""

from __future__ import annotations

import math

from torch import Tensor

__all__ = ["penalty", "updated_multipliers"]

_BEND = 1.0
"""Excess from which on the penalty is a quadratic."""

_MOST_CHANGE = 10.0
"""Factor by which a multiplier grows or falls at most in one update."""

_LEAST = 1e-12
"""Multipliers fall no further, or a constraint could never come back."""


def penalty(excess: Tensor) -> Tensor:
    """Return phi, e^u - 1 up to u = 1 and its quadratic from there on, (...) -> (...).

    Args:
        excess: u, by how many scales a constraint is missed; negative where it is kept.
    """
    low = excess.clamp(max=_BEND).exp()
    over = (excess - _BEND).clamp(min=0.0)
    return low - 1.0 + math.exp(_BEND) * (over + 0.5 * over.square())


def updated_multipliers(multipliers: Tensor, excess: Tensor, largest: float) -> Tensor:
    """Return multipliers after one update, nu phi'(u), (...) -> (...).

    Args:
        multipliers: (...) nu, positive.
        excess: (...) u where the last sum was minimised.
        largest: to which they may grow.
    """
    low = excess.clamp(max=_BEND).exp()
    slope = low * (1.0 + (excess - _BEND).clamp(min=0.0))
    changed = multipliers * slope.clamp(1.0 / _MOST_CHANGE, _MOST_CHANGE)
    return changed.clamp(_LEAST, largest)
