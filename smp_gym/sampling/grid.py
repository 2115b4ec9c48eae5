"""The grid on which obstacles are compared: which paths come near which points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.sampling import kernels

__all__ = ["GRID_SLACK", "near", "rasterise"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


_ORIGIN = np.array([-0.2, -0.9, 0.0])
_SPACING = 0.04
_SHAPE = (31, 46, 29)
"""Grid of points (m) on which candidates are compared; it holds all that the arm can reach in front
of it. What is chosen is checked without the grid."""

GRID_SLACK = 0.02
"""Metres added to the clearance on the grid, for what lies between its points and the samples."""


def rasterise(paths: FloatArray, radius: FloatArray) -> NDArray[np.uint64]:
    """Return the grid of (N, T, S, 3) m paths of spheres with radii (S,) m."""
    return kernels.rasterised(paths, radius, _ORIGIN, _SPACING, _SHAPE)


def near(grid: NDArray[np.uint64], rows: FloatArray, distance: float, members: int) -> BoolArray:
    """Return (C, members), which paths of a grid come within a distance (m) of which obstacles."""
    return kernels.touched(grid, _ORIGIN, _SPACING, rows, distance, members)
