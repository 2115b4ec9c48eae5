"""Placement: carry the object in the hand to a bin and let it go there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.kinematics import GRASP_CENTER, JOINT_LOWER, JOINT_UPPER
from smp_gym.observation import GOAL_LAYOUTS
from smp_gym.scene import BIN_HEIGHT, BIN_INNER_HALF_WIDTH, Scene
from smp_gym.tasks.status import Status

__all__ = [
    "BIN_LOWER",
    "BIN_UPPER",
    "GRASP_FINGER_ANGLES",
    "HELD_OBJECT_POSE",
    "NOMINAL_BIN",
    "RELEASE_HEIGHT",
    "RELEASE_TILT",
    "START_CONFIGURATION",
    "Placement",
]

FloatArray = NDArray[np.floating[Any]]
BoolArray = NDArray[np.bool_]

START_CONFIGURATION = (-0.78, 3.53, 0.9813, 0.0568, 2.6632, -0.0361)
"""Joint angles at the start, rad: the object at (0.42, -0.40, 0.26) m, the hand 29 degrees down."""

NOMINAL_BIN = (0.52, 0.32, 0.01)
"""Where the demonstrations find the bin: centre of its floor's top, m (`Goal.position`)."""

BIN_LOWER = (0.44, 0.22, 0.01)
BIN_UPPER = (0.60, 0.42, 0.01)
"""Corners of the region from which an episode's `Goal.position` is drawn, m."""

RELEASE_TILT = 0.5
"""Angle of the approach direction below the horizontal at release, rad: away from the wrist's
singularity, which a steeper hand meets over the bin."""

RELEASE_HEIGHT = 0.17
"""Height of the object's centre above `Goal.position` at release, m: it then clears the rim by
3 cm, tilted as it is."""

HELD_OBJECT_POSE = np.eye(4)
"""(4, 4) nominal pose of the held object in the end-effector frame."""
HELD_OBJECT_POSE[:3, 3] = GRASP_CENTER
HELD_OBJECT_POSE.setflags(write=False)

GRASP_FINGER_ANGLES = (0.97, 0.97, 0.0, 0.0)
"""Angles of the fingers that hold the default object (proximal 1, 2, tip 1, 2), rad."""

_POTENTIAL_PER_METRE = 100.0
_HEIGHT_TOLERANCE = 0.05


def _columns(name: str) -> slice:
    start = 0
    for field in GOAL_LAYOUTS["Placement"]:
        if field.name == name:
            return slice(start, start + field.size)
        start += field.size
    raise KeyError(name)


_POSITION = _columns("object_position")
_COLLIDED = _columns("collided").start
_RELEASED = _columns("released").start
_AT_REST = _columns("at_rest").start


@dataclass(frozen=True)
class Placement:
    """The task of `smp_gym/Placement-v0`.

    Success: the object's centre is within the bin's inner walls and below the rim, the hand is off
    it, it has come to rest, and nothing collided on the way. The held object may touch nothing but
    the hand. Once let go and come to rest it has been placed, which ends the episode: in the bin
    with success, anywhere else with the penalty of a collision. Without the penalty dropping would
    be a way out; without the end an agent that learns from hindsight finds that letting go at once
    always reaches some goal, and hardly ever that it misses the desired one.
    """

    name: str = "Placement"
    version: int = 0

    @property
    def object_in_hand(self) -> FloatArray:
        """(4, 4) pose of the object in the end-effector frame at the start."""
        return HELD_OBJECT_POSE

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        if scene.task != self.name:
            raise ValueError(f"scene.task must be {self.name!r}, got {scene.task!r}")
        if scene.manipulated is None:
            raise ValueError("scene.manipulated must be an object to place, got None")
        if len(scene.goals) != 1:
            raise ValueError(f"scene.goals must hold one bin, got {len(scene.goals)} goals")
        moving = [i for i, o in enumerate(scene.obstacles) if any(o.velocity)]
        if moving:
            raise ValueError(
                f"obstacles must stand still (velocity 0); moving are those numbered {moving}"
            )
        start = np.array(scene.start)
        if not ((start >= JOINT_LOWER) & (start <= JOINT_UPPER)).all():
            raise ValueError(
                f"scene.start must lie between {JOINT_LOWER.round(4).tolist()} and "
                f"{JOINT_UPPER.round(4).tolist()} rad, got {start.tolist()}"
            )

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch; see `Task.permitted_contacts`."""
        return _CONTACTS_HELD if held else _CONTACTS_RELEASED

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        return {
            "object_position": status.object_position,
            "collided": float(status.collided),
            "released": float("hand" not in status.object_contacts),
            "at_rest": float(status.at_rest),
        }

    def failure(self, status: Status) -> str:
        """Return "dropped" when the object, no longer held, touches the table."""
        return "dropped" if not status.held and "table" in status.object_contacts else ""

    def success(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Return whether goals are reached.

        Args:
            achieved: (..., 6) achieved goals.
            desired: (..., 6) desired goals; flags of 1 are demanded.

        Returns:
            (...) whether the position is right to within the bin (8 cm in x and in y, 5 cm in
            height), the demanded flags are up and nothing collided.
        """
        offset = np.abs(achieved[..., _POSITION] - desired[..., _POSITION])
        near = (offset <= _TOLERANCE).all(axis=-1)
        released = achieved[..., _RELEASED] >= desired[..., _RELEASED]
        at_rest = achieved[..., _AT_REST] >= desired[..., _AT_REST]
        return near & released & at_rest & ~self.collided(achieved)

    def collided(self, achieved: FloatArray) -> BoolArray:
        """Return whether goals (..., 6) tell of a collision, (...)."""
        return achieved[..., _COLLIDED] > 0.5

    def lost(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Return whether goals (..., 6) tell of an object let go and at rest elsewhere, (...)."""
        placed = (achieved[..., _RELEASED] > 0.5) & (achieved[..., _AT_REST] > 0.5)
        return placed & ~self.success(achieved, desired)

    def potential(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return minus the object's distance from its place, (...), 100 per metre."""
        offset = achieved[..., _POSITION] - desired[..., _POSITION]
        return -_POTENTIAL_PER_METRE * np.linalg.norm(offset, axis=-1)


_CONTACTS_HELD = frozenset({("hand", "hand"), ("hand", "object")})
_CONTACTS_RELEASED = _CONTACTS_HELD | {("bin", "object"), ("object", "table")}
_TOLERANCE = np.array([BIN_INNER_HALF_WIDTH, BIN_INNER_HALF_WIDTH, _HEIGHT_TOLERANCE])
assert _HEIGHT_TOLERANCE < BIN_HEIGHT - 0.03
