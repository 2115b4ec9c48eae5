"""Rules common to tasks that set an object down: checks of scenes, contacts, flags of the goals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.scene import Scene
from smp_gym.tasks.common import CommonRules
from smp_gym.tasks.goals import Field, flag
from smp_gym.tasks.status import Status

__all__ = ["GRASP_FINGER_ANGLES", "PLACING_FLAGS", "SET_DOWN", "PlacingTask"]

GRASP_FINGER_ANGLES = (0.97, 0.97, 0.0, 0.0)
"""Angles of the fingers that hold the default object (proximal 1, 2, tip 1, 2), rad."""

PLACING_FLAGS: tuple[Field, ...] = (
    flag("collided"),
    flag("released"),
    flag("at_rest"),
    flag("supported"),
)
"""Flags of the goals of tasks that set an object down, the last fields of their goal vectors."""

SET_DOWN = {"collided": 0.0, "released": 1.0, "at_rest": 1.0, "supported": 1.0}
"""Values of these flags in the desired goal."""

_CONTACTS_HELD = frozenset({("hand", "hand"), ("hand", "object")})


@dataclass(frozen=True)
class PlacingTask(CommonRules, ABC):
    """A task that begins with the object in the hand and ends with it at rest somewhere.

    The held object may touch nothing but the hand. Once let go and come to rest it has been placed,
    which ends the episode: where it should be with success, anywhere else with the penalty of a
    collision. Without the penalty dropping would be an escape. Let go, the object is nowhere a
    success but on a support, whatever goal is desired: otherwise an agent that learns from
    hindsight would find that letting go at once always reaches some goal.
    """

    support: ClassVar[str]
    """Group of the bodies on which the object may rest, which is also the kind of the goals."""

    goal_count: ClassVar[int]
    """Number of goals of a scene."""

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        super().check_scene(scene)
        if scene.manipulated is None:
            raise ValueError("scene.manipulated must be an object to place, got None")
        if len(scene.goals) != self.goal_count:
            number = {1: "one", 2: "two"}[self.goal_count]
            plural = "" if self.goal_count == 1 else "s"
            raise ValueError(
                f"scene.goals must hold {number} {self.support}{plural}, "
                f"got {len(scene.goals)} goals"
            )
        kinds = [goal.kind for goal in scene.goals if goal.kind != self.support]
        if kinds:
            raise ValueError(f"scene.goals must be of kind {self.support!r}, got {kinds[0]!r}")

    def supports(self, scene: Scene) -> tuple[tuple[float, float, float], ...]:
        """Return the places of the bin or the pads."""
        return tuple(goal.position for goal in scene.goals)

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch; see `Task.permitted_contacts`."""
        if held:
            return _CONTACTS_HELD
        support = ("bin", "object") if self.support == "bin" else ("object", self.support)
        return _CONTACTS_HELD | {support, ("object", "table")}

    def failure(self, status: Status) -> str:
        """Return "dropped" when the object, no longer held, touches the table.

        Landing on a thin support it may come as deep as the table for a moment.
        """
        touched = status.object_contacts
        dropped = not status.held and "table" in touched and self.support not in touched
        return "dropped" if dropped else ""

    @abstractmethod
    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) are reached, (...)."""

    def lost(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return a mask (...) of goals (..., G) with the object let go and at rest elsewhere."""
        released, at_rest = self._flag("released"), self._flag("at_rest")
        placed = (achieved[..., released] > 0.5) & (achieved[..., at_rest] > 0.5)
        if not placed.any():
            return np.asarray(placed)
        return np.asarray(placed & ~self.success(achieved, desired))

    def demands_all(self, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) demand that the object be let go, (...)."""
        return np.asarray(desired[..., self._flag("released")] > 0.5)

    def _flags(self, status: Status) -> dict[str, float]:
        """Return the flags of the achieved goal by field name."""
        return {
            "collided": float(status.collided),
            "released": float("hand" not in status.object_contacts),
            "at_rest": float(status.at_rest),
            "supported": float(self.support in status.object_contacts),
        }

    def _let_go(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether the demanded flags are up, nothing collided and nothing was dropped."""
        released, at_rest = self._flag("released"), self._flag("at_rest")
        up = achieved[..., released] >= desired[..., released]
        still = achieved[..., at_rest] >= desired[..., at_rest]
        supported = achieved[..., self._flag("supported")]
        there = supported >= desired[..., self._flag("supported")]
        dropped = (achieved[..., released] > 0.5) & (supported <= 0.5)
        return np.asarray(up & still & there & ~dropped & ~self.collided(achieved))
