"""The state of the world that a task judges after each environment step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["CALM_SPEED", "CALM_STEPS", "Status"]

CALM_SPEED = 0.01
"""m/s below which the object counts as standing still."""

CALM_STEPS = 5
"""Environment steps that the object must stand still, hand clear of it, to be at rest."""


@dataclass(frozen=True)
class Status:
    """Facts at the end of an environment step.

    Attributes:
        object_position: (3,) m, centre of the object, or the pen's tip.
        object_contacts: groups that touch the object; see `Task.permitted_contacts`.
        held: whether the hand grips the object: touches it, not yet opened for release.
        calm_steps: how many steps in a row the object has been slower than `CALM_SPEED` with
            the hand clear of it.
        collided: whether a forbidden contact has happened in this episode.
        trace: (M, 3) m, where the pen's tip was at the start and after each environment step.
    """

    object_position: NDArray[np.float64]
    object_contacts: frozenset[str]
    held: bool
    calm_steps: int
    collided: bool
    trace: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def at_rest(self) -> bool:
        """True if the object lies still with the hand clear of it."""
        return self.calm_steps >= CALM_STEPS
