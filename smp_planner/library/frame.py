"""The coordinates in which paths are adapted: shares of the demonstrations' extent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray

__all__ = ["Frame"]

_GRAINS = 2.0**30
"""Normalised numbers are multiples of one over this, a billionth of an extent. So data in another
unit come out the same to the last bit, and the same plan is made from them; otherwise rounding
would turn directions in which a primitive is equally free, and with them its draws."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Normalised coordinates (x - offset) / scale.

    Attributes:
        offset: (D,) in the unit of the path.
        scale: same unit, positive.
    """

    offset: FloatArray
    scale: float

    @property
    def dimension(self) -> int:
        """D, number of coordinates."""
        return len(self.offset)

    def inwards(self, points: ArrayLike) -> FloatArray:
        """Return points (..., D) in normalised coordinates."""
        return self.lengths_inwards(np.asarray(points, np.float64) - self.offset)

    def lengths_inwards(self, lengths: ArrayLike) -> FloatArray:
        """Return lengths (...) in extents."""
        return np.asarray(
            np.round(np.asarray(lengths, np.float64) / self.scale * _GRAINS) / _GRAINS
        )

    def outwards(self, points: ArrayLike) -> FloatArray:
        """Return normalised points (..., D) in the unit of the path."""
        return np.asarray(points, np.float64) * self.scale + self.offset

    def named(self, point: ArrayLike) -> str:
        """Return a normalised point (D,) in the unit of the path, for a message."""
        return "(" + ", ".join(f"{x:.6g}" for x in self.outwards(point)) + ")"
