"""Obstacles of paths: circles and rectangles in the plane, bodies and point clouds in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_gym.scene import Obstacle
from smp_planner.library.cloud import PointCloud
from smp_planner.library.frame import Frame

__all__ = ["Circle", "PathObstacle", "Rectangle", "bodies", "outline"]

_COLUMN_HALF_HEIGHT = 1.0
"""Half height, in extents, of the columns that plane obstacles are; paths run at half height."""


def _pair(name: str, value: ArrayLike) -> tuple[float, float]:
    x, y = checked_array(name, value, (2,)).tolist()
    return x, y


@dataclass(frozen=True)
class Circle:
    """A disc that a path in the plane must not touch.

    Attributes:
        center: (2,) in the unit of the path.
        radius: same unit, positive.
    """

    center: tuple[float, float]
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", _pair("Circle.center", self.center))
        radius = checked_number("Circle.radius", self.radius, above=0.0)
        object.__setattr__(self, "radius", radius)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle that a path in the plane must not touch.

    Attributes:
        center: (2,) in the unit of the path.
        half_extents: (2,) along its own sides, same unit, positive.
        angle: rad, by which it is turned counter-clockwise.
    """

    center: tuple[float, float]
    half_extents: tuple[float, float]
    angle: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", _pair("Rectangle.center", self.center))
        half = _pair("Rectangle.half_extents", self.half_extents)
        if min(half) <= 0.0:
            raise ValueError(f"Rectangle.half_extents must be positive, got {half}")
        object.__setattr__(self, "half_extents", half)
        object.__setattr__(self, "angle", checked_number("Rectangle.angle", self.angle))


PathObstacle = Circle | Rectangle | Obstacle | PointCloud
"""An obstacle: `Circle` and `Rectangle` in the plane, `Obstacle` and one `PointCloud` in space."""


def bodies(obstacles: Sequence[PathObstacle], frame: Frame) -> tuple[Obstacle, ...]:
    """Return obstacles as bodies in normalised coordinates; of a `PointCloud` there is none.

    A path in the plane runs at z = 0 among upright columns, so that distances are those of the
    plane.

    Args:
        obstacles: in the unit of the path.
        frame: of the path.

    Raises:
        ValueError: an obstacle of another dimension than the path, or a path of neither two nor
            three dimensions.
    """
    dimension = frame.dimension
    if obstacles and dimension not in (2, 3):
        raise ValueError(
            f"obstacles need a path in the plane or in space, or a robot; got D = {dimension}"
        )
    allowed: Any = (Circle, Rectangle) if dimension == 2 else Obstacle
    placed = []
    for index, obstacle in enumerate(obstacles):
        if isinstance(obstacle, PointCloud) and dimension == 3:
            continue
        if not isinstance(obstacle, allowed):
            names = (
                "Circle or Rectangle"
                if dimension == 2
                else "smp_gym.scene.Obstacle or a PointCloud"
            )
            raise ValueError(
                f"obstacles[{index}] of a path with D = {dimension} must be {names}, "
                f"got {obstacle!r}"
            )
        placed.append(_body(obstacle, frame))
    return tuple(placed)


def _body(obstacle: Circle | Rectangle | Obstacle, frame: Frame) -> Obstacle:
    if isinstance(obstacle, Obstacle):
        return Obstacle(
            shape=obstacle.shape,
            position=_triple(frame.inwards(obstacle.position)),
            quaternion=obstacle.quaternion,
            size=_triple(frame.lengths_inwards(obstacle.size)),
        )
    position = _triple([*frame.inwards(obstacle.center), 0.0])
    if isinstance(obstacle, Circle):
        radius = float(frame.lengths_inwards(obstacle.radius))
        return Obstacle(
            shape="cylinder",
            position=position,
            size=(radius, radius, max(radius, _COLUMN_HALF_HEIGHT)),
        )
    x, y = frame.lengths_inwards(obstacle.half_extents).tolist()
    half = obstacle.angle / 2
    return Obstacle(
        shape="box",
        position=position,
        quaternion=(0.0, 0.0, math.sin(half), math.cos(half)),
        size=(x, y, max(x, y, _COLUMN_HALF_HEIGHT)),
    )


def _triple(values: ArrayLike) -> tuple[float, float, float]:
    x, y, z = np.asarray(values, np.float64).tolist()
    return x, y, z


def outline(obstacle: Circle | Rectangle, count: int = 90) -> FloatArray:
    """Return the corners (4, 2) of a rectangle, or `count` points of a circle, in order."""
    if isinstance(obstacle, Circle):
        angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.asarray(obstacle.center + obstacle.radius * ring)
    cosine, sine = math.cos(obstacle.angle), math.sin(obstacle.angle)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * obstacle.half_extents
    return np.asarray(obstacle.center + corners @ np.array([[cosine, sine], [-sine, cosine]]))
