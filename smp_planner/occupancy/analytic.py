"""The exact map: distance to the obstacles themselves, cut off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.distance import PackedObstacles, signed_distance, to_local
from smp_gym.geometry.registry import distance as body_distance
from smp_gym.scene import Obstacle
from smp_planner.occupancy.occupancy_map import TRUNCATION, window

__all__ = ["AnalyticMap"]


@kernel
def _fill(values, planes, origin, spacing, truncation, half_extents, bodies):  # type: ignore[no-untyped-def]
    shape, rotation, position, size = bodies
    for n in range(len(shape)):
        reach = half_extents[n] + truncation
        center = position[n]
        i0, i1 = window(values.shape[0], origin[0], spacing, center[0], reach[0])
        j0, j1 = window(values.shape[1], origin[1], spacing, center[1], reach[1])
        k0, k1 = window(values.shape[2], origin[2], spacing, center[2], reach[2])
        for i in range(max(i0, planes[0]), min(i1, planes[1])):
            x = origin[0] + spacing * i
            for j in range(j0, j1):
                y = origin[1] + spacing * j
                for k in range(k0, k1):
                    a, b, c = to_local(x, y, origin[2] + spacing * k, rotation[n], center)
                    d = max(body_distance(shape[n], a, b, c, size[n]), -truncation)
                    if d < values[i, j, k]:
                        values[i, j, k] = d


@dataclass(frozen=True)
class AnalyticMap:
    """The exact map, an `OccupancyMap`.

    Attributes:
        obstacles: bodies at the pose they have now; may be empty.
        truncation: m, largest absolute value of the distance.
    """

    obstacles: tuple[Obstacle, ...]
    truncation: float = TRUNCATION

    def __post_init__(self) -> None:
        if not (math.isfinite(self.truncation) and self.truncation > 0.0):
            raise ValueError(f"AnalyticMap.truncation must be positive, got {self.truncation}")

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        """Return the truncated signed distance; see `OccupancyMap.signed_distance`."""
        distance = signed_distance(points, self.obstacles)
        return np.clip(distance, -self.truncation, self.truncation)

    def fill(
        self,
        values: NDArray[np.float32],
        origin: FloatArray,
        spacing: float,
        planes: tuple[int, int] | None = None,
    ) -> None:
        """Lower the nodes of a grid to the exact distance; see `OccupancyMap.fill`."""
        packed = PackedObstacles.of(self.obstacles)
        bodies, extents = packed.arrays[:4], packed.half_extents
        _fill(values, planes or (0, len(values)), origin, spacing, self.truncation, extents, bodies)
