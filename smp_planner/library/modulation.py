"""Requests for points that a path passes: via-points, boxes, and choices among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray, checked_array, checked_number, shown
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint

__all__ = ["AnyOf", "Box", "ViaPoint"]


def _vector(name: str, value: ArrayLike) -> FloatArray:
    array = checked_array(name, value, (None,))
    if not len(array):
        raise ValueError(f"{name} must be a vector of finite numbers, got none")
    return array


@dataclass(frozen=True, eq=False)
class Box:
    """A box in which a path starts or ends, with Gaussian tails outside: Eq. (14).

    Attributes:
        lower: (D,) lower corner, in the unit of the path.
        upper: (D,) upper corner.
        sigma: same unit, standard deviation of the tails; None takes that of the settings.
        paper_scale: reads the denominator of Eq. (14) as printed, √2 σ², in place of 2 σ².
    """

    lower: FloatArray
    upper: FloatArray
    sigma: float | None = None
    paper_scale: bool = False

    def __post_init__(self) -> None:
        lower, upper = _vector("Box.lower", self.lower), _vector("Box.upper", self.upper)
        if lower.shape != upper.shape or not (lower <= upper).all():
            raise ValueError(f"Box.lower {lower} must not exceed Box.upper {upper}")
        if self.sigma is not None:
            object.__setattr__(self, "sigma", checked_number("Box.sigma", self.sigma, above=0.0))
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)


_SHOWN = 4
"""Options that a choice names when it is shown."""


@dataclass(frozen=True, eq=False)
class AnyOf:
    """Alternative places: a mixture, C_mod = -log Σ π_h N(Φ_t w; μ_h, Σ_h).

    Attributes:
        options: points (D,) or `Box`es for start and goal; `ViaPoint`s of one phase for via-points;
            `GoalRegion`s for the goal of a robot's tool, `ToolViaPoint`s of one phase for its
            via-points.
        shares: π_h, positive; equal by default.
    """

    options: Sequence[ArrayLike | Box | ViaPoint | GoalRegion | ToolViaPoint]
    shares: Sequence[float] | None = None

    def __post_init__(self) -> None:
        given: Any = self.options
        if not isinstance(given, Sequence | np.ndarray) or isinstance(given, str) or not len(given):
            raise ValueError(f"AnyOf.options must be places in a list, got {shown(given)}")
        options = tuple(given)
        shares = np.ones(len(options))
        if self.shares is not None:
            shares = checked_array("AnyOf.shares", self.shares)
        if shares.shape != (len(options),) or not (np.isfinite(shares) & (shares > 0)).all():
            raise ValueError(
                f"AnyOf.shares must be {len(options)} positive numbers, got {self.shares}"
            )
        object.__setattr__(self, "options", options)
        object.__setattr__(self, "shares", tuple((shares / shares.sum()).tolist()))

    def __repr__(self) -> str:
        """Return a short description: the first options, and how many more there are."""
        options = ", ".join(shown(option) for option in self.options[:_SHOWN])
        more = len(self.options) - _SHOWN
        return f"AnyOf({options}{f', and {more} more' if more > 0 else ''})"


@dataclass(frozen=True, eq=False)
class ViaPoint:
    """A point that a path passes at a phase.

    Attributes:
        phase: in [0, 1].
        position: (D,) in the unit of the path.
        tolerance: same unit, distance that may remain; 0 is exactly.
    """

    phase: float
    position: FloatArray
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        phase = checked_number("ViaPoint.phase", self.phase, least=0.0, most=1.0)
        object.__setattr__(self, "phase", phase)
        tolerance = checked_number("ViaPoint.tolerance", self.tolerance, least=0.0)
        object.__setattr__(self, "tolerance", tolerance)
        object.__setattr__(self, "position", _vector("ViaPoint.position", self.position))
