"""Bodies that follow a trajectory: a robot with spheres around its links, or a ball.

A body says what its trajectories cost on a map (Eq. (12)), which limits they must keep, and, by an
exact check, whether they are clear of obstacles. The pipeline knows nothing else of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple, Protocol

import numpy as np
from scipy.special import expit

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.geometry.distance import PackedObstacles, signed_distance, signed_distance_and_gradient
from smp_gym.scene import Obstacle
from smp_planner.collision.clearances import Clearances
from smp_planner.collision.costs import (
    CollisionCost,
    Cost,
    JointLimitCost,
    SelfCollisionCost,
    ValueAndGradient,
    VelocityLimitCost,
    steps_scale,
)
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import (
    check_collisions,
    minimum_duration,
    within_joint_limits,
)
from smp_planner.occupancy.grid import DistanceGrid
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.maps import SceneMaps, Workspace, around_both, lowered
from smp_planner.planning.settings import PlanSettings

__all__ = [
    "PATH_TOLERANCE",
    "Ball",
    "BallClearances",
    "Body",
    "DistanceMap",
    "ObstacleCost",
    "RobotBody",
    "exact_map",
    "in_space",
    "path_clearance",
    "reachable_box",
]

_LIMIT_MARGIN = 0.02
"""rad or m that costs keep from joint limits at most."""

_SLIDE_MARGIN = 0.01
"""Share of the range of a prismatic joint that they keep, where that is less: a stroke may be
short."""

DistanceMap = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Map from points (N, 3) to signed distance (N,) and its gradient (N, 3)."""

PATH_TOLERANCE = 1e-4
"""Extents by which the clearance of a ball's path may be overestimated."""

_MOST_HALVINGS = 40


class ObstacleCost(Protocol):
    """The collision cost of Eq. (12) on a map."""

    @property
    def scale(self) -> float:
        """Factor of the sum."""
        ...

    @property
    def clearances(self) -> Clearances:
        """The clearances whose occupancies are summed, one by one."""
        ...

    def __call__(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return value (P,) and gradient (P, T, D) at trajectories (P, T, D)."""
        ...


class Clearance(NamedTuple):
    """Results of the exact check of P whole trajectories.

    Attributes:
        clearance: (P,) least distance to an obstacle, negative inside; infinity without any.
        free: (P,) whether the whole trajectory touches nothing, the body itself included.
    """

    clearance: FloatArray
    free: BoolArray


class Body(Protocol):
    """Protocol of bodies; lengths are m, or extents for a ball."""

    @property
    def dimension(self) -> int:
        """D, number of coordinates of a configuration."""
        ...

    def obstacle_cost(
        self,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None,
        maps: SceneMaps,
    ) -> ObstacleCost | None:
        """Return the collision cost on a map; None if there is nothing to meet.

        Args:
            obstacles: bodies at rest.
            cloud: map of a point cloud, if there is one.
            maps: of the problem.
        """
        ...

    def limit_costs(self, settings: PlanSettings) -> dict[str, tuple[float, Cost]]:
        """Return the costs of the body's own limits by name, each with its weight."""
        ...

    def check(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> Clearance:
        """Check whole trajectories (P, T, D), between their samples, too."""
        ...

    def free_waypoints(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> BoolArray:
        """Return (P, T) whether the configurations of trajectories (P, T, D) touch nothing."""
        ...

    def execution(self, trajectories: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
        """Return whether trajectories can be executed within a duration, and their duration.

        Args:
            trajectories: (P, T, D).
            limit: s.

        Returns:
            (P,) whether limits hold, and (P,) s, shortest execution; NaN where nothing limits it.
        """
        ...

    def paths(self, trajectories: FloatArray, point: FloatArray | None) -> FloatArray:
        """Return the paths (P, T, 2 or 3) of the body, or of a point (3,) fixed to its hand."""
        ...


def reachable_box(model: RobotModel) -> Workspace:
    """Return the corners, m, of a box around all that a robot can reach with any of its parts."""
    outer = np.linalg.norm(model.center, axis=1) + model.radius
    origins, first = model.joint_origins, 0
    frame = model.base @ origins[0]
    lower, upper = frame[:3, 3], frame[:3, 3]
    # Prismatic joints before all others move what is beyond them along axes that stand still.
    while first < model.joints and model.prismatic[first]:
        ends = np.outer((model.lower[first], model.upper[first]), frame[:3, 2])
        lower = lower + np.minimum(ends.min(axis=0), 0.0)
        upper = upper + np.maximum(ends.max(axis=0), 0.0)
        first += 1
        if first < model.joints:
            step = frame[:3, :3] @ origins[first][:3, 3]
            lower, upper = lower + np.minimum(step, 0.0), upper + np.maximum(step, 0.0)
            frame = frame @ origins[first]
    arms = np.linalg.norm(origins[first + 1 :, :3, 3], axis=1).sum()
    reach = arms + outer.max(initial=0.0)
    if model.prismatic[first:].any():
        farthest = np.maximum(np.abs(model.lower), np.abs(model.upper))[first:]
        reach = reach + farthest[model.prismatic[first:]].sum()
    return tuple((lower - reach).tolist()), tuple((upper + reach).tolist())


@dataclass(frozen=True, eq=False)
class RobotBody:
    """A robot whose configurations follow the trajectory.

    Attributes:
        model: the robot and what it carries.
        workspace: box that maps cover, m; None takes where it can meet the obstacles.
        reference_spheres: spheres to which the collision cost is scaled, so that a weight means
            the same however finely a robot is covered; None sums over all of them.
    """

    model: RobotModel
    workspace: Workspace | None = None
    reference_spheres: int | None = None

    @property
    def dimension(self) -> int:
        """Number of joints."""
        return self.model.joints

    def obstacle_cost(
        self,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None,
        maps: SceneMaps,
    ) -> ObstacleCost | None:
        """Return the squared occupancy of the spheres on the map; see `Body`."""
        workspace = self.workspace or self._meeting(obstacles)
        known = None if cloud is None else cloud.map
        grid = None
        if workspace is not None and obstacles:
            if known is not None:
                workspace = around_both(workspace, known.grid.workspace)
            grid = maps.grid(obstacles, workspace)
        if known is not None:
            grid = known.grid if grid is None else lowered(grid, known)
        if grid is None:
            return None
        cost = CollisionCost(self.model, grid)
        if self.reference_spheres is None:
            return cost
        if not cost.summed_spheres:
            return None
        return replace(cost, scale=self.reference_spheres / cost.summed_spheres)

    def _meeting(self, obstacles: tuple[Obstacle, ...]) -> Workspace | None:
        """Return the box where the robot can meet obstacles; None if there is no such."""
        packed = PackedObstacles.of(obstacles)
        if not len(packed):
            return None
        least, most = reachable_box(self.model)
        around = packed.half_extents + TRUNCATION
        lower = np.maximum((packed.position - around).min(axis=0), least)
        upper = np.minimum((packed.position + around).max(axis=0), most)
        if not (lower < upper).all():
            return None
        return tuple(lower.tolist()), tuple(upper.tolist())

    def limit_costs(self, settings: PlanSettings) -> dict[str, tuple[float, Cost]]:
        """Return the costs of self-collision, velocities and joint limits."""
        model = self.model
        return {
            "self_collision": (settings.self_collision_weight, SelfCollisionCost(model)),
            "velocity": (
                settings.velocity_weight,
                VelocityLimitCost(model.velocity, settings.duration_limit),
            ),
            "joint_limits": (
                settings.limit_weight,
                JointLimitCost(model.lower, model.upper, margin=_limit_margins(model)),
            ),
        }

    def check(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> Clearance:
        """Check whole trajectories against obstacles and the robot itself; see `Body`."""
        grid = None if cloud is None else cloud.grid
        found = check_collisions(trajectories, self.model, obstacles, grid=grid)
        return Clearance(found.clearance, found.free)

    def free_waypoints(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> BoolArray:
        """Return (P, T) whether configurations touch neither obstacles nor the robot itself."""
        checker = EdgeChecker(self.model, obstacles, grid=None if cloud is None else cloud.grid)
        found = checker.configurations_free(trajectories.reshape(-1, self.dimension))
        return found.reshape(trajectories.shape[:2])

    def execution(self, trajectories: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
        """Return whether joint limits hold and the duration is within a limit; see `Body`."""
        duration = minimum_duration(trajectories, self.model.velocity)
        return within_joint_limits(trajectories, self.model) & (duration <= limit), duration

    def paths(self, trajectories: FloatArray, point: FloatArray | None) -> FloatArray:
        """Return the paths (P, T, 3) m of a point of the hand, by default the tool's origin."""
        return self.model.carried_points(trajectories, np.zeros(3) if point is None else point)[0]


def _limit_margins(model: RobotModel) -> float | FloatArray:
    """Return what costs keep from the limits of all joints, or of each (n,), rad or m."""
    if not model.prismatic.any():
        return _LIMIT_MARGIN
    short = _SLIDE_MARGIN * (model.upper - model.lower)
    return np.where(model.prismatic, np.minimum(short, _LIMIT_MARGIN), _LIMIT_MARGIN)


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


def in_space(trajectories: FloatArray) -> FloatArray:
    """Return paths (P, T, 3) of (P, T, 2 or 3); those in the plane lie at z = 0."""
    missing = 3 - trajectories.shape[-1]
    return np.ascontiguousarray(np.pad(trajectories, ((0, 0), (0, 0), (0, missing))))


def path_clearance(
    trajectories: FloatArray,
    obstacles: tuple[Obstacle, ...],
    tolerance: float = PATH_TOLERANCE,
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
    for _ in range(_MOST_HALVINGS):
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
