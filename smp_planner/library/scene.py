"""A scene of one's own: what moves, among which obstacles, in the coordinates of the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from smp_gym.scene import Obstacle
from smp_planner.costs import CollisionCost
from smp_planner.library.chain import Arm, robot_workspace
from smp_planner.library.frame import Frame
from smp_planner.library.maps import Workspace, exact_grid, neural_grid
from smp_planner.library.mover import Mover
from smp_planner.library.point import Ball, DistanceMap, exact_map, in_space
from smp_planner.library.settings import AdaptSettings
from smp_planner.library.shapes import PathObstacle, bodies
from smp_planner.library.site import Place, PlaceSite, Site
from smp_planner.library.urdf import Robot
from smp_planner.occupancy.grid import DistanceGrid

__all__ = ["Scene"]

FloatArray = NDArray[np.float64]

_SLACK = 0.25
"""Extents around demonstrations and sites that a learned map covers."""

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
        ValueError: an obstacle of another dimension than the path, or `radius` is negative, or not
            zero for a robot.
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
        if robot is None:
            self._bodies = bodies(obstacles, frame)
        else:
            self._bodies = bodies(obstacles, Frame(np.zeros(3), 1.0))

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
        if self._robot is None:
            corners = [self._frame.inwards(d)[np.isfinite(d).all(axis=1)] for d in demonstrations]
            corners += [
                np.stack([place.box.lower.numpy(), place.box.upper.numpy()])
                for site in sites
                if isinstance(site, PlaceSite)
                for place in site.places
            ]
            return Ball(self._bodies, self._radius, self._distance(settings, seed, corners))
        return self._arm(settings, seed)

    def refuse_blocked(self, sites: Sequence[Site]) -> None:
        """Raise a ValueError if a site has no place where the body touches nothing."""
        for site in sites:
            if not isinstance(site, PlaceSite):
                continue
            candidates = [_candidates(place) for place in site.places]
            # A via-point may be passed as far off as its tolerance.
            free = [
                bool((self._clearance(self._bodies, points) > -place.tolerance).any())
                for place, points in zip(site.places, candidates, strict=True)
            ]
            if any(free):
                continue
            touched = [
                index
                for index, body in enumerate(self._bodies)
                if (self._clearance((body,), candidates[0]) <= 0.0).any()
            ]
            names = " and ".join(f"obstacles[{index}]" for index in touched) or "the robot itself"
            middle = self._frame.named(candidates[0].mean(axis=0))
            raise ValueError(f"{site.name} {middle} is inside or touches {names}")

    def _clearance(self, obstacles: tuple[Obstacle, ...], points: FloatArray) -> FloatArray:
        """Return the distance (N,) of the body to obstacles where it stands at points (N, D)."""
        still = points[:, None]
        if self._robot is None:
            return Ball(obstacles, self._radius, None).check(still).clearance
        arm = Arm(self._robot.model, obstacles, None, AdaptSettings())
        return arm.check(still).clearance

    def _distance(
        self, settings: AdaptSettings, seed: int, corners: Sequence[FloatArray]
    ) -> DistanceMap | None:
        if not self._bodies:
            return None
        if settings.map == "exact":
            return exact_map(self._bodies)
        covered = in_space(np.concatenate(corners)[None])[0]
        slack = np.full(3, _SLACK)
        slack[self._frame.dimension :] = _LAYER
        workspace = covered.min(axis=0) - slack, covered.max(axis=0) + slack
        grid = self._learned(workspace, settings, seed)
        return None if grid is None else grid.query_with_gradient

    def _learned(
        self, workspace: Workspace, settings: AdaptSettings, seed: int
    ) -> DistanceGrid | None:
        points, steps = settings.map_points, settings.map_steps
        return neural_grid(self._bodies, workspace, points, steps, seed)

    def _arm(self, settings: AdaptSettings, seed: int) -> Arm:
        assert self._robot is not None
        model = self._robot.model
        workspace = robot_workspace(model, self._bodies)
        grid = None
        if workspace is not None and settings.map == "exact":
            grid = exact_grid(self._bodies, workspace)
        elif workspace is not None:
            grid = self._learned(workspace, settings, seed)
        cost = None if grid is None else CollisionCost(model, grid)
        return Arm(model, self._bodies, cost, settings)


def _candidates(place: Place) -> FloatArray:
    """Return points (N, D) of a place: its point, or a lattice of its box."""
    if place.point is not None:
        return place.point[None]
    lower, upper = place.box.lower.numpy(), place.box.upper.numpy()
    if len(lower) > _MOST_SIDES:
        return ((lower + upper) / 2)[None]
    shares = np.array(list(product(np.linspace(0.0, 1.0, _LOOKS), repeat=len(lower))))
    return np.asarray(lower + shares * (upper - lower))
