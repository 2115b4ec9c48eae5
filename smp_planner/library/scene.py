"""A scene of the user: a body and its obstacles, in the coordinates of the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle
from smp_planner.library.cloud import PointCloud, learned_cloud
from smp_planner.library.frame import Frame
from smp_planner.library.shapes import PathObstacle, bodies
from smp_planner.library.urdf import Robot
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.ball import Ball
from smp_planner.planning.bodies import Body
from smp_planner.planning.constraints import Constraint, Passing, Place
from smp_planner.planning.path_clearance import in_space
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.robot_body import RobotBody, reachable_box
from smp_planner.planning.settings import PlanSettings

__all__ = ["Scene"]

REFERENCE_SPHERES = 32
"""Spheres to which the collision cost of a robot is scaled, however finely it is covered."""

_MAP_MARGIN = 0.25
"""Extents around demonstrations and constraints that a learned map covers."""

_CLOUD_MARGIN = 0.5
"""Extents around demonstrations within which a point cloud is learned. It is more, since such a map
also serves the check of paths, and one map serves starts and ends that lie `_MAP_MARGIN` inside."""

_MAP_HALF_HEIGHT = 0.05
"""Extents that it covers above and below the plane in which paths are."""

_LATTICE_POINTS = 3
"""Points along each side of a box that are tried for a free one."""

_MOST_LATTICE_DIMENSIONS = 6
"""Dimensions of a box up to which it is tried so."""


class Scene:
    """Obstacles for a ball or a robot.

    Args:
        frame: of the path.
        robot: that moves; None for a ball.
        obstacles: in the user's unit, m for a robot.
        radius: of the ball, in the user's unit.

    Attributes:
        order: numbers of the obstacles in the order in which they are checked, a cloud last.

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
        # The cloud is checked after all bodies.
        self.order = sorted(range(len(obstacles)), key=lambda i: obstacles[i] is self._cloud)
        self._obstacle_frame = frame if robot is None else Frame(np.zeros(3), 1.0)
        self._bodies = bodies(obstacles, self._obstacle_frame)

    def problem(
        self,
        constraints: tuple[Constraint, ...],
        settings: PlanSettings,
        seed: int,
        demonstrations: Sequence[FloatArray],
    ) -> Problem:
        """Return the problem of this scene, in the coordinates of the path.

        Args:
            constraints: on the path, ascending in phase.
            settings: how a point cloud is learned.
            seed: of the plan.
            demonstrations: N arrays (T_j, D), in the user's unit; a map covers where they go.
        """
        cloud = self._known(settings, demonstrations, constraints)
        body: Body
        if self._robot is None:
            shown, asked = self._demonstrated(demonstrations), self._corners(constraints)
            workspace = None
            if self._bodies:
                around = in_space(np.concatenate([shown, asked])[None])[0]
                slack = np.full(3, _MAP_MARGIN)
                slack[self._frame.dimension :] = _MAP_HALF_HEIGHT
                lower, upper = around.min(axis=0) - slack, around.max(axis=0) + slack
                workspace = tuple(lower.tolist()), tuple(upper.tolist())
            body = Ball(self._frame.dimension, self._radius, workspace)
        else:
            body = RobotBody(self._robot.model, reference_spheres=REFERENCE_SPHERES)
        stage = Stage(0.0, 1.0, body, self._bodies, cloud)
        return Problem(body, constraints, (stage,), seed, self._bodies)

    def refuse_blocked(
        self,
        constraints: Sequence[Constraint],
        settings: PlanSettings,
        demonstrations: Sequence[FloatArray],
    ) -> None:
        """Raise a ValueError if a constraint has no place where the body touches nothing.

        Args:
            constraints: as in `problem`, like the others.
            settings: how a point cloud is learned.
            demonstrations: and where.
        """
        cloud = self._known(settings, demonstrations, constraints)
        for constraint in constraints:
            if not isinstance(constraint, Passing):
                continue
            candidates = [_candidates(place) for place in constraint.places]
            # A via-point may be passed as far off as its tolerance.
            free = [
                bool((self._clearance(self._bodies, cloud, points) > -place.tolerance).any())
                for place, points in zip(constraint.places, candidates, strict=True)
            ]
            if any(free):
                continue
            each: list[tuple[tuple[Obstacle, ...], CloudMap | None]]
            each = [((body,), None) for body in self._bodies]
            each += [((), cloud)] if cloud is not None else []
            touched = [
                index
                for index, (body, known) in zip(self.order, each, strict=True)
                if (self._clearance(body, known, candidates[0]) <= 0.0).any()
            ]
            names = " and ".join(f"obstacles[{index}]" for index in touched) or "the robot itself"
            middle = self._frame.named(candidates[0].mean(axis=0))
            raise ValueError(f"{constraint.name} {middle} is inside or touches {names}")

    def _clearance(
        self, obstacles: tuple[Obstacle, ...], cloud: CloudMap | None, points: FloatArray
    ) -> FloatArray:
        """Return the distance (N,) of the body to obstacles where it stands at points (N, D)."""
        body: Body = Ball(self._frame.dimension, self._radius)
        if self._robot is not None:
            body = RobotBody(self._robot.model)
        return body.check(points[:, None], obstacles, cloud).clearance

    def _demonstrated(self, demonstrations: Sequence[FloatArray]) -> FloatArray:
        """Return the normalised samples (N, D) that are not missing."""
        return np.concatenate(
            [self._frame.inwards(d)[np.isfinite(d).all(axis=1)] for d in demonstrations]
        )

    def _corners(self, constraints: Sequence[Constraint]) -> FloatArray:
        """Return the normalised corners (N, D) of all places of constraints."""
        boxes = [
            p.box
            for constraint in constraints
            if isinstance(constraint, Passing)
            for p in constraint.places
        ]
        corners = [corner.numpy() for box in boxes for corner in (box.lower, box.upper)]
        return np.array(corners).reshape(-1, self._frame.dimension)

    def _known(
        self,
        settings: PlanSettings,
        demonstrations: Sequence[FloatArray],
        constraints: Sequence[Constraint],
    ) -> CloudMap | None:
        """Return the learned map of the point cloud; None if there is none."""
        if self._cloud is None:
            return None
        if self._robot is not None:
            model = self._robot.model
            box, radius = reachable_box(model), float(model.radius.max(initial=0.0))
        else:
            shown, asked = self._demonstrated(demonstrations), self._corners(constraints)
            covered = np.concatenate(
                [
                    shown - _CLOUD_MARGIN,
                    shown + _CLOUD_MARGIN,
                    asked - _MAP_MARGIN,
                    asked + _MAP_MARGIN,
                ]
            )
            box, radius = (covered.min(axis=0), covered.max(axis=0)), self._radius
        return learned_cloud(self._cloud, self._obstacle_frame, box, radius, settings)


def _candidates(place: Place) -> FloatArray:
    """Return points (N, D) of a place: its point, or a lattice of its box."""
    if place.point is not None:
        return place.point[None]
    lower, upper = place.box.lower.numpy(), place.box.upper.numpy()
    if len(lower) > _MOST_LATTICE_DIMENSIONS:
        return ((lower + upper) / 2)[None]
    shares = np.array(list(product(np.linspace(0.0, 1.0, _LATTICE_POINTS), repeat=len(lower))))
    return np.asarray(lower + shares * (upper - lower))
