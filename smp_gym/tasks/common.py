"""What all tasks share: checks of scenes, the scale of the dense reward."""

from __future__ import annotations

import numpy as np

from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, REACH, SHOULDER_HEIGHT
from smp_gym.scene import Scene

__all__ = ["POTENTIAL_PER_METRE", "check_playable"]

POTENTIAL_PER_METRE = 20.0
"""By how much the dense reward's potential rises on the way to the goal. The end of an episode, by
failure too, forgives the way that is left: 2 m of it must count for much less than a failure."""


def check_playable(scene: Scene) -> None:
    """Raise ValueError if an obstacle moves, or start or goals are out of the arm's reach."""
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
    for number, goal in enumerate(scene.goals):
        for x, y, z in (goal.position, *goal.checkpoints):
            # What is let go over a goal falls straight down to it.
            if not (np.hypot(x, y) <= REACH and 0.0 <= z <= SHOULDER_HEIGHT + REACH):
                raise ValueError(
                    f"scene.goals[{number}] must lie within {REACH:.2f} m of the base's axis, 0 to "
                    f"{SHOULDER_HEIGHT + REACH:.2f} m above the table, got {[x, y, z]} m"
                )
