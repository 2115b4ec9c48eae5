"""Goals of a pose from MoveIt as regions of a robot's tool, never wider than they were.

MoveIt measures the difference R of an orientation by its intrinsic XYZ Euler angles, or by its
rotation vector. If R turns by an angle θ of at most π/2, no Euler angle and no component of the
rotation vector is larger than θ; if R moves the z axis by that angle, the Euler angles about x and
y are no larger, and if it moves the x axis by it, those about y and z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.datasets.moveit_scene import OrientationGoal, PoseGoal
from smp_gym.geometry.pose import Pose
from smp_planner.library.urdf import Robot
from smp_planner.planning.tool_goals import GoalRegion
from smp_planner.planning.tool_orientations import Cone, Orientation, ToolOrientation

__all__ = ["goal_regions"]

_WHOLE = math.pi - 1e-3
"""rad, tolerance from which on an angle is free: files round π."""


def goal_regions(
    goal: PoseGoal, frames: Mapping[str, Pose], robot: Robot | None
) -> list[GoalRegion]:
    """Return the regions of the tool, one for each region of a goal, any of which will do.

    Args:
        goal: as read.
        frames: poses in the base frame of the frames that it names.
        robot: whose tool it is.

    Raises:
        ValueError: there is no robot, or a link that does not move as its tip does.
    """
    if robot is None:
        raise ValueError(f"{goal.where} is a goal of a pose, for which robot= must be given")
    orientation = goal.orientation
    asked = None
    if orientation is not None:
        link = _in_tip(orientation.link, goal.where, robot)
        turn = frames[orientation.frame].rotation * orientation.rotation
        asked = _orientation(orientation, turn, link.rotation)
    point = _in_tip(goal.link, goal.where, robot).of(goal.point)
    regions = []
    for kind, pose, size in goal.regions:
        placed = frames[goal.frame].then(pose)
        if kind == "box":
            inside = _upright(placed.rotation, size)
        else:
            inside = np.full(3, size[0] / math.sqrt(3.0))
        regions.append(GoalRegion(point, placed.position - inside, placed.position + inside, asked))
    return regions


def _in_tip(link: str, where: str, robot: Robot) -> Pose:
    """Return the pose of a link in the tip's frame."""
    if link not in robot.tip_links:
        known = ", ".join(robot.tip_links) or "none known"
        raise ValueError(
            f"{where} must be of a link that moves as the robot's tip does ({known}), got {link!r}"
        )
    pose = robot.tip_links[link]
    return Pose(Rotation.from_matrix(pose[:3, :3]), pose[:3, 3])


def _upright(rotation: Rotation, half: FloatArray) -> FloatArray:
    """Return half extents (3,) m along the axes of a box within a turned one of (3,) m.

    They are those of the box around it, scaled down until it fits in.
    """
    across = np.abs(rotation.as_matrix())
    around = across @ half
    return np.asarray(around * np.min(half / (across.T @ around)))


def _orientation(asked: OrientationGoal, turn: Rotation, link: Rotation) -> ToolOrientation | None:
    """Return what a tool's orientation must be for that of a link.

    Args:
        asked: of the link.
        turn: of the link that is asked for, in the base frame.
        link: rotation of the link in the tip's frame.
    """
    x, y, z = asked.tolerances.tolist()
    if x >= _WHOLE and z >= _WHOLE and y >= (_WHOLE / 2.0 if asked.euler else _WHOLE):
        return None
    if asked.euler and max(x, z) >= _WHOLE:
        axis, angle = ([0.0, 0.0, 1.0], min(x, y)) if z >= _WHOLE else ([1.0, 0.0, 0.0], min(y, z))
        return Cone(link.apply(axis), turn.apply(axis), min(angle, math.pi / 2.0))
    tolerance = min(x, y, z, math.pi / 2.0)
    return Orientation((turn * link.inv()).as_quat(), tolerance)
