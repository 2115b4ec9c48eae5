"""Spheres on a path, as obstacles are held against them: measured once, asked often."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels

__all__ = ["SweptPath"]


@dataclass(frozen=True, eq=False)
class SweptPath:
    """Spheres that move along a path.

    Attributes:
        centers: (T, S, 3) m.
        radius: (S,) m.
        boxes: (T, G, 6) m, around groups of spheres.
    """

    centers: FloatArray
    radius: FloatArray
    boxes: FloatArray

    @classmethod
    def of(cls, centers: FloatArray, radius: FloatArray) -> SweptPath:
        """Return the path of spheres.

        Args:
            centers: (T, S, 3) m.
            radius: (S,) m.
        """
        centers = np.ascontiguousarray(centers)
        return cls(centers, radius, kernels.group_boxes(centers, radius))

    def clear(self, rows: FloatArray, clearance: float) -> BoolArray:
        """Return a mask (M,) of obstacles that keep a clearance (m) from the path."""
        found: BoolArray = kernels.clear_of_path(
            self.centers, self.radius, self.boxes, rows, clearance
        )
        return found

    def clearances(self, rows: FloatArray, enough: float) -> FloatArray:
        """Return the distances (M,) m of obstacles to the path, at most `enough`.

        They are negative where spheres and obstacle overlap.
        """
        found: FloatArray = kernels.path_clearances(
            self.centers, self.radius, self.boxes, rows, enough
        )
        return found
