"""A point cloud as an obstacle, and the map that the paper's network learns of it, Eq. (12).

A camera gives no bodies: the map is all that is known of the scene, so that plans are made and
assessed on it. It is learned once for a cloud and a workspace and kept with the cloud.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_planner.library.frame import Frame
from smp_planner.occupancy.neural import INFLATION, PointNetworkMap, train_map
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.point_cloud import CloudMap, label_point_cloud
from smp_planner.planning.maps import Workspace
from smp_planner.planning.settings import PlanSettings

__all__ = ["THICKNESS", "PointCloud", "learned_cloud"]

THICKNESS = 0.05
"""Extents (m for a robot), default depth of objects behind their seen surface."""

_SEED = 0
"""Seed of points and training: the map belongs to the cloud, whatever the seed of a plan."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points on surfaces, as a depth camera sees them, that paths in space or a robot avoid.

    What lies behind a seen surface, within a thickness, is taken for occupied, and all else that
    was not seen for free: what is thicker than that may be entered from behind. Points of the
    moving body itself must have been taken out.

    Attributes:
        points: (N, 3) in the unit of the path; for a robot m, in its base frame.
        sensor: (3,) where the camera stood, or (N, 3) for each point its own, so that clouds of
            several cameras make one; same unit.
        thickness: depth of objects behind their surface, same unit; None takes `THICKNESS`.
        inflation: by which objects are grown while the map is learned, which takes it off again;
            same unit. Most points must have a neighbour within it. None takes 0.02 extents (m for
            a robot).
        maps: what has been learned of it, by workspace and settings.
    """

    points: FloatArray
    sensor: FloatArray
    thickness: float | None = None
    inflation: float | None = None
    maps: dict[Any, PointNetworkMap] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        points = _fixed("PointCloud.points", self.points)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ValueError(
                f"PointCloud.points must have shape (N, 3), N at least 1, got {points.shape}"
            )
        sensor = _fixed("PointCloud.sensor", self.sensor)
        if sensor.shape not in ((3,), points.shape):
            raise ValueError(
                f"PointCloud.sensor must have shape (3,) or {points.shape}, got {sensor.shape}"
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "sensor", sensor)
        if self.thickness is not None:
            checked_number("PointCloud.thickness", self.thickness, least=0.0)
        if self.inflation is not None:
            checked_number("PointCloud.inflation", self.inflation, above=0.0)
        self.refuse_near_sensor(self.inflation or 0.0)

    def __repr__(self) -> str:
        """Return a short description, without the points."""
        return f"PointCloud({len(self.points)} points)"

    def refuse_near_sensor(self, inflation: float) -> None:
        """Raise a ValueError if a sensor is within the inflation of what it sees."""
        nearest = float(np.linalg.norm(self.points - self.sensor, axis=1).min())
        if nearest <= inflation:
            raise ValueError(
                f"PointCloud.sensor must be farther than {inflation:.6g} from what it sees, got a "
                f"point {nearest:.6g} from it"
            )

    def refuse_sparse(self, inflation: float) -> None:
        """Raise a ValueError if half of several points have no neighbour within the inflation."""
        if len(self.points) < 2:
            return
        gap = float(np.median(cKDTree(self.points).query(self.points, k=2)[0][:, 1]))
        if gap > inflation:
            raise ValueError(
                f"PointCloud.points must be denser than inflation, {inflation:.6g}, got points "
                f"whose nearest neighbours are {gap:.6g} away in the median"
            )


def learned_cloud(
    cloud: PointCloud,
    frame: Frame,
    reachable: Workspace,
    radius: float,
    settings: PlanSettings,
) -> CloudMap:
    """Return the learned map of a cloud where the moving body can be.

    Args:
        cloud: in the user's unit.
        frame: that makes normalised coordinates of it.
        reachable: corners of the box in which the body can be, normalised.
        radius: of the largest ball that queries it, normalised; the map is not cut off up to it
            and `TRUNCATION` more.
        settings: how many points and steps to learn with.

    Raises:
        ValueError: the sensor is within the inflation of a point, or the points are sparser.
    """
    inflation = cloud.inflation if cloud.inflation is not None else INFLATION * frame.scale
    thickness = cloud.thickness if cloud.thickness is not None else THICKNESS * frame.scale
    cloud.refuse_near_sensor(inflation)
    depth = float(frame.lengths_inwards(thickness + inflation))
    lower, upper = (np.asarray(corner, np.float64) for corner in reachable)
    points = frame.inwards(cloud.points)
    seen_outside = not ((points >= lower) & (points <= upper)).all()
    bounds = (tuple(lower), tuple(upper)) if seen_outside else None
    # What is seen outside may reach inside by as much.
    near = ((points >= lower - depth) & (points <= upper + depth)).all(axis=1)
    if not near.any():
        return CloudMap(None, bounds)
    around = depth + radius + TRUNCATION
    workspace = (
        tuple(np.maximum(lower - depth, points[near].min(axis=0) - around).tolist()),
        tuple(np.minimum(upper + depth, points[near].max(axis=0) + around).tolist()),
    )
    size = settings.map_points, settings.map_steps
    key = (*frame.offset, frame.scale, *workspace, radius, *size)
    if key not in cloud.maps:
        cloud.refuse_sparse(inflation)
        drawn, labels = label_point_cloud(
            points,
            frame.inwards(cloud.sensor),
            settings.map_points,
            np.random.default_rng([_SEED, 2]),
            thickness=float(frame.lengths_inwards(thickness)),
            inflation=float(frame.lengths_inwards(inflation)),
            workspace=workspace,
        )
        network = train_map(
            drawn,
            labels,
            inflation=float(frame.lengths_inwards(inflation)),
            steps=settings.map_steps,
            seed=_SEED,
        )
        cloud.maps[key] = PointNetworkMap.of(network, workspace, truncation=radius + TRUNCATION)
    return CloudMap(cloud.maps[key], bounds)


def _fixed(name: str, value: ArrayLike) -> FloatArray:
    """Return a copy that cannot be changed: the map must not outlive the points."""
    array = checked_array(name, value)
    array.setflags(write=False)
    return array
