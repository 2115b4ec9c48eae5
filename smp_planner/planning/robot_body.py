"""A robot that follows a trajectory: a body with spheres around its links."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.scene import Obstacle
from smp_planner.collision.costs import (
    CollisionCost,
    Cost,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
)
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import (
    check_collisions,
    minimum_duration,
    within_joint_limits,
)
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.bodies import Clearance, ObstacleCost
from smp_planner.planning.maps import SceneMaps, Workspace, around_both, lowered
from smp_planner.planning.settings import PlanSettings

__all__ = ["RobotBody", "reachable_box"]

_LIMIT_MARGIN = 0.02
"""rad or m that costs keep from joint limits at most."""

_SLIDE_MARGIN = 0.01
"""Share of the range of a prismatic joint that they keep, where that is less: a stroke may be
short."""


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
