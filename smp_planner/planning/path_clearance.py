"""Least distance of paths of points to obstacles, between their samples, too."""

from __future__ import annotations

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.scene import Obstacle
from smp_planner.occupancy.grid import DistanceGrid

__all__ = ["PATH_TOLERANCE", "in_space", "path_clearance"]

PATH_TOLERANCE = 1e-4
"""Extents by which the clearance of a ball's path may be overestimated."""

_MOST_HALVINGS = 40


def in_space(trajectories: FloatArray) -> FloatArray:
    """Return paths (P, T, 3) of (P, T, 2 or 3); those in the plane lie at z = 0."""
    missing = 3 - trajectories.shape[-1]
    return np.ascontiguousarray(np.pad(trajectories, ((0, 0), (0, 0), (0, missing))))


def path_clearance(
    trajectories: FloatArray,
    obstacles: tuple[Obstacle, ...],
    tolerance: float = PATH_TOLERANCE,
    grid: DistanceGrid | None = None,
) -> FloatArray:
    """Return the least distance (P,) to obstacles of paths (P, T, 3), straight between samples.

    The distance changes along a segment by no more than its length (times the grid's steepness), so
    over a segment of length L with distances a and b at its ends it is at least (a + b - L) / 2;
    where that does not settle the matter, the segment is halved.

    Args:
        trajectories: (P, T, 3), T at least 2.
        obstacles: bodies in the same coordinates.
        tolerance: by which the result may be too large.
        grid: distance to what else there is; without it and bodies, the result is infinite.
    """
    packed = PackedObstacles.of(obstacles)
    steepness = 1.0 if grid is None else max(grid.steepness, 1.0)

    def nearest(points: FloatArray) -> FloatArray:
        found = signed_distance(points, packed)
        return found if grid is None else np.minimum(found, grid.query(points))

    distance = nearest(trajectories)
    least = distance.min(axis=1)
    if not obstacles and grid is None:
        return np.asarray(least)
    path = np.repeat(np.arange(len(trajectories)), trajectories.shape[1] - 1)
    begin, end = (trajectories[:, s].reshape(-1, 3) for s in (slice(-1), slice(1, None)))
    first, last = distance[:, :-1].ravel(), distance[:, 1:].ravel()
    for _ in range(_MOST_HALVINGS):
        bound = (first + last - steepness * np.linalg.norm(end - begin, axis=1)) / 2
        open_ = bound < least[path] - tolerance
        if not open_.any():
            break
        path, begin, end = path[open_], begin[open_], end[open_]
        middle = (begin + end) / 2
        between = nearest(middle)
        np.minimum.at(least, path, between)
        first = np.concatenate([first[open_], between])
        last = np.concatenate([between, last[open_]])
        path = np.concatenate([path, path])
        begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
    return np.asarray(least)
