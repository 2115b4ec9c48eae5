"""The description of an obstacle shape: what physics, maps, samplers and pictures ask of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from smp_gym.arrays import FloatArray

__all__ = ["Shape", "SolidArguments", "revolved"]
Kernel = Callable[..., Any]

_SECTORS = 40


class SolidArguments(NamedTuple):
    """A body as PyBullet takes it.

    Attributes:
        geometry: name of the constant, after ``GEOM_``.
        radius: m.
        half_extents: (3,) m.
        length: m, along z.
    """

    geometry: str
    radius: float
    half_extents: tuple[float, float, float]
    length: float


class Shape(ABC):
    """A family of bodies, told apart by their half-extents (3,) m along their own axes.

    The kernels are compiled with `smp_gym.compiling.kernel` and take a point (a, b, c), m, in the
    body's frame, and `size`, the half-extents.

    Attributes:
        name: as in `Obstacle.shape`.
        measures: meaning of the three half-extents, for messages.
        dimensions: how many numbers `of_dimensions` takes.
        round: whether any turn about its own z axis leaves a body as it is.
        distance: kernel ``(a, b, c, size)``, signed distance to the surface, m, negative inside.
        gradient: kernel ``(a, b, c, size)``, gradient of the distance, three floats; where the
            distance has none, one of the one-sided gradients.
        bound: kernel ``(size)``, radius of the bounding ball around the centre, m.
    """

    name: str
    measures: str
    dimensions: int
    round: bool
    distance: Kernel
    gradient: Kernel
    bound: Kernel

    @abstractmethod
    def fitted(self, size: FloatArray) -> FloatArray:
        """Return half-extents (..., 3) of this shape, from any (..., 3)."""

    @abstractmethod
    def of_dimensions(self, dimensions: Sequence[float]) -> FloatArray:
        """Return half-extents (3,) from full dimensions, as of ``shape_msgs/SolidPrimitive``."""

    @abstractmethod
    def upright(self, rotation: FloatArray, size: FloatArray) -> tuple[float, float]:
        """Return radius and half height, m, of an upright cylinder around a turned body.

        Args:
            rotation: (3, 3), from the body's frame to the base frame.
            size: (3,) m.
        """

    @abstractmethod
    def faces(self, size: FloatArray) -> list[FloatArray]:
        """Return the polygons (V, 3) m of a body's surface, each with four corners, for drawing."""

    def half_extents(self, rotation: FloatArray, size: FloatArray) -> FloatArray:
        """Return half-extents (3,) m along the base frame's axes of a box around a turned body."""
        return np.asarray(np.abs(rotation) @ size)

    def radius(self, size: FloatArray) -> float:
        """Return how far a body reaches from its own z axis, m."""
        return float(size[0]) if self.round else float(np.hypot(size[0], size[1]))

    def solid(self, size: Sequence[float]) -> SolidArguments:
        """Return the body as the physics takes it."""
        x, y, z = size
        return SolidArguments(self.name.upper(), x, (x, y, z), 2.0 * z)


def revolved(heights: FloatArray, radii: FloatArray) -> list[FloatArray]:
    """Return the quadrilaterals of a body of revolution about z, from its profile (N,), (N,)."""
    angles = np.linspace(0.0, 2 * np.pi, _SECTORS + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = [
        np.column_stack([radius * circle, np.full(len(circle), height)])
        for height, radius in zip(heights, radii, strict=True)
    ]
    return [
        np.array([low[i], low[i + 1], high[i + 1], high[i]])
        for low, high in pairwise(rings)
        for i in range(_SECTORS)
    ]
