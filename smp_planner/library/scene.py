"""A scene of one's own: what moves, among which obstacles, in the coordinates of the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from itertools import product

import numpy as np
from numpy.typing import NDArray

from smp_gym.scene import Obstacle
from smp_planner.collision.costs import CollisionCost
from smp_planner.library.chain import Arm, reachable_box, robot_workspace
from smp_planner.library.cloud import LearnedCloud, PointCloud, learned_cloud
from smp_planner.library.frame import Frame
from smp_planner.library.maps import Workspace, around_both, exact_grid, lowered, neural_grid
from smp_planner.library.mover import Mover
from smp_planner.library.point import Ball, DistanceMap, exact_map, in_space, nearest_of
from smp_planner.library.settings import AdaptSettings
from smp_planner.library.shapes import PathObstacle, bodies
from smp_planner.library.site import Place, PlaceSite, Site
from smp_planner.library.urdf import Robot
from smp_planner.occupancy.grid import DistanceGrid

__all__ = ["Scene"]

FloatArray = NDArray[np.float64]

_SLACK = 0.25
"""Extents around demonstrations and sites that a learned map covers."""

_ROOM = 0.5
"""Extents around demonstrations within which a point cloud is learned. It is more, since such a map
also judges paths, and one map serves starts and ends that lie `_SLACK` inside."""

_LAYER = 0.05
"""Extents that it covers above and below the plane in which paths are."""

_LOOKS = 3
"""Points along each side of a box that are tried for a free one."""

_MOST_SIDES = 6
"""Dimensions of a box up to which it is tried so."""


class Scene:
    """Obstacles for a ball or a robot.

    Args:
        frame: of the path.
        robot: that moves; None for a ball.
        obstacles: in the user's unit, m for a robot.
        radius: of the ball, in the user's unit.

    Raises:
        ValueError: an obstacle of another dimension than the path, more than one point cloud, or
            `radius` is negative, or not zero for a robot.
    """

    def __init__(
        self, frame: Frame, robot: Robot | None, obstacles: Sequence[PathObstacle], radius: float
    ) -> None:
        if not (math.isfinite(radius) and radius >= 0.0):
            raise ValueError(f"radius must not be negative, got {radius}")
        if robot is not None and radius > 0.0:
            raise ValueError(f"radius must be 0 for a robot, which has its own, got {radius}")
        self._frame, self._robot = frame, robot
        self._radius = float(frame.lengths_inwards(radius))
        clouds = [obstacle for obstacle in obstacles if isinstance(obstacle, PointCloud)]
        if len(clouds) > 1:
            raise ValueError(
                f"obstacles must hold one PointCloud at most, got {len(clouds)}; points of several "
                "make one, with a sensor for each point"
            )
        self._cloud = clouds[0] if clouds else None
        # The cloud is looked at after all bodies.
        self._order = sorted(range(len(obstacles)), key=lambda i: obstacles[i] is self._cloud)
        self._obstacle_frame = frame if robot is None else Frame(np.zeros(3), 1.0)
        self._bodies = bodies(obstacles, self._obstacle_frame)

    def mover(
        self,
        settings: AdaptSettings,
        seed: int,
        demonstrations: Sequence[FloatArray],
        sites: Sequence[Site],
    ) -> Mover:
        """Return what moves, with the map of the scene that the settings ask for.

        Args:
            settings: kind of map, weights.
            seed: of the training of a map.
            demonstrations: N arrays (T_j, D), in the user's unit; a map covers where they go.
            sites: and where these are.
        """
        cloud = self._known(settings, demonstrations, sites)
        if self._robot is None:
            covered = np.concatenate([self._demonstrated(demonstrations), self._corners(sites)])
            distance = self._distance(settings, seed, covered, cloud)
            return Ball(self._bodies, self._radius, distance, cloud)
        return self._arm(settings, seed, cloud)

    def refuse_blocked(
        self, sites: Sequence[Site], settings: AdaptSettings, demonstrations: Sequence[FloatArray]
    ) -> None:
        """Raise a ValueError if a site has no place where the body touches nothing.

        Args:
            sites: as in `mover`, like the others.
            settings: how a point cloud is learned.
            demonstrations: and where.
        """
        cloud = self._known(settings, demonstrations, sites)
        for site in sites:
            if not isinstance(site, PlaceSite):
                continue
            candidates = [_candidates(place) for place in site.places]
            # A via-point may be passed as far off as its tolerance.
            free = [
                bool((self._clearance(self._bodies, cloud, points) > -place.tolerance).any())
                for place, points in zip(site.places, candidates, strict=True)
            ]
            if any(free):
                continue
            each: list[tuple[tuple[Obstacle, ...], LearnedCloud | None]]
            each = [((body,), None) for body in self._bodies]
            each += [((), cloud)] if cloud is not None else []
            touched = [
                index
                for index, (body, known) in zip(self._order, each, strict=True)
                if (self._clearance(body, known, candidates[0]) <= 0.0).any()
            ]
            names = " and ".join(f"obstacles[{index}]" for index in touched) or "the robot itself"
            middle = self._frame.named(candidates[0].mean(axis=0))
            raise ValueError(f"{site.name} {middle} is inside or touches {names}")

    def _clearance(
        self, obstacles: tuple[Obstacle, ...], cloud: LearnedCloud | None, points: FloatArray
    ) -> FloatArray:
        """Return the distance (N,) of the body to obstacles where it stands at points (N, D)."""
        still = points[:, None]
        if self._robot is None:
            return Ball(obstacles, self._radius, None, cloud).check(still).clearance
        arm = Arm(self._robot.model, obstacles, None, AdaptSettings(), cloud)
        return arm.check(still).clearance

    def _demonstrated(self, demonstrations: Sequence[FloatArray]) -> FloatArray:
        """Return the normalised samples (N, D) that are not missing."""
        return np.concatenate(
            [self._frame.inwards(d)[np.isfinite(d).all(axis=1)] for d in demonstrations]
        )

    def _corners(self, sites: Sequence[Site]) -> FloatArray:
        """Return the normalised corners (N, D) of all places of sites."""
        boxes = [p.box for site in sites if isinstance(site, PlaceSite) for p in site.places]
        corners = [corner.numpy() for box in boxes for corner in (box.lower, box.upper)]
        return np.array(corners).reshape(-1, self._frame.dimension)

    def _known(
        self,
        settings: AdaptSettings,
        demonstrations: Sequence[FloatArray],
        sites: Sequence[Site],
    ) -> LearnedCloud | None:
        """Return what is known of the point cloud; None if there is none."""
        if self._cloud is None:
            return None
        if self._robot is not None:
            model = self._robot.model
            box, radius = reachable_box(model), float(model.radius.max(initial=0.0))
        else:
            shown, asked = self._demonstrated(demonstrations), self._corners(sites)
            covered = np.concatenate([shown - _ROOM, shown + _ROOM, asked - _SLACK, asked + _SLACK])
            box, radius = (covered.min(axis=0), covered.max(axis=0)), self._radius
        return learned_cloud(self._cloud, self._obstacle_frame, box, radius, settings)

    def _distance(
        self,
        settings: AdaptSettings,
        seed: int,
        covered: FloatArray,
        cloud: LearnedCloud | None,
    ) -> DistanceMap | None:
        """Return the map that costs ask, given points (N, D) where paths go."""
        parts: list[DistanceMap] = []
        if cloud is not None and cloud.grid is not None:
            parts.append(cloud.grid.query_with_gradient)
        if self._bodies and settings.map == "exact":
            parts.append(exact_map(self._bodies))
        elif self._bodies:
            around = in_space(covered[None])[0]
            slack = np.full(3, _SLACK)
            slack[self._frame.dimension :] = _LAYER
            workspace = around.min(axis=0) - slack, around.max(axis=0) + slack
            grid = self._learned(workspace, settings, seed)
            if grid is not None:
                parts.append(grid.query_with_gradient)
        return reduce(nearest_of, parts) if parts else None

    def _learned(
        self, workspace: Workspace, settings: AdaptSettings, seed: int
    ) -> DistanceGrid | None:
        points, steps = settings.map_points, settings.map_steps
        return neural_grid(self._bodies, workspace, points, steps, seed)

    def _arm(self, settings: AdaptSettings, seed: int, cloud: LearnedCloud | None) -> Arm:
        assert self._robot is not None
        model = self._robot.model
        workspace: Workspace | None = robot_workspace(model, self._bodies)
        known = None if cloud is None else cloud.map
        if workspace is not None and known is not None:
            workspace = around_both(workspace, known.grid.workspace)
        grid = None
        if workspace is not None and settings.map == "exact":
            grid = exact_grid(self._bodies, workspace)
        elif workspace is not None:
            grid = self._learned(workspace, settings, seed)
        if known is not None:
            grid = known.grid if grid is None else lowered(grid, known)
        cost = None if grid is None else CollisionCost(model, grid)
        return Arm(model, self._bodies, cost, settings, cloud)


def _candidates(place: Place) -> FloatArray:
    """Return points (N, D) of a place: its point, or a lattice of its box."""
    if place.point is not None:
        return place.point[None]
    lower, upper = place.box.lower.numpy(), place.box.upper.numpy()
    if len(lower) > _MOST_SIDES:
        return ((lower + upper) / 2)[None]
    shares = np.array(list(product(np.linspace(0.0, 1.0, _LOOKS), repeat=len(lower))))
    return np.asarray(lower + shares * (upper - lower))
