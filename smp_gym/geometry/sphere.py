"""Spheres: size is (radius, radius, radius)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.shape import Shape, revolved

__all__ = ["Sphere"]

_RINGS = 20


@kernel
def _distance(a, b, c, size):  # type: ignore[no-untyped-def]
    return math.sqrt(a * a + b * b + c * c) - size[0]


@kernel
def _gradient(a, b, c, size):  # type: ignore[no-untyped-def]
    norm = math.sqrt(a * a + b * b + c * c)
    if norm > 0.0:
        return a / norm, b / norm, c / norm
    return 1.0, 0.0, 0.0


@kernel
def _bound(size):  # type: ignore[no-untyped-def]
    return float(size[0])


class Sphere(Shape):
    """A sphere; `of_dimensions` takes its radius."""

    name = "sphere"
    measures = "(radius, radius, radius)"
    dimensions = 1
    round = True
    distance = staticmethod(_distance)
    gradient = staticmethod(_gradient)
    bound = staticmethod(_bound)

    def fitted(self, size: FloatArray) -> FloatArray:
        """Return half-extents (..., 3), all made the first."""
        return np.asarray(size)[..., [0, 0, 0]]

    def of_dimensions(self, dimensions: Sequence[float]) -> FloatArray:
        """Return half-extents (3,) from the radius."""
        return np.array([dimensions[0]] * 3)

    def half_extents(self, rotation: FloatArray, size: FloatArray) -> FloatArray:
        """Return half-extents (3,) of the box around a sphere, which no turn changes."""
        return np.asarray(size)

    def upright(self, rotation: FloatArray, size: FloatArray) -> tuple[float, float]:
        """Return radius and half height of an upright cylinder around a sphere."""
        return float(size[0]), float(size[0])

    def faces(self, size: FloatArray) -> list[FloatArray]:
        """Return the quadrilaterals (4, 3) m between meridians and parallels."""
        polar = np.linspace(-np.pi / 2, np.pi / 2, _RINGS + 1)
        return [face * size for face in revolved(np.sin(polar), np.cos(polar))]
