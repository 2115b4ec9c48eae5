"""Cylinders, their axis along z: size is (radius, radius, half height)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.shape import Shape, revolved

__all__ = ["Cylinder"]


@kernel
def _distance(a, b, c, size):  # type: ignore[no-untyped-def]
    u, v = math.sqrt(a * a + b * b) - size[0], abs(c) - size[2]
    return math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2) + min(max(u, v), 0.0)


@kernel
def _gradient(a, b, c, size):  # type: ignore[no-untyped-def]
    rho = math.sqrt(a * a + b * b)
    u, v = rho - size[0], abs(c) - size[2]
    gu, gv = max(u, 0.0), max(v, 0.0)
    norm = math.sqrt(gu * gu + gv * gv)
    if norm > 0.0:
        gu, gv = gu / norm, gv / norm
    elif u >= v:
        gu = 1.0
    else:
        gv = 1.0
    ex, ey = (a / rho, b / rho) if rho > 0.0 else (1.0, 0.0)
    return gu * ex, gu * ey, math.copysign(gv, c)


@kernel
def _bound(size):  # type: ignore[no-untyped-def]
    return math.sqrt(size[0] ** 2 + size[2] ** 2)


class Cylinder(Shape):
    """A cylinder; `of_dimensions` takes its height and its radius."""

    name = "cylinder"
    measures = "(radius, radius, half height)"
    dimensions = 2
    round = True
    distance = staticmethod(_distance)
    gradient = staticmethod(_gradient)
    bound = staticmethod(_bound)

    def fitted(self, size: FloatArray) -> FloatArray:
        """Return half-extents (..., 3), the second made the first."""
        return np.asarray(size)[..., [0, 0, 2]]

    def of_dimensions(self, dimensions: Sequence[float]) -> FloatArray:
        """Return half-extents (3,) from height and radius."""
        height, radius = dimensions
        return np.array([radius, radius, height / 2])

    def upright(self, rotation: FloatArray, size: FloatArray) -> tuple[float, float]:
        """Return radius and half height of an upright cylinder around a leaning one."""
        lean = float(np.hypot(*rotation[:2, 2]))
        upright = float(abs(rotation[2, 2]))
        return size[0] + lean * size[2], upright * size[2] + lean * size[0]

    def faces(self, size: FloatArray) -> list[FloatArray]:
        """Return the quadrilaterals (4, 3) m of side and ends."""
        profile = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0, 0.0])
        return [face * size for face in revolved(*profile)]
