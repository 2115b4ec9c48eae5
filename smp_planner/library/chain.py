"""A robot of one's own among obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from smp_gym.geometry.distance import PackedObstacles
from smp_gym.scene import Obstacle
from smp_planner.collision.costs import (
    REFERENCE_STEPS,
    CollisionCost,
    Cost,
    JointLimitCost,
    SelfCollisionCost,
    VelocityLimitCost,
)
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import verify
from smp_planner.library.cloud import LearnedCloud
from smp_planner.library.mover import Check, ValueAndGradient, steps_scale
from smp_planner.library.settings import AdaptSettings
from smp_planner.occupancy.occupancy_map import TRUNCATION

__all__ = [
    "REFERENCE_SPHERES",
    "Arm",
    "reachable_box",
    "robot_workspace",
    "with_collision_pairs",
]

FloatArray = NDArray[np.float64]
Workspace = tuple[tuple[float, ...], tuple[float, ...]]

REFERENCE_SPHERES = 32
"""Spheres to which sums over a robot are scaled, however finely it is covered."""

PAIR_GAP = 0.01
"""m, least gap of two spheres in all demonstrations from which on they are kept apart."""

_LOOKS = 50


def with_collision_pairs(model: RobotModel, demonstrations: Sequence[FloatArray]) -> RobotModel:
    """Return a robot that knows which of its spheres must stay clear of each other.

    Those of links that are not neighbours, unless they come nearer than `PAIR_GAP` in a
    demonstration: spheres reach beyond what they cover, and demonstrations are free.

    Args:
        model: whose `collision_pairs` are not looked at.
        demonstrations: (T_j, n) rad.
    """
    looks = [d[np.linspace(0, len(d) - 1, _LOOKS).astype(int)] for d in demonstrations]
    centers = model.sphere_centers(torch.from_numpy(np.concatenate(looks))).numpy()
    link, radius = model.link, model.radius
    pairs = []
    for first in range(len(link)):
        others = np.flatnonzero(link > link[first] + 1)
        gap = np.linalg.norm(centers[:, others] - centers[:, first : first + 1], axis=-1).min(
            axis=0
        )
        kept = others[gap - radius[others] - radius[first] > PAIR_GAP]
        pairs.append(np.column_stack([np.full(len(kept), first), kept]))
    empty = np.empty((0, 2), np.int64)
    return replace(model, collision_pairs=np.concatenate([empty, *pairs]))


def reachable_box(model: RobotModel) -> Workspace:
    """Return the corners, m, of a box around all that a robot can reach with any of its parts."""
    arms = np.linalg.norm(model.joint_origins[1:, :3, 3], axis=1).sum()
    outer = np.linalg.norm(model.center, axis=1) + model.radius
    reach = arms + outer.max(initial=0.0)
    middle = (model.base @ model.joint_origins[0])[:3, 3]
    return tuple((middle - reach).tolist()), tuple((middle + reach).tolist())


def robot_workspace(model: RobotModel, obstacles: Sequence[Obstacle]) -> Workspace | None:
    """Return the corners of the box where a robot can meet obstacles; None if there is no such."""
    packed = PackedObstacles.of(obstacles)
    if not len(packed):
        return None
    least, most = reachable_box(model)
    around = packed.half_extents + TRUNCATION
    lower = np.maximum((packed.position - around).min(axis=0), least)
    upper = np.minimum((packed.position + around).max(axis=0), most)
    if not (lower < upper).all():
        return None
    return tuple(lower.tolist()), tuple(upper.tolist())


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot whose configurations follow the path; a `Mover`.

    Attributes:
        model: the robot.
        obstacles: m, in the frame of its root link.
        collision_cost: of its spheres on the scene's map; None if it can meet no obstacle.
        settings: weights of the limits' costs.
        cloud: what is known of a `PointCloud`; None if there is none.
    """

    model: RobotModel
    obstacles: tuple[Obstacle, ...]
    collision_cost: CollisionCost | None
    settings: AdaptSettings
    cloud: LearnedCloud | None = None

    @cached_property
    def _limits(self) -> dict[str, tuple[float, Cost]]:
        model, settings = self.model, self.settings
        terms: dict[str, tuple[float, Cost]] = {
            "self_collision": (settings.self_collision_weight, SelfCollisionCost(model)),
            "velocity": (
                settings.velocity_weight,
                VelocityLimitCost(model.velocity, settings.duration_limit),
            ),
            "joint_limits": (
                settings.limit_weight,
                JointLimitCost(model.lower, model.upper, margin=0.02),
            ),
        }
        return {name: term for name, term in terms.items() if term[0] > 0.0}

    def collision(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return the squared occupancy of the robot's spheres along the path; see `Mover`."""
        if self.collision_cost is None or not self.collision_cost.summed_spheres:
            return np.zeros(len(trajectories)), np.zeros(trajectories.shape)
        value, gradient = self.collision_cost(trajectories, edge_width, margin)
        # `CollisionCost` has scaled the sum by the number of steps.
        steps = trajectories.shape[1]
        scale = steps_scale(steps) * steps / REFERENCE_STEPS
        scale *= REFERENCE_SPHERES / self.collision_cost.summed_spheres
        return scale * value, scale * gradient

    def limits(self, trajectories: FloatArray) -> dict[str, tuple[float, ValueAndGradient]]:
        """Return the costs of self-collision, velocities and joint limits; see `Mover`."""
        return {name: (weight, cost(trajectories)) for name, (weight, cost) in self._limits.items()}

    def check(self, trajectories: FloatArray) -> Check:
        """Check whole paths; see `Mover`."""
        grid = None if self.cloud is None else self.cloud.grid
        limit = self.settings.duration_limit
        found = verify(trajectories, self.model, self.obstacles, limit, grid)
        return Check(found.clearance, found.collision_free, found.executable, found.duration)
