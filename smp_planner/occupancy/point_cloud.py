"""Labelled points from a point cloud, as of a depth camera, for `train_map`.

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

from smp_gym.geometry.distance import check_points
from smp_planner.occupancy.grid import WORKSPACE, DistanceGrid
from smp_planner.occupancy.neural import INFLATION, SAMPLING_BAND, UNIFORM_SHARE, PointNetworkMap

__all__ = ["LearnedCloud", "label_point_cloud"]

_LAYER_SPACING = 0.01
"""Metres between the layers of points that stand for what is behind a surface."""


@dataclass(frozen=True, eq=False)
class LearnedCloud:
    """Maps of a scene learned from a point cloud, in normalised coordinates (m for a robot).

    Attributes:
        map: the learned distance; None if no point of the cloud is where the body can be.
        bounds: corners of the box that paths must stay in, because points of the cloud outside of
            it were not learned; None if there are none.
    """

    map: PointNetworkMap | None
    bounds: tuple[tuple[float, ...], tuple[float, ...]] | None

    @property
    def grid(self) -> DistanceGrid | None:
        """The map as a grid."""
        return None if self.map is None else self.map.grid

    def covers(self, trajectories: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
        """Return (P,) whether balls whose centres follow paths (P, T, 3) stay where it was learned.

        Args:
            trajectories: (P, T, 3).
            radius: of the balls.
        """
        if self.bounds is None:
            return np.ones(len(trajectories), np.bool_)
        lower, upper = (np.asarray(corner) for corner in self.bounds)
        inside = (trajectories - radius >= lower) & (trajectories + radius <= upper)
        return np.asarray(inside.all(axis=(1, 2)))


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
    rays = surface - origin
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        raise ValueError(
            f"sensor must not be a point of the cloud, got {origin[lengths[:, 0] == 0][0]}"
        )
    depths = np.linspace(0.0, thickness, 1 + math.ceil(thickness / _LAYER_SPACING))
    solid = (surface + depths[:, None, None] * (rays / lengths)).reshape(-1, 3)
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
