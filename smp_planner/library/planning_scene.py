"""Planning scenes of MoveIt for any robot: obstacles, start and goals from files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from smp_gym.arrays import checked_number, shown
from smp_gym.datasets.moveit_scene import (
    WORLD,
    PoseGoal,
    SceneBody,
    base_moved,
    bodies_of,
    frames_of,
    goals_of,
    has_octomap,
    held_of,
    joints_of,
    path_constrained,
    read_message,
)
from smp_gym.geometry.pose import Pose, checked_pose
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.library.covering import check_mesh
from smp_planner.library.mesh_obstacles import placed_spheres, spheres_of
from smp_planner.library.pose_goals import goal_regions
from smp_planner.library.solids import cone_obstacles
from smp_planner.library.urdf import Robot
from smp_planner.planning.tool_goals import GoalRegion

__all__ = ["PlanningScene"]


@dataclass(frozen=True, eq=False)
class PlanningScene:
    """What a planning scene of MoveIt holds: obstacles, and a query where one is given.

    Made by `PlanningScene.load`.

    Attributes:
        obstacles: (N) bodies, m, in the robot's base frame: that of its root link, or the one in
            which `Robot.from_urdf` was given the pose of that.
        names: (N) of the collision object that each is of.
        start: positions, rad or m, by joint; None if none is given. `Robot.configuration` puts
            them into the robot's order.
        goals: likewise, each a goal that will do.
        tool_goals: regions of the tool with their orientations, each a goal that will do.
    """

    obstacles: tuple[Obstacle, ...]
    names: tuple[str, ...]
    start: Mapping[str, float] | None = None
    goals: tuple[Mapping[str, float], ...] = ()
    tool_goals: tuple[GoalRegion, ...] = ()

    def __repr__(self) -> str:
        """Return a short description, without the bodies."""
        start = "a start" if self.start else "no start"
        of_tool = f", {len(self.tool_goals)} goals of the tool" if self.tool_goals else ""
        return (
            f"PlanningScene({len(self.obstacles)} obstacles, {start}, {len(self.goals)} goals"
            f"{of_tool})"
        )

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        request: str | PathLike[str] | None = None,
        robot: Robot | None = None,
        frames: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
        cell: float = 0.05,
        overshoot: float = 0.005,
        skip_unsupported: bool = False,
    ) -> PlanningScene:
        """Read a scene, and a request for it.

        Boxes, spheres and cylinders are read as they are, cones as cylinders around them
        (`cone_obstacles`), meshes that the file holds as spheres over them (`mesh_obstacles`). The
        start is that of the request, or else the robot's state in the scene. Collision matrix,
        padding and colours are left alone, as are weights of goals and tolerances of joints.

        A goal of a pose, a position constraint with boxes and spheres as its regions and at most
        one orientation constraint, becomes a `GoalRegion` of the robot's tip for each region. What
        has no such form is taken narrower, never wider: a sphere as the cube in it, a box that is
        turned as the box of its proportions along the axes that fits in, tolerances about the three
        axes as the least of them, or, where that about x or z is π or more, as a `Cone` of the
        least of the others (see `pose_goals`).

        Args:
            path: of MoveIt's text (``.scene``, at most 16 MiB), or of YAML (at most 1 MiB) with the
                fields of ``moveit_msgs/PlanningScene``, as MotionBenchMaker has it.
            request: of YAML with the fields of ``moveit_msgs/MotionPlanRequest``; None reads start
                and goals from the scene's file, if it has any.
            robot: whose links that do not move are frames of known places, and whose base frame
                is "world", the frame of bodies that name none. Goals of a pose need it, and are of
                its tip or of links that move as that does.
            frames: position (3,) m and quaternion (4,) x, y, z, w, in the robot's base frame, of
                other frames by name. Frames that the file itself places in others follow these.
                With neither robot nor frames the one frame of the file is taken for the base frame.
            cell: m, size of the pieces of a mesh that each get a sphere.
            overshoot: m, by which cylinders stand out of a cone at most.
            skip_unsupported: leave out planes, octomaps, meshes of other files, what the robot
                holds, and constraints on the path, instead of refusing them.

        Raises:
            OSError: a file cannot be read.
            ValueError: it is no such file, holds something that cannot be used, or a frame's place
                is not known; the message names file, object or line, field and value.
            ImportError: it is YAML, and PyYAML is not installed.
        """
        cell = checked_number("cell", cell, above=0.0)
        overshoot = checked_number("overshoot", overshoot, above=0.0)
        if robot is not None and not isinstance(robot, Robot):
            raise ValueError(f"robot must be a Robot, got {shown(robot)}")
        given = _checked_frames(frames)
        with _named(path, "scene"):
            message = read_message(path)
            if not skip_unsupported:
                _refuse_unsupported(message)
            if frames is None:
                _refuse_moved(message.get("robot_state"), "robot_state")
            bodies = list(bodies_of(message))
            fixed, own = frames_of(message), [body.frame for body in bodies]
            poses = _poses(own, own, fixed, given, robot)
            parts = [
                (body.name, obstacle)
                for body in bodies
                for obstacle in _obstacles(
                    body, poses[body.frame], cell, overshoot, skip_unsupported
                )
            ]
            start = joints_of(message.get("robot_state"), "robot_state")
        with _named(path if request is None else request, "request"):
            asked = message if request is None else read_message(request)
            if request is not None and not {"start_state", "goal_constraints"} & set(asked):
                raise ValueError(
                    f"it must have start_state or goal_constraints, got {shown(sorted(asked))}"
                )
            if path_constrained(asked) and not skip_unsupported:
                raise ValueError(
                    "it constrains the path, which is not kept; skip_unsupported=True leaves it out"
                )
            if frames is None:
                _refuse_moved(asked.get("start_state"), "start_state")
            start |= joints_of(asked.get("start_state"), "start_state")
            joints, regions = [], []
            for goal in goals_of(asked):
                if not isinstance(goal, PoseGoal):
                    joints.append(goal)
                    continue
                named = [goal.frame, *([goal.orientation.frame] if goal.orientation else [])]
                placed = _poses(named, [*own, *named], fixed, given, robot)
                regions += goal_regions(goal, placed, robot)
        names, obstacles = zip(*parts, strict=True) if parts else ((), ())
        return cls(obstacles, names, start or None, tuple(joints), tuple(regions))


@contextmanager
def _named(path: str | PathLike[str], what: str) -> Iterator[None]:
    """Have errors of values name the file."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{Path(path)} is no {what} that can be used: {error}") from error


def _checked_frames(frames: Any) -> dict[str, Pose]:
    if frames is None:
        return {}
    if not isinstance(frames, Mapping):
        raise ValueError(f"frames must map names to positions and quaternions, got {shown(frames)}")
    placed = {}
    for name, given in frames.items():
        if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
            raise ValueError(f"frames[{name!r}] must be (position, quaternion), got {shown(given)}")
        placed[str(name).lstrip("/")] = checked_pose(*given, where=f"frames[{name!r}].")
    return placed


def _refuse_unsupported(message: Mapping[str, Any]) -> None:
    """Raise a ValueError if a scene has an octomap, or its robot holds something."""
    advice = "skip_unsupported=True leaves it out"
    if "world" in message and has_octomap(message):
        raise ValueError(f"world has an octomap; {advice}")
    held = held_of(message)
    if held:
        raise ValueError(f"the robot holds {', '.join(held)}, which is not planned for; {advice}")


def _refuse_moved(state: Any, where: str) -> None:
    """Raise a ValueError if a robot's state moves its base."""
    moved = base_moved(state, where)
    if moved is not None:
        raise ValueError(
            f"{where} moves the robot's base by {moved!r}: say by frames= where the scene is then"
        )


def _poses(
    names: Sequence[str],
    mentioned: Sequence[str],
    fixed: Mapping[str, tuple[str, Pose]],
    given: Mapping[str, Pose],
    robot: Robot | None,
) -> dict[str, Pose]:
    """Return where frames are in the robot's base frame.

    Args:
        names: of the frames.
        mentioned: frames that the files name.
        fixed: of frames their parents, and their poses there.
        given: the user's, by name.
        robot: whose links are frames, too.
    """
    known = {WORLD, *mentioned, *fixed, *(parent for parent, _ in fixed.values())}
    unknown = sorted(set(given) - known)
    if unknown:
        raise ValueError(f"frames must be of {', '.join(sorted(known))}, got {', '.join(unknown)}")
    placed = dict(given)
    for name, pose in {} if robot is None else robot.base_links.items():
        # A root link of that name which stands elsewhere is not what files call the world.
        if name == WORLD and not np.array_equal(pose, np.eye(4)):
            continue
        placed.setdefault(name, Pose(Rotation.from_matrix(pose[:3, :3]), pose[:3, 3]))
    above = {name: _above(name, fixed, placed) for name in dict.fromkeys(names)}
    left = sorted({top for top, _ in above.values()} - set(placed))
    if left and (given or len(left) > 1 or (robot is not None and left != [WORLD])):
        raise ValueError(
            f"frames must say where {' and '.join(left)} are in the robot's base frame, got "
            f"{', '.join(given) or 'none'}"
        )
    return {
        name: placed.get(top, Pose.identity()).then(pose) for name, (top, pose) in above.items()
    }


def _above(
    name: str, fixed: Mapping[str, tuple[str, Pose]], placed: Mapping[str, Pose]
) -> tuple[str, Pose]:
    """Return the nearest frame above whose place is known, or the last, and the pose in it."""
    pose, passed = Pose.identity(), {name}
    while name not in placed and name in fixed:
        name, within = fixed[name]
        pose = within.then(pose)
        if name in passed:
            raise ValueError(f"fixed_frame_transforms place {name!r} in itself")
        passed.add(name)
    return name, pose


def _obstacles(
    body: SceneBody, frame: Pose, cell: float, overshoot: float, skip_unsupported: bool
) -> list[Obstacle]:
    """Return the obstacles that stand for a body."""
    if body.kind in REGISTRY:
        return [body.obstacle(frame)]
    pose = frame.then(body.pose)
    if body.kind == "cone":
        height, radius = body.dimensions
        try:
            return cone_obstacles(
                radius,
                height,
                overshoot=overshoot,
                position=pose.position,
                quaternion=pose.quaternion,
            )
        except ValueError as error:
            raise ValueError(f"{body.where}: {error}") from error
    if body.vertices is not None:
        mesh = trimesh.Trimesh(body.vertices, body.triangles)
        check_mesh(mesh, body.where)
        spheres = spheres_of(mesh, cell, body.where, "if its lengths are millimetres, scale them")
        return placed_spheres(spheres, pose)
    if not skip_unsupported:
        what = "a plane" if body.kind == "plane" else "a mesh of another file"
        raise ValueError(
            f"{body.where} is {what}, which is not read; skip_unsupported=True leaves it out"
        )
    return []
