"""Placement: carry the object in the hand to a bin and let it go there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.robot.kinematics import GRASP_CENTER
from smp_gym.scene import BIN_HEIGHT, BIN_INNER_HALF_WIDTH, Goal, Scene
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.goals import GoalCodec, position, resting_place
from smp_gym.tasks.placing import GRASP_FINGER_ANGLES, PLACING_FLAGS, SET_DOWN, PlacingTask
from smp_gym.tasks.status import Status

__all__ = [
    "BIN_LOWER",
    "BIN_UPPER",
    "GRASP_FINGER_ANGLES",
    "HELD_OBJECT_POSE",
    "NOMINAL_BIN",
    "RELEASE_HEIGHT",
    "RELEASE_TILT",
    "RULES",
    "START_CONFIGURATION",
    "Placement",
]

START_CONFIGURATION = (-0.78, 3.53, 0.9813, 0.0568, 2.6632, -0.0361)
"""Joint angles at the start, rad: the object at (0.42, -0.40, 0.26) m, the hand 29 degrees down."""

NOMINAL_BIN = (0.52, 0.32, 0.01)
"""Place of the bin in the demonstrations: centre of its floor's top, m (`Goal.position`)."""

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


def _encode(scene: Scene) -> dict[str, Any]:
    """Return the desired goal: where the object's centre shall rest."""
    return {"object_position": resting_place(scene, 0), **SET_DOWN}


def _decode(desired: Mapping[str, NDArray[np.float64]], size: AnyFloatArray) -> tuple[Goal, ...]:
    x, y, z = desired["object_position"].tolist()
    return (Goal(position=(x, y, z - float(size[2]))),)


_GOALS = GoalCodec((position("object_position"), *PLACING_FLAGS), _encode, _decode)

_HEIGHT_TOLERANCE = 0.05
_POSITION = _GOALS.columns("object_position")
_POSITION_TOLERANCE = np.array([BIN_INNER_HALF_WIDTH, BIN_INNER_HALF_WIDTH, _HEIGHT_TOLERANCE])
assert _HEIGHT_TOLERANCE < BIN_HEIGHT - 0.03


@dataclass(frozen=True)
class Placement(PlacingTask):
    """The task of `smp_gym/Placement-v0`.

    Success: the object's centre is within the bin's inner walls and below the rim, the hand is off
    it, it has come to rest, and nothing has collided in the episode.
    """

    name: str = "Placement"

    support: ClassVar[str] = "bin"
    goal_count: ClassVar[int] = 1
    goals: ClassVar[GoalCodec] = _GOALS
    object_in_hand: ClassVar[AnyFloatArray] = HELD_OBJECT_POSE

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        return {"object_position": status.object_position, **self._flags(status)}

    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals are reached.

        Args:
            achieved: (..., 7) achieved goals.
            desired: (..., 7) desired goals; flags of 1 are demanded.

        Returns:
            (...) whether the position is right to within the bin (8 cm in x and in y, 5 cm in
            height), the demanded flags are up and nothing collided.
        """
        offset = np.abs(achieved[..., _POSITION] - desired[..., _POSITION])
        near = np.asarray((offset <= _POSITION_TOLERANCE).all(axis=-1))
        # Most of an episode is far from its goal.
        return np.asarray(near & self._let_go(achieved, desired)) if near.any() else near

    def potential(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> AnyFloatArray:
        """Return minus the object's distance from its place, (...), 2 per metre."""
        offset = achieved[..., _POSITION] - desired[..., _POSITION]
        return -POTENTIAL_PER_METRE * np.linalg.norm(offset, axis=-1)


RULES = Placement()
