"""DoubleSidedPlacement: carry the object in the hand to either of two pads and set it down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.robot.kinematics import GRASP_CENTER
from smp_gym.scene import PAD_DEPTH, PAD_HALF_WIDTH, Goal, Scene
from smp_gym.tasks.common import POTENTIAL_PER_METRE
from smp_gym.tasks.goals import GoalCodec, position, resting_place
from smp_gym.tasks.placing import PLACING_FLAGS, SET_DOWN, PlacingTask
from smp_gym.tasks.status import Status

__all__ = [
    "HELD_OBJECT_POSE",
    "NOMINAL_PADS",
    "PAD_LOWEST",
    "PAD_SHIFT",
    "PAD_TOP",
    "RELEASE_GAP",
    "RULES",
    "SIDES",
    "START_CONFIGURATION",
    "TILT",
    "DoubleSidedPlacement",
]

SIDES = ("left", "right")
"""Left is where y is positive; goals stand in this order."""

START_CONFIGURATION = (-1.5293, 3.192, 0.8179, 0.0969, 2.7375, -0.0728)
"""Joint angles at the start, rad: the object at (0.50, 0, 0.35) m, upright, midway between the
sides."""

NOMINAL_PADS = ((0.42, 0.44, 0.085), (0.42, -0.44, 0.085))
"""Places of the pads in the demonstrations: centre of their surfaces, m (`Goal.position`)."""

PAD_SHIFT = 0.15
"""Radius of the discs around `NOMINAL_PADS` in which an episode's pads stand, m."""

PAD_LOWEST = 0.02
PAD_TOP = 0.15
"""Range of the pads' heights, m."""

TILT = 0.4
"""Angle of the approach direction below the horizontal at start and release, rad. The object is
held so that it stands upright then: it is let go just above the pad and must not tip over."""

RELEASE_GAP = 0.022
"""Gap between object and pad when it is let go, m; the spheres that cover it then clear the pad by
a centimetre."""

HELD_OBJECT_POSE = np.eye(4)
"""(4, 4) nominal pose of the held object in the end-effector frame."""
HELD_OBJECT_POSE[:3, :3] = [
    [np.cos(TILT), 0.0, -np.sin(TILT)],
    [0.0, 1.0, 0.0],
    [np.sin(TILT), 0.0, np.cos(TILT)],
]
HELD_OBJECT_POSE[:3, 3] = GRASP_CENTER
HELD_OBJECT_POSE.setflags(write=False)

_FIELDS = tuple(f"object_position_{side}" for side in SIDES)


def _encode(scene: Scene) -> dict[str, Any]:
    """Return the desired goal: where the object's centre shall rest on either pad."""
    places = {name: resting_place(scene, number) for number, name in enumerate(_FIELDS)}
    return {**places, **SET_DOWN}


def _decode(desired: Mapping[str, NDArray[np.float64]], size: AnyFloatArray) -> tuple[Goal, ...]:
    places = (desired[name].tolist() for name in _FIELDS)
    return tuple(Goal(kind="pad", position=(x, y, z - float(size[2]))) for x, y, z in places)


_GOALS = GoalCodec((*map(position, _FIELDS), *PLACING_FLAGS), _encode, _decode)

_HEIGHT_TOLERANCE = 0.015
_POSITION_TOLERANCE = np.array([PAD_HALF_WIDTH, PAD_HALF_WIDTH, _HEIGHT_TOLERANCE])
_POSITIONS = tuple(map(_GOALS.columns, _FIELDS))
assert _HEIGHT_TOLERANCE < PAD_LOWEST


@dataclass(frozen=True)
class DoubleSidedPlacement(PlacingTask):
    """The task of `smp_gym/DoubleSidedPlacement-v0`.

    Success: the object's centre is over one of the pads, as high as if it lay there, the hand is
    off it, it has come to rest, and nothing has collided in the episode.
    """

    name: str = "DoubleSidedPlacement"

    support: ClassVar[str] = "pad"
    goal_count: ClassVar[int] = 2
    goals: ClassVar[GoalCodec] = _GOALS
    object_in_hand: ClassVar[AnyFloatArray] = HELD_OBJECT_POSE

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        super().check_scene(scene)
        for side, goal in zip(SIDES, scene.goals, strict=True):
            height = goal.position[2]
            if not 0.0 < height <= PAD_DEPTH:
                raise ValueError(
                    f"the surface of a pad must be higher than 0 and at most {PAD_DEPTH} m, got "
                    f"{height} on the {side}"
                )
        left, right = (np.array(goal.position) for goal in scene.goals)
        if np.abs(left - right)[:2].max() <= 2.0 * PAD_HALF_WIDTH or left[1] < right[1]:
            raise ValueError(
                "scene.goals must be the left pad (greater y) and the right one, apart from each "
                f"other, got {left.tolist()} and {right.tolist()}"
            )

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name: the object is where it is, twice.

        The desired goal has its place on the left and on the right pad in these two fields.
        """
        return {**dict.fromkeys(_FIELDS, status.object_position), **self._flags(status)}

    def reached(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return a mask over `SIDES` of reached goals.

        Args:
            achieved: (..., 10) achieved goals.
            desired: (..., 10) desired goals; flags of 1 are demanded.

        Returns:
            (..., 2) whether the position is right (within the pad's square in x and y, to 1.5 cm in
            height), the demanded flags are up and nothing collided.
        """
        near = [
            (np.abs(achieved[..., at] - desired[..., at]) <= _POSITION_TOLERANCE).all(axis=-1)
            for at in _POSITIONS
        ]
        there = np.stack(near, axis=-1)
        # Most of an episode is far from its goals.
        return there & self._let_go(achieved, desired)[..., None] if there.any() else there

    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., 10) are reached on either side, (...)."""
        return np.asarray(self.reached(achieved, desired).any(axis=-1))

    def potential(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> AnyFloatArray:
        """Return minus the object's distance from the nearer of its places, 2 per metre."""
        distances = [
            np.linalg.norm(achieved[..., at] - desired[..., at], axis=-1) for at in _POSITIONS
        ]
        return -POTENTIAL_PER_METRE * np.minimum(*distances)

    def details(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> dict[str, Any]:
        """Return ``side``: "left" or "right", the pad of the object, or "" if it is on neither."""
        reached = self.reached(achieved, desired)
        return {"side": SIDES[int(reached.argmax())] if reached.any() else ""}


RULES = DoubleSidedPlacement()
