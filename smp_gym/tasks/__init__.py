"""The tasks: what an episode is about, told without a physics engine.

A task is a small frozen object. It says where an episode starts, which contacts it needs, what its
goal vectors hold and when they mean success; the environment asks it after every step.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smp_gym.scene import TASKS, Scene
from smp_gym.tasks.double_sided_placement.rules import DoubleSidedPlacement
from smp_gym.tasks.draw_s.rules import DrawS
from smp_gym.tasks.placement.rules import Placement
from smp_gym.tasks.push_lift_box.rules import PushLiftBox
from smp_gym.tasks.status import Status

__all__ = ["Status", "Task", "make_task"]

FloatArray = NDArray[np.floating[Any]]
BoolArray = NDArray[np.bool_]


class Task(Protocol):
    """What the environment asks of a task. Goal vectors are those of `GOAL_LAYOUTS`."""

    @property
    def name(self) -> str:
        """Name, one of `smp_gym.scene.TASKS`."""
        ...

    @property
    def version(self) -> int:
        """Version of the task's scene distribution."""
        ...

    @property
    def object_in_hand(self) -> FloatArray:
        """(4, 4) pose of object or pen's tip in the end-effector frame once the hand holds it."""
        ...

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        ...

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch, names in alphabetical order.

        The groups are ``arm`` (base and links 1 to 5), ``hand`` (palm and fingers), ``object``,
        ``obstacle``, ``table``, ``bin`` and ``pad``. Any other contact is a collision.

        Args:
            held: whether the hand grips the object.
        """
        ...

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        ...

    def failure(self, status: Status) -> str:
        """Return why the episode can no longer succeed, or an empty string."""
        ...

    def success(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Return whether goals (..., G) are reached, (...)."""
        ...

    def collided(self, achieved: FloatArray) -> BoolArray:
        """Return whether goals (..., G) tell of a collision, (...)."""
        ...

    def lost(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Return whether goals (..., G) tell of an episode that is over without success, (...).

        It may depend on the desired goal for the verdict only, not for the moment: an episode that
        ends here with one desired goal must end with any, as success or as failure. So hindsight
        relabelling, which keeps the ends of episodes, stays exact.
        """
        ...

    def potential(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return the potential (...) whose differences make up the dense reward."""
        ...

    def details(self, achieved: FloatArray, desired: FloatArray) -> dict[str, Any]:
        """Return what goals (G,) tell beyond success; it goes into the step's info."""
        ...


def make_task(name: str) -> Task:
    """Return a task by name.

    Raises:
        ValueError: no such task.
    """
    known: tuple[Task, ...] = (Placement(), DoubleSidedPlacement(), DrawS(), PushLiftBox())
    tasks = {task.name: task for task in known}
    if name not in tasks:
        raise ValueError(f"task must be one of {', '.join(TASKS)}; got {name!r}")
    return tasks[name]
