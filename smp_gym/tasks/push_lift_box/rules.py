"""PushLiftBox: push a box with the palm, close the fingers on it and lift it to a point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.scene import Goal, ManipulatedObject, Scene
from smp_gym.tasks.common import POTENTIAL_PER_METRE, CommonRules
from smp_gym.tasks.goals import GoalCodec, flag, position
from smp_gym.tasks.status import Status

__all__ = [
    "BOX_BEARING",
    "BOX_RADIUS",
    "BOX_TURN",
    "HAND_HEIGHT",
    "HAND_TILT",
    "HELD_OBJECT_POSE",
    "OBJECT_BEHIND",
    "PUSH_FROM",
    "PUSH_LENGTH",
    "RULES",
    "START_CONFIGURATION",
    "START_SPREAD",
    "TARGET_BEARING",
    "TARGET_HEIGHT",
    "TARGET_RADIUS",
    "TARGET_TOLERANCE",
    "PushLiftBox",
    "push_poses",
]

HAND_HEIGHT = 0.045
"""Height of the end effector above the table while it pushes, m."""

HAND_TILT = float(np.radians(20.0))
"""Angle of the approach direction below the horizontal while it pushes, rad."""

TARGET_TOLERANCE = 0.03
"""Distance of the box's centre from its target up to which it is there, m."""

OBJECT_BEHIND = 0.0116
"""Horizontal distance of the box's centre behind the end effector while the palm pushes it, m."""


PUSH_FROM = 0.075
"""Horizontal distance of the end effector behind the box's centre when the push begins, m."""

PUSH_LENGTH = 0.06
"""Length of the push, m."""

START_CONFIGURATION = (-0.522, 3.426, 0.568, 0.056, 2.204, -0.017)
START_SPREAD = (0.25, 0.12, 0.15, 0.1, 0.15, 0.1)
"""Middle and half widths of the region of joint angles in which episodes start, rad."""

BOX_RADIUS = (0.47, 0.55)
BOX_BEARING = (-0.5, 0.0)
BOX_TURN = 0.15
"""Region in which the box stands: distance from the base's axis (m), bearing as seen from there
(rad), and largest turn of the box away from that bearing (rad)."""

TARGET_RADIUS = (0.42, 0.52)
TARGET_BEARING = (0.35, 0.75)
TARGET_HEIGHT = (0.26, 0.38)
"""Region of the target: distance from the base's axis (m), bearing (rad), height (m)."""

HELD_OBJECT_POSE = np.eye(4)
"""(4, 4) nominal pose of the box in the end-effector frame, once the fingers have closed on it: the
palm against it, and upright when the hand is tilted by `HAND_TILT`."""
HELD_OBJECT_POSE[:3, :3] = [
    [np.cos(HAND_TILT), 0.0, -np.sin(HAND_TILT)],
    [0.0, 1.0, 0.0],
    [np.sin(HAND_TILT), 0.0, np.cos(HAND_TILT)],
]
HELD_OBJECT_POSE[:3, 3] = HELD_OBJECT_POSE[:3, :3] @ (
    -OBJECT_BEHIND,
    0.0,
    ManipulatedObject().size[2] - HAND_HEIGHT,
)
HELD_OBJECT_POSE.setflags(write=False)


def _encode(scene: Scene) -> dict[str, Any]:
    """Return the desired goal: where the box's centre shall be, in the hand."""
    return {"object_position": scene.goals[0].position, "collided": 0.0, "held": 1.0}


def _decode(desired: Mapping[str, NDArray[np.float64]], size: AnyFloatArray) -> tuple[Goal, ...]:
    x, y, z = desired["object_position"].tolist()
    return (Goal(kind="lift", position=(x, y, z)),)


_GOALS = GoalCodec((position("object_position"), flag("collided"), flag("held")), _encode, _decode)

_POSITION = _GOALS.columns("object_position")
_HELD = _GOALS.columns("held").start

_CONTACTS = frozenset({("hand", "hand"), ("hand", "object"), ("object", "table")})


def push_poses(position: AnyFloatArray, yaw: float, shares: AnyFloatArray) -> AnyFloatArray:
    """Return the end-effector poses (N, 4, 4) of a straight push along the box's own x axis.

    Args:
        position: (3,) m, the box's centre before the push.
        yaw: of the box, rad.
        shares: (N,) of the distance: 0 behind the box, 1 at the end of the push.
    """
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    aside = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    approach = np.cos(HAND_TILT) * ahead - np.array([0.0, 0.0, np.sin(HAND_TILT)])
    travelled = np.asarray(shares) * (PUSH_FROM + OBJECT_BEHIND + PUSH_LENGTH) - PUSH_FROM
    poses = np.tile(np.eye(4), (len(travelled), 1, 1))
    poses[:, :3, :3] = np.stack([approach, aside, np.cross(approach, aside)], axis=1)
    poses[:, :2, 3] = np.asarray(position)[:2] + travelled[:, None] * ahead[:2]
    poses[:, 2, 3] = HAND_HEIGHT
    return poses


@dataclass(frozen=True)
class PushLiftBox(CommonRules):
    """The task of `smp_gym/PushLiftBox-v0`.

    Success: the box's centre is within `TARGET_TOLERANCE` of the target, the hand grips it, and
    nothing has collided in the episode. The hand may touch the box as it likes, and the box the
    table; the hand may not touch the table.
    """

    name: str = "PushLiftBox"

    goals: ClassVar[GoalCodec] = _GOALS
    object_in_hand: ClassVar[AnyFloatArray] = HELD_OBJECT_POSE

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        super().check_scene(scene)
        if scene.manipulated is None or scene.manipulated.position is None:
            raise ValueError(
                "scene.manipulated must be a box with a position on the table, got "
                f"{scene.manipulated!r}"
            )
        height, half = scene.manipulated.position[2], scene.manipulated.size[2]
        if abs(height - half) > 1e-6:
            raise ValueError(
                f"scene.manipulated.position must be {half} m above the table, half the box's "
                f"height; got {height}"
            )
        if len(scene.goals) != 1 or scene.goals[0].kind != "lift":
            kinds = [goal.kind for goal in scene.goals]
            raise ValueError(f"scene.goals must hold one goal of kind 'lift', got {kinds}")
        if scene.goals[0].position[2] < half + TARGET_TOLERANCE:
            raise ValueError(
                f"the target must be at least {half + TARGET_TOLERANCE} m above the table, so that "
                f"the box must be lifted; got {scene.goals[0].position[2]}"
            )

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch; see `Task.permitted_contacts`."""
        return _CONTACTS

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        return {
            "object_position": status.object_position,
            "collided": float(status.collided),
            "held": float(status.held),
        }

    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., 5) are reached, (...)."""
        offset = achieved[..., _POSITION] - desired[..., _POSITION]
        near: BoolArray = np.sqrt((offset * offset).sum(axis=-1)) <= TARGET_TOLERANCE
        held = achieved[..., _HELD] >= desired[..., _HELD]
        return np.asarray(near & held & ~self.collided(achieved))

    def demands_all(self, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., 5) demand that the box be held, (...)."""
        return np.asarray(desired[..., _HELD] > 0.5)

    def potential(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> AnyFloatArray:
        """Return minus the box's distance from its target, (...), 2 per metre."""
        offset = achieved[..., _POSITION] - desired[..., _POSITION]
        return np.asarray(-POTENTIAL_PER_METRE * np.linalg.norm(offset, axis=-1))


RULES = PushLiftBox()
