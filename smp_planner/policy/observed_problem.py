"""The planning problem that an observation describes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import DecodedObservation
from smp_gym.robot.kinematics import (
    PEN_TIP,
    SphereSet,
    arm_spheres,
    box_spheres,
    concatenate,
    end_effector_pose,
    finger_spheres,
    pen_spheres,
    sphere_centers,
)
from smp_gym.scene import BIN_HEIGHT, STROKE_POINTS, Goal, Obstacle, fixtures
from smp_gym.sensing.depth_camera import CAMERA_POSITION
from smp_planner.occupancy.point_cloud import CloudMap, closed_surface, layers_behind
from smp_planner.planning.problem import Problem, arm_problem, arm_stage
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint, ViaPose
from smp_planner.policy.grasping import Grasping, upright_pose

__all__ = ["SEEN_THICKNESS", "checkpoint_phases", "problem_from", "seen_map"]

SEEN_THICKNESS = 0.08
"""Depth of obstacles behind their seen surface that plans count on, m."""

_INFLATION = 0.03
"""Metres by which a cloud's points are grown, and the map shrunk again: gaps twice as wide are
filled, and no link of the arm fits through them."""

_ARM_MARGIN = 0.01
"""Metres around the arm, where it is now, in which nothing is taken for an obstacle."""

RELEASE_HEIGHT = (0.005, 0.035)
"""Least and greatest height of the object's lowest point above the rim when it is let go, m."""

PAD_RELEASE_HEIGHT = (0.012, 0.035)
"""Least and greatest height of that point above a pad, m: the object's spheres stand out of it by
9 mm, and from higher up it would tip over."""

RELEASE_HALF_WIDTH = 0.02
"""Half width of the square above the goal's middle in which the object's centre is let go, m."""


END_HALF_WIDTH = 0.01
"""Half width of the cube round the end of a stroke in which the pen stops, m."""

CHECKPOINT_TOLERANCE = 0.036
"""Distance to the checkpoints of a stroke that a plan allows the pen, m; the task allows 4 cm."""

LIFT_HALF_WIDTH = 0.01
"""Half width of the cube about the target in which the lifted object's centre ends, m."""


def _release_region(goal: Goal, point: np.ndarray, reach_down: float) -> GoalRegion:
    """Return where the object's centre may be when the hand opens over a bin or a pad.

    Args:
        goal: the bin or the pad.
        point: (3,) the object's centre in the end-effector frame.
        reach_down: distance from the object's centre to its lowest point, m.
    """
    x, y, z = goal.position
    rim = z + (BIN_HEIGHT if goal.kind == "bin" else 0.0) + reach_down
    least, greatest = RELEASE_HEIGHT if goal.kind == "bin" else PAD_RELEASE_HEIGHT
    lower = (x - RELEASE_HALF_WIDTH, y - RELEASE_HALF_WIDTH, rim + least)
    upper = (x + RELEASE_HALF_WIDTH, y + RELEASE_HALF_WIDTH, rim + greatest)
    return GoalRegion(point, np.array(lower), np.array(upper))


def seen_map(decoded: DecodedObservation, attached: SphereSet) -> CloudMap | None:
    """Return the map of what a depth camera sees; None where obstacles are observed as rows.

    Behind a seen surface all is taken for occupied, within `SEEN_THICKNESS`, but for where the arm
    is now.

    Args:
        decoded: what the observation says.
        attached: spheres that move with the hand, as they are now.
    """
    if decoded.points is None:
        return None
    if not len(decoded.points):
        return CloudMap(None)
    solid = layers_behind(decoded.points, np.array(CAMERA_POSITION), SEEN_THICKNESS)
    arm = concatenate(arm_spheres(), attached)
    placed = sphere_centers(decoded.robot.configuration, arm)
    apart = np.linalg.norm(solid[:, None] - placed, axis=-1) - arm.radius
    solid = solid[(apart > _ARM_MARGIN).all(axis=1)]
    surface = closed_surface(solid, _INFLATION) if len(solid) else None
    return CloudMap(surface, seen=decoded.points)


def _grasping_problem(decoded: DecodedObservation, seed: int, grasping: Grasping) -> Problem:
    """Return the problem of grasping an object and carrying it to a target.

    Until the demonstrated contact begins, the object is an obstacle; then the hand may touch it;
    once the hand has closed, it is carried, and may touch what it stands on.
    """
    size = decoded.object.size
    turn = Rotation.from_quat(decoded.object.quaternion).as_matrix()
    yaw = float(np.arctan2(turn[1, 0], turn[0, 0]))
    frame = upright_pose(decoded.object.position, yaw)
    held = grasping.object_in_hand
    arm, box = arm_spheres(), box_spheres(size, held)
    opened = concatenate(arm, finger_spheres(decoded.robot.finger_angles))
    fingers = finger_spheres(grasping.finger_angles)
    x, y, z = frame[:3, 3].tolist()
    block = Obstacle(
        shape="box",
        position=(x, y, z),
        quaternion=(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))),
        size=tuple(size.tolist()),
    )
    obstacles = decoded.scene.obstacles
    solid = (*obstacles, *fixtures(decoded.scene))
    contact, grasp = float(grasping.phases[0]), grasping.phase
    cloud = seen_map(decoded, finger_spheres(decoded.robot.finger_angles))
    target = np.array(decoded.scene.goals[0].position)
    return arm_problem(
        start=decoded.robot.reference,
        obstacles=solid,
        attached=concatenate(fingers, box),
        goals=(GoalRegion(held[:3, 3], target - LIFT_HALF_WIDTH, target + LIFT_HALF_WIDTH),),
        seed=seed,
        via_poses=tuple(
            ViaPose(float(phase), frame @ pose, rest=phase == grasp)
            for phase, pose in zip(grasping.phases, grasping.poses, strict=True)
        ),
        stages=(
            arm_stage(0.0, contact, opened, (*solid, block), cloud),
            arm_stage(contact, grasp, opened, solid, cloud),
            arm_stage(grasp, 1.0, concatenate(arm, fingers), solid, cloud),
            arm_stage(grasp, 1.0, box, obstacles, cloud),
        ),
        movable=obstacles,
    )


def checkpoint_phases(demonstrations: Demonstrations) -> np.ndarray:
    """Return the mean phases (`STROKE_POINTS`,) at which demonstrators pass equal parts of the arc.

    Args:
        demonstrations: of a task that draws.
    """
    pose = end_effector_pose(demonstrations.configurations)
    pen = pose[..., :3, :3] @ PEN_TIP + pose[..., :3, 3]
    arc = np.cumsum(np.linalg.norm(np.diff(pen, axis=1, prepend=pen[:, :1]), axis=-1), axis=1)
    phase = np.linspace(0.0, 1.0, arc.shape[1])
    parts = np.linspace(0.0, 1.0, STROKE_POINTS)
    return np.mean([np.interp(parts, a / a[-1], phase) for a in arc], axis=0)


def _drawing_problem(decoded: DecodedObservation, seed: int, phases: np.ndarray | None) -> Problem:
    """Return the problem of following a stroke: its end is the goal, the rest are via-points."""
    stroke = decoded.scene.goals[0]
    end = np.asarray(stroke.position)
    if phases is None:
        phases = np.linspace(0.0, 1.0, STROKE_POINTS)
    # The pen starts near the first checkpoint, and the last one is the goal.
    via_points = tuple(
        ToolViaPoint(float(phases[k]), PEN_TIP, np.asarray(place), CHECKPOINT_TOLERANCE)
        for k, place in enumerate(stroke.checkpoints[:-1])
        if k > 0 and stroke.demanded[k]
    )
    attached = concatenate(finger_spheres(decoded.robot.finger_angles), pen_spheres())
    return arm_problem(
        start=decoded.robot.reference,
        obstacles=(*decoded.scene.obstacles, *fixtures(decoded.scene)),
        attached=attached,
        goals=(GoalRegion(PEN_TIP, end - END_HALF_WIDTH, end + END_HALF_WIDTH),),
        seed=seed,
        via_points=via_points,
        movable=decoded.scene.obstacles,
        cloud=seen_map(decoded, attached),
        traced=STROKE_POINTS,
    )


def problem_from(
    decoded: DecodedObservation,
    seed: int,
    phases: np.ndarray | None = None,
    *,
    grasping: Grasping | None = None,
) -> Problem:
    """Return the problem that one observation poses.

    The hand's fingers and the object are taken to move rigidly with the hand, as they do now.

    Args:
        decoded: what the observation says.
        seed: of the plan's randomness.
        phases: (`STROKE_POINTS`,) when a stroke's checkpoints are due, from `checkpoint_phases`;
            by default at equal steps.
        grasping: what demonstrations teach about a grasp; see `learn_grasping`.

    Raises:
        ValueError: the task is to grasp an object, and `grasping` is None.
    """
    if decoded.scene.goals[0].kind == "stroke":
        return _drawing_problem(decoded, seed, phases)
    if decoded.scene.goals[0].kind == "lift":
        if grasping is None:
            raise ValueError("grasping must be given where an object is to be grasped, got None")
        return _grasping_problem(decoded, seed, grasping)
    hand = end_effector_pose(decoded.robot.configuration)
    object_pose = np.eye(4)
    object_pose[:3, :3] = Rotation.from_quat(decoded.object.quaternion).as_matrix()
    object_pose[:3, 3] = decoded.object.position
    held = np.linalg.inv(hand) @ object_pose
    attached = concatenate(
        finger_spheres(decoded.robot.finger_angles), box_spheres(decoded.object.size, held)
    )
    reach_down = float(np.abs(object_pose[2, :3]) @ decoded.object.size)
    goals = tuple(_release_region(g, held[:3, 3], reach_down) for g in decoded.scene.goals)
    return arm_problem(
        start=decoded.robot.reference,
        obstacles=(*decoded.scene.obstacles, *fixtures(decoded.scene)),
        attached=attached,
        goals=goals,
        seed=seed,
        movable=decoded.scene.obstacles,
        cloud=seen_map(decoded, attached),
    )
