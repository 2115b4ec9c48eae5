"""Planning scenes of MoveIt for any robot: obstacles, start and goals from files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from smp_gym.arrays import checked_number, shown
from smp_gym.datasets.moveit_attached import attached_of
from smp_gym.datasets.moveit_matrix import allowed_of
from smp_gym.datasets.moveit_scene import (
    PoseGoal,
    base_moved,
    bodies_of,
    frames_of,
    goals_of,
    has_octomap,
    joints_of,
    path_constrained,
    read_message,
)
from smp_gym.scene import Obstacle
from smp_planner.library.allowed_collisions import (
    passed_through,
    touching_allowed,
    warn_of_strangers,
)
from smp_planner.library.held_objects import Holding, refuse_doubled
from smp_planner.library.pose_goals import goal_regions
from smp_planner.library.scene_bodies import SKIPPING, obstacles_of
from smp_planner.library.scene_frames import checked_frames, frame_poses
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
        robot: the one that was given, with what it holds in the scene (`Robot.held`) and the links
            that may touch there (`Robot.touching`); primitives are learned of it. None if none was
            given.
    """

    obstacles: tuple[Obstacle, ...]
    names: tuple[str, ...]
    start: Mapping[str, float] | None = None
    goals: tuple[Mapping[str, float], ...] = ()
    tool_goals: tuple[GoalRegion, ...] = ()
    robot: Robot | None = None

    def __repr__(self) -> str:
        """Return a short description, without the bodies."""
        start = "a start" if self.start else "no start"
        of_tool = f", {len(self.tool_goals)} goals of the tool" if self.tool_goals else ""
        held = f", holding {', '.join(self.robot.held)}" if self.robot and self.robot.held else ""
        return (
            f"PlanningScene({len(self.obstacles)} obstacles, {start}, {len(self.goals)} goals"
            f"{of_tool}{held})"
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
        held_overshoot: float = 0.01,
        skip_unsupported: bool = False,
    ) -> PlanningScene:
        """Read a scene, and a request for it.

        Boxes, spheres and cylinders are read as they are, cones as cylinders around them
        (`cone_obstacles`), meshes that the file holds as spheres over them (`mesh_obstacles`). The
        start is that of the request, or else the robot's state in the scene. Padding and colours
        are left alone, as are weights of goals and tolerances of joints.

        A goal of a pose, a position constraint with boxes and spheres as its regions and at most
        one orientation constraint, becomes a `GoalRegion` of the robot's tip for each region. What
        has no such form is taken narrower, never wider: a sphere as the cube in it, a box that is
        turned as the box of its proportions along the axes that fits in, tolerances about the three
        axes as the least of them, or, where that about x or z is π or more, as a `Cone` of the
        least of the others (see `pose_goals`).

        Objects that are attached to the robot, in the scene's state or the request's, become bodies
        that it holds (`PlanningScene.robot`), in the order of the file. Their links must move as
        the tip does; their poses are in the frame of any such link, or, by the state of the
        joints beside them, in one that stands still. Their touch links may touch them.

        Of the allowed collision matrix, pairs of links and of what is held are added to
        `Robot.touching`, and an object that all that moves may touch is no obstacle. Plans keep
        clear of objects that only some links may touch; such pairs, and names that are of nothing,
        are logged as warnings.

        Args:
            path: of MoveIt's text (``.scene``, at most 16 MiB), or of YAML (at most 1 MiB) with the
                fields of ``moveit_msgs/PlanningScene``, as MotionBenchMaker has it.
            request: of YAML with the fields of ``moveit_msgs/MotionPlanRequest``; None reads start
                and goals from the scene's file, if it has any.
            robot: whose links that do not move are frames of known places, and whose base frame
                is "world", the frame of bodies that name none. Goals of a pose need it, and are of
                its tip or of links that move as that does. Attached objects and the matrix need it,
                too.
            frames: position (3,) m and quaternion (4,) x, y, z, w, in the robot's base frame, of
                other frames by name. Frames that the file itself places in others follow these.
                With neither robot nor frames the one frame of the file is taken for the base frame.
            cell: m, size of the pieces of a mesh that each get a sphere.
            overshoot: m, by which cylinders stand out of a cone at most.
            held_overshoot: m, by which spheres stand out of what the robot holds at most
                (`Robot.holding`); of a mesh or cone, out of the spheres or cylinders that stand for
                it.
            skip_unsupported: leave out planes, octomaps, meshes of other files, objects attached
                to links that do not move as the tip does, touch links that the robot lacks, all
                that is attached where no robot is given, and constraints on the path, instead of
                refusing them.

        Raises:
            OSError: a file cannot be read.
            ValueError: it is no such file, holds something that cannot be used, or a frame's place
                is not known; the message names file, object or line, field and value.
            ImportError: it is YAML, and PyYAML is not installed.
        """
        cell = checked_number("cell", cell, above=0.0)
        overshoot = checked_number("overshoot", overshoot, above=0.0)
        held_overshoot = checked_number("held_overshoot", held_overshoot, above=0.0)
        if robot is not None and not isinstance(robot, Robot):
            raise ValueError(f"robot must be a Robot, got {shown(robot)}")
        if not isinstance(skip_unsupported, bool):
            raise ValueError(
                f"skip_unsupported must be True or False, got {shown(skip_unsupported)}"
            )
        given = checked_frames(frames)
        with _named(path, "scene"):
            message = read_message(path)
            if not skip_unsupported and "world" in message and has_octomap(message):
                raise ValueError(f"world has an octomap; {SKIPPING}")
            if frames is None:
                _refuse_moved(message.get("robot_state"), "robot_state")
            bodies = list(bodies_of(message))
            attached = attached_of(message.get("robot_state"), "robot_state")
            refuse_doubled(attached, bodies)
            fixed, own = frames_of(message), [body.frame for body in bodies]
            mentioned = [*own, *(body.frame for held in attached for body in held.bodies)]
            poses = frame_poses(own, mentioned, fixed, given, robot)
            parts = [
                (body.name, obstacle)
                for body in bodies
                for obstacle in obstacles_of(
                    body, poses[body.frame], cell, overshoot, skip_unsupported
                )
            ]
            start = joints_of(message.get("robot_state"), "robot_state")
            allowed = allowed_of(message)
            holding = Holding(robot, fixed, given, mentioned, cell, overshoot, skip_unsupported)
            held = holding.parts(attached, start)
        with _named(path if request is None else request, "request"):
            asked = message if request is None else read_message(request)
            if request is not None and not {"start_state", "goal_constraints"} & set(asked):
                raise ValueError(
                    f"it must have start_state or goal_constraints, got {shown(sorted(asked))}"
                )
            if path_constrained(asked) and not skip_unsupported:
                raise ValueError(f"it constrains the path, which is not kept; {SKIPPING}")
            if frames is None:
                _refuse_moved(asked.get("start_state"), "start_state")
            start |= joints_of(asked.get("start_state"), "start_state")
            more = attached_of(asked.get("start_state"), "start_state")
            refuse_doubled(more, bodies)
            held |= holding.parts(more, start)
            joints, regions = [], []
            for goal in goals_of(asked):
                if not isinstance(goal, PoseGoal):
                    joints.append(goal)
                    continue
                named = [goal.frame, *([goal.orientation.frame] if goal.orientation else [])]
                placed = frame_poses(named, [*mentioned, *named], fixed, given, robot)
                regions += goal_regions(goal, placed, robot)
        with _named(path, "scene"):
            carrying = holding.robot_with(held, held_overshoot)
        objects = {body.name for body in bodies}
        warn_of_strangers(carrying, allowed, objects)
        if carrying is not None:
            carrying = touching_allowed(carrying, allowed)
            free = passed_through(carrying, allowed, objects)
            parts = [part for part in parts if part[0] not in free]
        names, obstacles = zip(*parts, strict=True) if parts else ((), ())
        return cls(obstacles, names, start or None, tuple(joints), tuple(regions), carrying)


@contextmanager
def _named(path: str | PathLike[str], what: str) -> Iterator[None]:
    """Have errors of values name the file."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{Path(path)} is no {what} that can be used: {error}") from error


def _refuse_moved(state: Any, where: str) -> None:
    """Raise a ValueError if a robot's state moves its base."""
    moved = base_moved(state, where)
    if moved is not None:
        raise ValueError(
            f"{where} moves the robot's base by {moved!r}: say by frames= where the scene is then"
        )
