"""Boxes: size is (hx, hy, hz)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.shape import Shape

__all__ = ["Box"]


@kernel
def _distance(a, b, c, size):  # type: ignore[no-untyped-def]
    u, v, w = abs(a) - size[0], abs(b) - size[1], abs(c) - size[2]
    outside = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
    return outside + min(max(u, v, w), 0.0)


@kernel
def _gradient(a, b, c, size):  # type: ignore[no-untyped-def]
    u, v, w = abs(a) - size[0], abs(b) - size[1], abs(c) - size[2]
    gu, gv, gw = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    norm = math.sqrt(gu * gu + gv * gv + gw * gw)
    if norm > 0.0:
        gu, gv, gw = gu / norm, gv / norm, gw / norm
    elif u >= v and u >= w:
        gu = 1.0
    elif v >= w:
        gv = 1.0
    else:
        gw = 1.0
    return math.copysign(gu, a), math.copysign(gv, b), math.copysign(gw, c)


@kernel
def _bound(size):  # type: ignore[no-untyped-def]
    return math.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)


class Box(Shape):
    """A box; `of_dimensions` takes its three sides."""

    name = "box"
    measures = "(hx, hy, hz)"
    dimensions = 3
    round = False
    distance = staticmethod(_distance)
    gradient = staticmethod(_gradient)
    bound = staticmethod(_bound)

    def fitted(self, size: FloatArray) -> FloatArray:
        """Return half-extents as they are: any are a box's."""
        return size

    def of_dimensions(self, dimensions: Sequence[float]) -> FloatArray:
        """Return half-extents (3,) from three sides."""
        return np.asarray(dimensions, np.float64) / 2

    def upright(self, rotation: FloatArray, size: FloatArray) -> tuple[float, float]:
        """Return radius and half height of an upright cylinder around a turned box."""
        corners = np.array([(1.0, y, z) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * size
        turned = corners @ rotation.T
        radius = np.linalg.norm(turned[:, :2], axis=1).max()
        return float(radius), float(np.abs(turned[:, 2]).max())

    def faces(self, size: FloatArray) -> list[FloatArray]:
        """Return the six sides (4, 3) m."""
        square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
        return [
            np.insert(square, axis, side, axis=1) * size
            for axis in range(3)
            for side in (-1.0, 1.0)
        ]
