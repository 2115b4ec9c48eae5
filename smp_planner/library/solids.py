"""Capsules and cones as obstacles: a few cylinders and spheres, never less than the body."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import checked_number
from smp_gym.geometry.pose import Pose, checked_pose
from smp_gym.scene import Obstacle

__all__ = ["MOST_PARTS", "capsule_obstacles", "cone_obstacles", "part"]

MOST_PARTS = 4096
"""Obstacles that stand for one body at most."""


def capsule_obstacles(
    radius: float,
    length: float,
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
) -> list[Obstacle]:
    """Return a cylinder and two spheres that together are a capsule, exactly.

    Distances outside are those of the capsule; depths inside are at least half of its own.

    Args:
        radius: m, positive.
        length: m, of the axis between the centres of its round ends; 0 makes a sphere.
        position: (3,) m, of its centre.
        quaternion: (4,) x, y, z, w of norm 1, how it is turned; its own axis is z.

    Raises:
        ValueError: an argument is out of range.

    Example:
        >>> from smp_planner import capsule_obstacles
        >>> parts = capsule_obstacles(0.04, 0.3, position=(0.5, 0.0, 0.2))
    """
    radius = checked_number("radius", radius, above=0.0)
    length = checked_number("length", length, least=0.0)
    pose, half = checked_pose(position, quaternion), length / 2
    ball = (radius, radius, radius)
    if length == 0.0:
        return [part("sphere", pose, ball)]
    return [
        part("cylinder", pose, (radius, radius, half)),
        part("sphere", pose, ball, height=-half),
        part("sphere", pose, ball, height=half),
    ]


def cone_obstacles(
    radius: float,
    height: float,
    *,
    overshoot: float,
    position: ArrayLike = (0.0, 0.0, 0.0),
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
) -> list[Obstacle]:
    """Return cylinders that together hold a cone and stand out of it by at most `overshoot`.

    They share the base and reach up to the steps of a stair around the cone, so that they are
    deep: depths inside are at least 0.7 times those of the cone.

    Args:
        radius: m, of the base, positive.
        height: m, positive.
        overshoot: m, largest distance of a point of the cylinders from the cone, positive.
        position: (3,) m, of the middle between base and apex.
        quaternion: (4,) x, y, z, w of norm 1, how it is turned; its own axis is z, its apex above.

    Raises:
        ValueError: an argument is out of range, or more than 4096 cylinders are needed.

    Example:
        >>> from smp_planner import cone_obstacles
        >>> parts = cone_obstacles(0.1, 0.3, overshoot=0.005, position=(0.5, 0.0, 0.15))
    """
    radius = checked_number("radius", radius, above=0.0)
    height = checked_number("height", height, above=0.0)
    overshoot = checked_number("overshoot", overshoot, above=0.0)
    pose = checked_pose(position, quaternion)
    # The edge of a step is off the flank by its height times the sine of the half opening angle.
    needed = height * (radius / math.hypot(radius, height)) / overshoot
    if not needed <= MOST_PARTS:
        raise ValueError(
            f"overshoot must be large enough for {MOST_PARTS} cylinders to hold the cone, got "
            f"{overshoot}, which needs {needed:.4g} for radius {radius} and height {height}"
        )
    count = max(math.ceil(needed), 1)
    parts = []
    for step in range(count):
        wide, top = radius * (1.0 - step / count), height * (step + 1) / count
        size = (wide, wide, top / 2)
        parts.append(part("cylinder", pose, size, height=(top - height) / 2))
    return parts


def part(
    shape: str, pose: Pose, size: tuple[float, float, float], *, height: float = 0.0
) -> Obstacle:
    """Return an obstacle of half-extents `size`, m, `height` m up the z axis of a pose."""
    x, y, z = pose.of(np.array([0.0, 0.0, height])).tolist()
    return Obstacle(shape=shape, position=(x, y, z), quaternion=pose.quaternion, size=size)
