"""Rules common to all tasks: defaults that few change, checks of scenes, scale of dense rewards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, REACH, SHOULDER_HEIGHT
from smp_gym.scene import Scene
from smp_gym.tasks.goals import GoalCodec
from smp_gym.tasks.status import Status

__all__ = ["POTENTIAL_PER_METRE", "CommonRules"]

POTENTIAL_PER_METRE = 2.0
"""Rise of the dense reward's potential towards the goal. The end of an episode, by failure too,
forgives the distance left: 2 m of it must count for much less than a failure."""


@dataclass(frozen=True)
class CommonRules:
    """The rules of a task as far as most tasks share them; see `smp_gym.tasks.Task`."""

    name: str

    goals: ClassVar[GoalCodec]
    object_in_hand: ClassVar[AnyFloatArray]

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        if scene.task != self.name:
            raise ValueError(f"scene.task must be {self.name!r}, got {scene.task!r}")
        _check_playable(scene)

    def supports(self, scene: Scene) -> tuple[tuple[float, float, float], ...]:
        """Return nothing: the object is not set down on anything but the table."""
        return ()

    def failure(self, status: Status) -> str:
        """Return nothing: as long as there is time, the episode can succeed."""
        return ""

    def collided(self, achieved: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) tell of a collision, (...)."""
        return np.asarray(achieved[..., self._flag("collided")] > 0.5)

    def lost(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return False for all goals (..., G): no episode is over without success."""
        return np.zeros(np.broadcast(achieved, desired).shape[:-1], np.bool_)

    def demands_all(self, desired: AnyFloatArray) -> BoolArray:
        """Return True for all goals (..., G): whoever reaches one has done the task for it."""
        return np.ones(np.shape(desired)[:-1], np.bool_)

    def details(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> dict[str, Any]:
        """Return nothing: goals hold no more than success."""
        return {}

    def _flag(self, name: str) -> int:
        """Return the column of a flag in the goal vectors."""
        return int(self.goals.columns(name).start)


def _check_playable(scene: Scene) -> None:
    """Raise ValueError if an obstacle moves nobody knows where, or the arm reaches not far enough.

    What moves must have a motion; the arm must reach start and goals.
    """
    for number, obstacle in enumerate(scene.obstacles):
        if any(obstacle.velocity) and obstacle.motion is None:
            raise ValueError(
                f"scene.obstacles[{number}] without a motion must stand still (velocity 0), "
                f"got {obstacle.velocity} m/s"
            )
    start = np.array(scene.start)
    if not ((start >= JOINT_LOWER) & (start <= JOINT_UPPER)).all():
        raise ValueError(
            f"scene.start must lie between {JOINT_LOWER.round(4).tolist()} and "
            f"{JOINT_UPPER.round(4).tolist()} rad, got {start.tolist()}"
        )
    for number, goal in enumerate(scene.goals):
        for x, y, z in (goal.position, *goal.checkpoints):
            # What is let go over a goal falls straight down to it.
            if not (np.hypot(x, y) <= REACH and 0.0 <= z <= SHOULDER_HEIGHT + REACH):
                raise ValueError(
                    f"scene.goals[{number}] must lie within {REACH:.2f} m of the base's axis, 0 to "
                    f"{SHOULDER_HEIGHT + REACH:.2f} m above the table, got {[x, y, z]} m"
                )
