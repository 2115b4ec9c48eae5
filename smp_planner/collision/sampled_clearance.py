"""Clearance of many trajectories at their samples, for a search: floored, and ended early.

The exact check (`smp_planner.collision.verification`) settles what lies between the samples and
takes milliseconds a trajectory; a search over hundreds of thousands needs tens of microseconds.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.geometry.distance import PackedObstacles, point_distance
from smp_gym.robot.forward_kernels import link_poses, place
from smp_gym.scene import Obstacle
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import self_gap_of

__all__ = ["sampled_clearance"]

SELF_GAP = 2e-3
"""Metres that spheres of the arm keep from each other."""


@kernel(fastmath=FAST)
def _clearances(trajectories, robot, obstacles, floor, enough, clearance):
    """Write the clearance (P,) of trajectories (P,n,T); see `sampled_clearance`."""
    count, joints, steps = trajectories.shape
    link, radius = robot.link, robot.radius
    spheres = link.shape[0]
    sine = np.empty((joints, steps))
    cosine = np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    placed = np.empty((spheres, 3, steps))
    balls = np.empty((joints + 1, 3, steps))
    links = np.arange(joints + 1)
    at = np.empty((spheres, 3))
    known = np.empty(spheres)
    for p in range(count):
        link_poses(
            trajectories[p],
            robot.prismatic,
            robot.base,
            robot.origins,
            sine,
            cosine,
            rotation,
            position,
        )
        place(rotation, position, link, robot.center, placed)
        nearest = enough
        known[:] = -np.inf
        at[:] = 0.0
        # The middle of a trajectory, where obstacles are, comes first: it ends most early.
        for turn in range(steps):
            offset = (turn + 1) // 2
            t = steps // 2 + (offset if turn % 2 else -offset)
            if t < 0 or t >= steps:
                continue
            for s in range(spheres - 1, -1, -1):
                if link[s] == 0:
                    continue
                x, y, z = placed[s, 0, t], placed[s, 1, t], placed[s, 2, t]
                dx, dy, dz = x - at[s, 0], y - at[s, 1], z - at[s, 2]
                if known[s] - math.sqrt(dx * dx + dy * dy + dz * dz) >= nearest:
                    continue
                known[s] = point_distance(x, y, z, *obstacles) - radius[s]
                at[s, 0], at[s, 1], at[s, 2] = x, y, z
                nearest = min(nearest, known[s])
            if nearest <= floor:
                break
        clearance[p] = max(nearest, floor)
        if nearest > 0.0:
            place(rotation, position, links, robot.ball_center, balls)
            for t in range(steps):
                if self_gap_of(placed, balls, t, robot) < SELF_GAP:
                    clearance[p] = floor
                    break


def sampled_clearance(
    trajectories: FloatArray,
    robot: RobotModel,
    obstacles: Sequence[Obstacle] | PackedObstacles,
    floor: float = -0.03,
    enough: float = 0.03,
) -> FloatArray:
    """Return the least clearance (P,) m of trajectories (P, T, n) rad at their samples.

    Args:
        trajectories: at any steps; what lies between them is not looked at.
        robot: the arm and what it carries.
        obstacles: bodies at rest.
        floor: m, lower values are given as this, and so is a trajectory that touches itself.
        enough: m, greater values are given as this.
    """
    packed = obstacles if isinstance(obstacles, PackedObstacles) else PackedObstacles.of(obstacles)
    clearance = np.empty(len(trajectories))
    ordered = np.ascontiguousarray(trajectories.swapaxes(1, 2))
    _clearances(ordered, robot.arrays, packed.arrays, floor, enough, clearance)
    return clearance
