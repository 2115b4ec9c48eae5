"""A ball that follows a path in the plane or in space; with radius 0, a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.special import expit

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.geometry.distance import PackedObstacles, signed_distance, signed_distance_and_gradient
from smp_gym.scene import Obstacle
from smp_planner.collision.costs import Cost, ValueAndGradient, steps_scale
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.bodies import Clearance, ObstacleCost
from smp_planner.planning.maps import SceneMaps, Workspace
from smp_planner.planning.path_clearance import PATH_TOLERANCE, in_space, path_clearance
from smp_planner.planning.settings import PlanSettings

__all__ = ["Ball", "BallClearances", "DistanceMap", "exact_map"]

DistanceMap = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Map from points (N, 3) to signed distance (N,) and its gradient (N, 3)."""


def exact_map(obstacles: tuple[Obstacle, ...]) -> DistanceMap:
    """Return the exact distance to obstacles."""
    packed = PackedObstacles.of(obstacles)

    def query(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        return signed_distance_and_gradient(points, packed)

    return query


def _nearest_of(first: DistanceMap, second: DistanceMap) -> DistanceMap:
    """Return the minimum of two distance maps."""

    def query(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        (distance, away), (other, other_away) = first(points), second(points)
        return np.minimum(distance, other), np.where((distance <= other)[:, None], away, other_away)

    return query


@dataclass(frozen=True)
class BallClearances:
    """Clearance of a ball from what is on a map, extents: M = 1.

    Attributes:
        radius: of the ball.
        distance: the map.
    """

    radius: float
    distance: DistanceMap

    def __call__(self, configurations: FloatArray) -> FloatArray:
        """Return clearances (N, 1) of centres (N, 2 or 3), negative in collision."""
        return self.distance(in_space(configurations[None])[0])[0][:, None] - self.radius

    def pull_back(self, configurations: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the gradient (N, 2 or 3) of what has the derivatives (N, 1)."""
        away = self.distance(in_space(configurations[None])[0])[1]
        return np.asarray(slopes * away[:, : configurations.shape[1]])


@dataclass(frozen=True)
class _BallCost:
    """The squared occupancy of a ball, summed along the path."""

    clearances: BallClearances
    scale: float = 1.0

    def __call__(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return value (P,) and gradient (P, T, D) at trajectories (P, T, D)."""
        found, away = self.clearances.distance(in_space(trajectories).reshape(-1, 3))
        occupancy = expit((self.clearances.radius + margin - found) / edge_width)
        occupancy = occupancy.reshape(trajectories.shape[:2])
        away = away.reshape(*trajectories.shape[:2], 3)[..., : trajectories.shape[2]]
        scale = self.scale * steps_scale(trajectories.shape[1])
        slope = -2.0 * scale / edge_width * np.square(occupancy) * (1.0 - occupancy)
        return scale * np.square(occupancy).sum(axis=1), slope[..., None] * away


@dataclass(frozen=True)
class Ball:
    """A ball whose centre follows a path in the plane or in space; with radius 0, a point.

    Attributes:
        dimension: D, 2 or 3 (any, where there is no obstacle).
        radius: in the coordinates of the path.
        workspace: box (3-D) that a learned map covers; None where no map is learned.
    """

    dimension: int
    radius: float = 0.0
    workspace: Workspace | None = None

    def obstacle_cost(
        self,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None,
        maps: SceneMaps,
    ) -> ObstacleCost | None:
        """Return the squared occupancy of the ball on the map; see `Body`."""
        parts: list[DistanceMap] = []
        if cloud is not None and cloud.grid is not None:
            parts.append(cloud.grid.query_with_gradient)
        if obstacles and maps.exact:
            parts.append(exact_map(obstacles))
        elif obstacles and self.workspace is not None:
            grid = maps.grid(obstacles, self.workspace)
            if grid is not None:
                parts.append(grid.query_with_gradient)
        return self.cost_on(reduce(_nearest_of, parts)) if parts else None

    def cost_on(self, distance: DistanceMap) -> ObstacleCost:
        """Return the squared occupancy of the ball on a map, summed along the path."""
        return _BallCost(BallClearances(self.radius, distance))

    def limit_costs(self, settings: PlanSettings) -> dict[str, tuple[float, Cost]]:
        """Return nothing: a ball may go anywhere."""
        return {}

    def check(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> Clearance:
        """Check whole paths (P, T, D); see `Body`."""
        clearance = np.full(len(trajectories), np.inf)
        grid = None if cloud is None else cloud.grid
        if obstacles or grid is not None:
            paths = in_space(trajectories)
            clearance = path_clearance(paths, obstacles, grid=grid) - self.radius
        free = clearance >= PATH_TOLERANCE
        if cloud is not None:
            free &= cloud.covers(trajectories, self.radius)
        return Clearance(clearance, free)

    def free_waypoints(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> BoolArray:
        """Return (P, T) whether the ball touches nothing at the points of paths."""
        distance = signed_distance(in_space(trajectories), PackedObstacles.of(obstacles))
        if cloud is not None and cloud.grid is not None:
            distance = np.minimum(distance, cloud.grid.query(in_space(trajectories)))
        return distance - self.radius >= PATH_TOLERANCE

    def execution(self, trajectories: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
        """Return that all can be executed, in no particular time: nothing limits a ball."""
        return np.ones(len(trajectories), np.bool_), np.full(len(trajectories), np.nan)

    def paths(self, trajectories: FloatArray, point: FloatArray | None) -> FloatArray:
        """Return the trajectories themselves."""
        return trajectories
