"""A point or ball that moves in the plane or in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from smp_gym.geometry.distance import PackedObstacles, signed_distance, signed_distance_and_gradient
from smp_gym.scene import Obstacle
from smp_planner.library.cloud import LearnedCloud
from smp_planner.library.mover import Check, ValueAndGradient, steps_scale
from smp_planner.occupancy.grid import DistanceGrid

__all__ = [
    "TOLERANCE",
    "Ball",
    "DistanceMap",
    "exact_map",
    "in_space",
    "nearest_of",
    "path_clearance",
]

FloatArray = NDArray[np.float64]
DistanceMap = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From points (N, 3) to signed distance (N,) and its gradient (N, 3)."""

TOLERANCE = 1e-4
"""Extents by which the clearance of a path may be overestimated."""

_HALVINGS = 40


def exact_map(obstacles: tuple[Obstacle, ...]) -> DistanceMap:
    """Return the exact distance to obstacles."""
    packed = PackedObstacles.of(obstacles)

    def query(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        return signed_distance_and_gradient(points, packed)

    return query


def nearest_of(first: DistanceMap, second: DistanceMap) -> DistanceMap:
    """Return the distance to what either of two maps knows."""

    def query(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        (distance, away), (other, other_away) = first(points), second(points)
        return np.minimum(distance, other), np.where((distance <= other)[:, None], away, other_away)

    return query


def path_clearance(
    trajectories: FloatArray,
    obstacles: tuple[Obstacle, ...],
    tolerance: float = TOLERANCE,
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
    for _ in range(_HALVINGS):
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


@dataclass(frozen=True)
class Ball:
    """A ball whose centre follows the path; with radius 0, a point.

    Attributes:
        obstacles: in normalised coordinates.
        radius: likewise.
        distance: the map that the costs ask; None where there is no obstacle.
        cloud: what is known of a `PointCloud`, normalised; None if there is none.
    """

    obstacles: tuple[Obstacle, ...]
    radius: float
    distance: DistanceMap | None
    cloud: LearnedCloud | None = None

    def collision(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return the squared occupancy of the ball, summed along the path; see `Mover`."""
        if self.distance is None:
            return np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        distance, away = self.distance(in_space(trajectories).reshape(-1, 3))
        occupancy = expit((self.radius + margin - distance) / edge_width)
        occupancy = occupancy.reshape(trajectories.shape[:2])
        away = away.reshape(*trajectories.shape[:2], 3)[..., : trajectories.shape[2]]
        scale = steps_scale(trajectories.shape[1])
        slope = -2.0 * scale / edge_width * np.square(occupancy) * (1.0 - occupancy)
        return scale * np.square(occupancy).sum(axis=1), slope[..., None] * away

    def limits(self, trajectories: FloatArray) -> dict[str, tuple[float, ValueAndGradient]]:
        """Return nothing: a ball may go anywhere."""
        return {}

    def check(self, trajectories: FloatArray) -> Check:
        """Check whole paths; see `Mover`."""
        count = len(trajectories)
        clearance = np.full(count, np.inf)
        grid = None if self.cloud is None else self.cloud.grid
        if self.obstacles or grid is not None:
            paths = in_space(trajectories)
            clearance = path_clearance(paths, self.obstacles, grid=grid) - self.radius
        free = clearance >= TOLERANCE
        if self.cloud is not None:
            free &= self.cloud.covers(trajectories, self.radius)
        return Check(clearance, free, np.ones(count, np.bool_), np.full(count, np.nan))


def in_space(trajectories: FloatArray) -> FloatArray:
    """Return paths (P, T, 3) of (P, T, 2 or 3); those in the plane lie at z = 0."""
    missing = 3 - trajectories.shape[-1]
    return np.ascontiguousarray(np.pad(trajectories, ((0, 0), (0, 0), (0, missing))))
