"""Rods that obstacles in the air hang from, in pictures only: nothing can touch them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle

__all__ = ["hangers"]

_RADIUS = 0.004
_TOP = 1.3
_TOUCHING = 0.012
"""m: radius and upper end of a rod, and how near to the table or to another obstacle an obstacle is
taken to rest on it."""


def _extent(obstacle: Obstacle) -> tuple[FloatArray, FloatArray]:
    """Return the corners, (3,) m each, of an upright obstacle's bounding box along the axes."""
    x, y, z, w = obstacle.quaternion
    cosine, sine = abs(1.0 - 2.0 * (y * y + z * z)), abs(2.0 * (x * y + z * w))
    first, second, half_height = obstacle.size
    half = np.array([first * cosine + second * sine, first * sine + second * cosine, half_height])
    return np.asarray(obstacle.position) - half, np.asarray(obstacle.position) + half


def _held_by_others(obstacle: Obstacle, others: Sequence[Obstacle]) -> bool:
    low, high = _extent(obstacle)
    if low[2] < _TOUCHING:
        return True
    boxes = [_extent(other) for other in others if other is not obstacle]
    return any(
        (low <= above + _TOUCHING).all() and (high >= below - _TOUCHING).all()
        for below, above in boxes
    )


def hangers(obstacles: Sequence[Obstacle]) -> list[list[Obstacle]]:
    """Return the rod that each obstacle hangs from, in the obstacle's frame; none for most.

    Obstacles that lean, that rest on the table or that touch another one have none.
    """
    rods: list[list[Obstacle]] = []
    for obstacle in obstacles:
        x, y, _, _ = obstacle.quaternion
        upright = obstacle.shape == "sphere" or abs(x) + abs(y) < 1e-9
        top = obstacle.position[2] + obstacle.size[2]
        if not upright or top >= _TOP or _held_by_others(obstacle, obstacles):
            rods.append([])
            continue
        half = (_TOP - top) / 2.0
        centre = (0.0, 0.0, obstacle.size[2] + half)
        size = (_RADIUS, _RADIUS, half)
        rods.append([Obstacle(shape="cylinder", position=centre, size=size)])
    return rods
