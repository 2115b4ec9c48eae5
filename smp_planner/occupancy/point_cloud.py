"""Maps of a point cloud, as of a depth camera: computed at once, or learned by `train_map`.

A camera sees the front of objects. What lies behind a seen surface, within a thickness, is taken
for occupied, and all else that was not seen for free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.distance import check_points
from smp_planner.occupancy.grid import (
    SPACING,
    WORKSPACE,
    DistanceGrid,
    GridMap,
    grid_nodes,
)
from smp_planner.occupancy.neural import INFLATION, SAMPLING_BAND, UNIFORM_SHARE
from smp_planner.occupancy.occupancy_map import TRUNCATION, window
from smp_planner.occupancy.redistancing import redistance

__all__ = ["CloudMap", "closed_surface", "label_point_cloud", "layers_behind"]

_LAYER_SPACING = 0.01
"""Metres between the layers of points that stand for what is behind a surface."""


@dataclass(frozen=True, eq=False)
class CloudMap:
    """The map of a point cloud, in normalised coordinates (m for a robot).

    Attributes:
        map: the distance; None if no point of the cloud is where the body can be.
        bounds: corners of the box that paths must stay in, because points of the cloud outside of
            it were not mapped; None if there are none.
        seen: (N, 3) points of the cloud, for pictures; None where they are not kept.
    """

    map: GridMap | None
    bounds: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    seen: FloatArray | None = None

    @property
    def grid(self) -> DistanceGrid | None:
        """The map as a grid."""
        return None if self.map is None else self.map.grid

    def covers(self, trajectories: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
        """Return (P,) whether balls whose centres follow paths (P, T, 3) stay where it was mapped.

        Args:
            trajectories: (P, T, 3).
            radius: of the balls.
        """
        if self.bounds is None:
            return np.ones(len(trajectories), np.bool_)
        lower, upper = (np.asarray(corner) for corner in self.bounds)
        inside = (trajectories - radius >= lower) & (trajectories + radius <= upper)
        return np.asarray(inside.all(axis=(1, 2)))


def layers_behind(surface: FloatArray, sensor: FloatArray, thickness: float) -> FloatArray:
    """Return points (N L, 3) of seen surfaces and of what is behind them, within a thickness.

    Args:
        surface: (N, 3) m, what was seen.
        sensor: (3,) m, where the camera stood, or (N, 3) for each point its own.
        thickness: m, depth of objects behind their surface.

    Raises:
        ValueError: a point coincides with its sensor.
    """
    rays = surface - sensor
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        raise ValueError(
            "sensor must not be a point of the cloud, got "
            f"{np.broadcast_to(sensor, surface.shape)[lengths[:, 0] == 0][0]}"
        )
    depths = np.linspace(0.0, thickness, 1 + math.ceil(thickness / _LAYER_SPACING))
    return np.asarray((surface + depths[:, None, None] * (rays / lengths)).reshape(-1, 3))


@kernel
def _nearest_point(values, origin, spacing, points, reach):  # type: ignore[no-untyped-def]
    """Lower grid nodes to their distance to the nearest of points (N, 3), as far as it reaches."""
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i0, i1 = window(values.shape[0], origin[0], spacing, x, reach)
        j0, j1 = window(values.shape[1], origin[1], spacing, y, reach)
        k0, k1 = window(values.shape[2], origin[2], spacing, z, reach)
        for i in range(i0, i1):
            dx = origin[0] + spacing * i - x
            for j in range(j0, j1):
                dy = origin[1] + spacing * j - y
                for k in range(k0, k1):
                    dz = origin[2] + spacing * k - z
                    square = dx * dx + dy * dy + dz * dz
                    if square < values[i, j, k] ** 2:
                        values[i, j, k] = math.sqrt(square)


def closed_surface(
    solid: FloatArray, inflation: float, spacing: float = SPACING, truncation: float = TRUNCATION
) -> GridMap:
    """Return the signed distance to a body of which points inside and on its surface are known.

    All within `inflation` of a point is taken together, and its surface moved back by as much (the
    morphological closing): so gaps between points, and others that are as narrow, are filled.

    Args:
        solid: (N, 3) m, N at least 1; neighbours up to 1.5 `inflation` apart.
        inflation: m.
        spacing: m, of the map's grid.
        truncation: m, largest absolute value of the distance.
    """
    around = truncation + inflation
    lower, upper = solid.min(axis=0) - around, solid.max(axis=0) + around
    origin, nodes = grid_nodes((tuple(lower.tolist()), tuple(upper.tolist())), spacing)
    nearest = np.full(nodes, inflation + 2.0 * spacing)
    _nearest_point(nearest, origin, spacing, solid, inflation + 2.0 * spacing)
    level = redistance(inflation - nearest, spacing, around)
    values = np.clip(level + np.float32(inflation), -truncation, truncation)
    return GridMap(DistanceGrid(origin, spacing, values), truncation)


def label_point_cloud(
    cloud: ArrayLike,
    sensor: ArrayLike,
    count: int,
    rng: np.random.Generator,
    *,
    thickness: float = 0.05,
    inflation: float = INFLATION,
    workspace: tuple[Sequence[float], Sequence[float]] = WORKSPACE,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Draw points of a scene of which a point cloud is known, labelled occupied or free.

    A quarter is uniform over the workspace, the rest lies around what was seen. Occupied is all
    within `inflation` of a point of the cloud or of what is behind it; so the cloud must be denser
    than `inflation`, and the map takes the growth off again.

    Args:
        cloud: (N, 3) m, points on surfaces, in the base frame.
        sensor: (3,) m, where the camera stood, or (N, 3) for each point its own.
        count: how many points to draw.
        rng: source of randomness.
        thickness: m, depth of objects behind their surface.
        inflation: m, as above; the same is to be given to `train_map`.
        workspace: lower and upper corner of the box that the points are in, m; points of the cloud
            outside are left out.

    Returns:
        points (count, 3) m and labels (count,), True for occupied.

    Raises:
        ValueError: shapes are wrong, a number is not finite or out of range, no point of the cloud
            is in the workspace, or a point coincides with its sensor.
    """
    surface = check_points(cloud)
    origin = check_points(sensor)
    if surface.ndim != 2:
        raise ValueError(f"cloud must have shape (N, 3), got {surface.shape}")
    if origin.shape not in ((3,), surface.shape):
        raise ValueError(f"sensor must have shape (3,) or {surface.shape}, got {origin.shape}")
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if not (math.isfinite(thickness) and thickness >= 0.0):
        raise ValueError(f"thickness must not be negative, got {thickness}")
    if not (math.isfinite(inflation) and inflation > 0.0):
        raise ValueError(f"inflation must be positive, got {inflation}")
    lower, upper = (np.asarray(corner, np.float64) for corner in workspace)
    inside = ((surface >= lower) & (surface <= upper)).all(axis=1)
    if not inside.any():
        raise ValueError(f"cloud must hold a point in the workspace {lower} to {upper}, got none")
    origin = np.broadcast_to(origin, surface.shape)[inside]
    surface = surface[inside]
    solid = layers_behind(surface, origin, thickness)
    tree = cKDTree(solid)

    points = rng.uniform(lower, upper, (int(UNIFORM_SHARE * count), 3))
    reach = inflation + SAMPLING_BAND
    while len(points) < count:
        drawn = solid[rng.integers(len(solid), size=count)] + rng.uniform(-reach, reach, (count, 3))
        near = np.abs(tree.query(drawn)[0] - inflation) < SAMPLING_BAND
        points = np.concatenate(
            [points, drawn[near & ((drawn >= lower) & (drawn <= upper)).all(axis=1)]]
        )
    points = points[:count]
    return points, np.asarray(tree.query(points)[0] <= inflation)
