"""The solids that stand for the body of a link, and minimal balls around parts of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from smp_gym.arrays import FloatArray

__all__ = ["AXES", "Box", "Cylinder", "Shape", "Vector", "clipped", "enclosing_ball"]
Vector = tuple[float, float, float]

AXES = "xyz"

_CORNERS = 64
"""Corners of the prism that stands for a cylinder where balls are fitted; it contains it."""

_DIGITS = 4
"""Balls are rounded to 0.1 mm, radii upwards."""


@dataclass(frozen=True)
class Box:
    """A box in the frame of its link.

    Attributes:
        lower: corner, m, in the turned frame.
        upper: the opposite corner.
        turn: angle by which the frame of the corners is turned about the link's z, rad.
    """

    lower: Vector
    upper: Vector
    turn: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) from the turned frame to the link's."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    @property
    def center(self) -> FloatArray:
        """(3,) m, in the frame of the link."""
        return self.rotation @ (np.array(self.lower) + self.upper) / 2

    def hull(self) -> FloatArray:
        """Return the (8, 3) corners."""
        sides = np.array([self.lower, self.upper])
        picks = np.indices((2, 2, 2)).reshape(3, -1)
        corners = np.stack([sides[picks[axis], axis] for axis in range(3)], axis=1)
        return corners @ self.rotation.T

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (N,) m of points (N, 3) to the surface, negative inside."""
        half = (np.array(self.upper) - self.lower) / 2
        return _signed_distance(np.abs((points - self.center) @ self.rotation) - half)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along an axis of the frame of its link, m.

    Attributes:
        axis: "x", "y" or "z".
        through: where its axis crosses the plane of the other two axes, in their order, m.
        radius: m.
        start: lower end along the axis, m.
        end: upper end.
    """

    axis: str
    through: tuple[float, float]
    radius: float
    start: float
    end: float

    @property
    def center(self) -> FloatArray:
        """(3,) m, in the frame of the link."""
        return np.insert(self.through, AXES.index(self.axis), (self.start + self.end) / 2)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (N,) m of points (N, 3) to the surface, negative inside."""
        offset = points - self.center
        along = AXES.index(self.axis)
        across = np.linalg.norm(np.delete(offset, along, axis=1), axis=1) - self.radius
        beyond = np.abs(offset[:, along]) - (self.end - self.start) / 2
        return _signed_distance(np.stack([across, beyond], axis=1))

    def hull(self) -> FloatArray:
        """Return (2 * 64, 3) corners of a prism around the cylinder."""
        angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
        radius = self.radius / np.cos(np.pi / _CORNERS)
        along = AXES.index(self.axis)
        across = [axis for axis in range(3) if axis != along]
        points = np.empty((2, _CORNERS, 3))
        points[..., across[0]] = self.through[0] + radius * np.cos(angle)
        points[..., across[1]] = self.through[1] + radius * np.sin(angle)
        points[..., along] = np.array([self.start, self.end])[:, None]
        return points.reshape(-1, 3)


def _signed_distance(excess: FloatArray) -> FloatArray:
    """Return distances (N,) from the excess of points beyond each pair of faces, (N, pairs)."""
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=1)
    return outside + np.minimum(excess.max(axis=1), 0.0)


Shape = Box | Cylinder


def clipped(points: FloatArray, cell: Box) -> FloatArray:
    """Return corners of the part of a convex body that lies in a cell, (N, 3); N may be 0."""
    for axis in range(3):
        for bound, sign in ((cell.lower[axis], 1.0), (cell.upper[axis], -1.0)):
            height = sign * (points[:, axis] - bound)
            above, below = points[height >= 0], points[height < 0]
            if not len(below):
                continue
            if not len(above):
                return np.empty((0, 3))
            rise = height[height >= 0][:, None, None]
            fall = -height[height < 0][None, :, None]
            crossings = (above[:, None] * fall + below[None] * rise) / (rise + fall)
            points = np.concatenate([above, crossings.reshape(-1, 3)])
            hull = ConvexHull(points, qhull_options="QJ Pp")
            points = points[np.sort(hull.vertices)]
    return points


def enclosing_ball(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of a ball around points, (N, 3), that is minimal to some 0.1 mm.

    Badoiu & Clarkson 2003: step towards the farthest point, ever more shortly. The result is
    rounded so that it still contains all points.
    """
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 3000):
        farthest = points[np.argmax(np.linalg.norm(points - center, axis=1))]
        center = center + (farthest - center) / (step + 1)
    center = np.round(center, _DIGITS) + 0.0
    radius = float(np.linalg.norm(points - center, axis=1).max())
    scale = 10.0**_DIGITS
    return center, float(np.ceil(radius * scale) / scale)
