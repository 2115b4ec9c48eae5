"""Accuracy of the default occupancy map, baked as planners use it, in occupied and free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.geometry.distance import signed_distance
from smp_gym.scene import Scene, fixtures
from smp_planner.occupancy.grid import DistanceGrid, bake
from smp_planner.occupancy.occupancy_map import occupancy
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks

__all__ = ["MapAccuracy", "measure", "measure_default_map"]

INSIDE = 0.01
"""Depth, m, from which on a point should be occupied."""

OUTSIDE = (0.02, 0.06)
"""Distances, m, between which a point should be free."""

ERROR_BAND = 0.03
"""Distance, m, from the surface within which the error is measured."""

_POINTS_PER_OBSTACLE = 4000


@dataclass(frozen=True)
class MapAccuracy:
    """Accuracy of a map over scenes, against the exact signed distance.

    Attributes:
        scenes: number of scenes.
        points: number of points.
        inside_occupied: share of the points at least 1 cm inside that are occupied.
        outside_occupied: share of the points 2–6 cm outside that are occupied.
        error_p95: 95th percentile of the error of distance within 3 cm of a surface, m.
    """

    scenes: int
    points: int
    inside_occupied: float
    outside_occupied: float
    error_p95: float

    @classmethod
    def of(cls, scenes: int, exact: FloatArray, learned: FloatArray) -> MapAccuracy:
        """Return the accuracy of a map's distances (N,) m against the exact ones of N >= 1 points.

        Args:
            scenes: in which the points lie.
            exact: signed distances.
            learned: those of the map.
        """
        occupied = occupancy(learned) > 0.5
        near = np.abs(exact) < ERROR_BAND
        return cls(
            scenes=scenes,
            points=len(exact),
            inside_occupied=float(occupied[exact <= -INSIDE].mean()),
            outside_occupied=float(occupied[(exact >= OUTSIDE[0]) & (exact <= OUTSIDE[1])].mean()),
            error_p95=float(np.percentile(np.abs(learned - exact)[near], 95)),
        )


def _points(scene: Scene, generator: np.random.Generator) -> FloatArray:
    """Return points in and around the obstacles, above the table, as many around each, (N, 3)."""
    clouds = []
    for obstacle in scene.obstacles:
        reach = float(np.linalg.norm(obstacle.size)) + OUTSIDE[1]
        clouds.append(
            obstacle.position + generator.uniform(-reach, reach, (_POINTS_PER_OBSTACLE, 3))
        )
    points = np.concatenate(clouds) if clouds else np.empty((0, 3))
    above: FloatArray = points[points[:, 2] > 0.0]
    return above


def measure(
    scenes: Sequence[Scene], grids: Sequence[DistanceGrid], generator: np.random.Generator
) -> MapAccuracy | None:
    """Return the accuracy of one grid per scene; None if no scene has an obstacle.

    Args:
        scenes: what the grids are maps of, with their fixtures.
        grids: the maps; a point is occupied where the occupancy is above one half.
        generator: draws the points around the obstacles.
    """
    exact_parts, learned_parts = [np.empty(0)], [np.empty(0)]
    for scene, grid in zip(scenes, grids, strict=True):
        points = _points(scene, generator)
        if len(points):
            exact_parts.append(signed_distance(points, (*scene.obstacles, *fixtures(scene))))
            learned_parts.append(grid.query(points))
    exact, learned = np.concatenate(exact_parts), np.concatenate(learned_parts)
    return MapAccuracy.of(len(scenes), exact, learned) if len(exact) else None


def measure_default_map(scenes: Sequence[Scene]) -> MapAccuracy | None:
    """Return the accuracy of the map that planners use by default."""
    networks = default_networks()
    grids = [bake(ShapeNetworkMap((*s.obstacles, *fixtures(s)), networks)) for s in scenes]
    return measure(scenes, grids, np.random.default_rng(0))
