"""Objects that are attached to a robot in MoveIt's scenes, as bodies that it holds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from scipy.spatial.transform import Rotation

from smp_gym.datasets.moveit_attached import AttachedObject
from smp_gym.datasets.moveit_scene import SceneBody
from smp_gym.geometry.pose import Pose
from smp_gym.scene import Obstacle
from smp_planner.library.scene_bodies import SKIPPING, obstacles_of
from smp_planner.library.scene_frames import frame_poses, pose_above
from smp_planner.library.urdf import Robot

__all__ = ["Holding", "refuse_doubled"]


def refuse_doubled(attached: Iterable[AttachedObject], bodies: Iterable[SceneBody]) -> None:
    """Raise a ValueError if an object is both in the world and attached to the robot."""
    doubled = sorted({held.name for held in attached} & {body.name for body in bodies})
    if doubled:
        raise ValueError(
            f"world.collision_objects must not hold what is attached to the robot, got "
            f"{', '.join(doubled)}"
        )


@dataclass(frozen=True)
class Holding:
    """Makes bodies that a robot holds of attached objects.

    Attributes:
        robot: None if none is given.
        fixed: as of `frame_poses`, like the next two.
        given: the user's frames.
        mentioned: frames that the files name.
        cell: as of `PlanningScene.load`, like the rest.
        overshoot: m.
        skip_unsupported: whether to leave out what cannot be held.
    """

    robot: Robot | None
    fixed: Mapping[str, tuple[str, Pose]]
    given: Mapping[str, Pose]
    mentioned: Sequence[str]
    cell: float
    overshoot: float
    skip_unsupported: bool

    def parts(
        self, attached: Iterable[AttachedObject], state: Mapping[str, float]
    ) -> dict[str, tuple[list[Obstacle], tuple[str, ...]]]:
        """Return bodies in the tip's frame, and links that may touch them, by name of the object.

        Args:
            attached: the objects.
            state: positions of joints, rad or m, by name, in which they were attached.
        """
        found = {}
        for held in attached:
            if self.robot is None or held.link not in self.robot.tip_links:
                if self.skip_unsupported:
                    continue
                raise ValueError(_not_held(held, self.robot))
            unknown = [name for name in held.touch_links if name not in self.robot.links]
            if unknown and not self.skip_unsupported:
                raise ValueError(
                    f"{held.name}: touch_links must be links of the robot, got "
                    f"{', '.join(unknown)}; {SKIPPING}"
                )
            obstacles = [
                obstacle
                for body in held.bodies
                for obstacle in obstacles_of(
                    body,
                    self._in_tip(body.frame, self.robot, state),
                    self.cell,
                    self.overshoot,
                    self.skip_unsupported,
                )
            ]
            if obstacles:
                touched = tuple(name for name in held.touch_links if name not in unknown)
                found[held.name] = obstacles, (held.link, *touched)
        return found

    def robot_with(
        self, held: Mapping[str, tuple[list[Obstacle], tuple[str, ...]]], overshoot: float
    ) -> Robot | None:
        """Return the robot with the bodies that `parts` found.

        Args:
            held: by name.
            overshoot: m, as of `Robot.holding`.
        """
        robot = self.robot
        for name, (obstacles, touching) in held.items():
            assert robot is not None
            try:
                robot = robot.holding(obstacles, overshoot=overshoot, name=name, touching=touching)
            except ValueError as error:
                raise ValueError(f"{name}, which the robot holds: {error}") from error
        return robot

    def _in_tip(self, name: str, robot: Robot, state: Mapping[str, float]) -> Pose:
        """Return where a frame is in the tip's, fixed to it or by the state of the joints."""
        tips = {
            link: Pose(Rotation.from_matrix(pose[:3, :3]), pose[:3, 3])
            for link, pose in robot.tip_links.items()
        }
        top, pose = pose_above(name, self.fixed, tips)
        if top in tips:
            return tips[top].then(pose)
        there = frame_poses([name], self.mentioned, self.fixed, self.given, robot)[name]
        others = [joint for joint in state if joint not in {*robot.joints, *robot.standing}]
        try:
            configuration = robot.configuration(state, ignored=others)
        except ValueError as error:
            raise ValueError(
                f"an attached object has its pose in {name!r}, so that the robot's state must be "
                f"known: {error}"
            ) from error
        turn = Rotation.from_quat(robot.tool_quaternions(configuration))
        return Pose(turn, robot.tool_positions(configuration)).inverse().then(there)


def _not_held(held: AttachedObject, robot: Robot | None) -> str:
    """Return why an object cannot be held, as a message."""
    if robot is None:
        return f"{held.name} is attached to the robot, which must be given as robot=; {SKIPPING}"
    known = "" if held.link in robot.links else ", which is not known"
    return (
        f"{held.name} must be attached to a link that moves as the tip does, "
        f"{', '.join(sorted(robot.tip_links))}; got {held.link!r}{known}; {SKIPPING}"
    )
