"""Rules of ReachPoint: success is the tip within 3 cm of the point."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smp_gym.robot.pen import PEN_POSE
from smp_gym.scene import Goal
from smp_gym.tasks.common import POTENTIAL_PER_METRE, CommonRules
from smp_gym.tasks.goals import GoalCodec, flag, position

GOALS = GoalCodec(
    layout=(position("tip"), flag("collided")),
    encode=lambda scene: {"tip": scene.goals[0].position, "collided": 0.0},
    decode=lambda desired, size: (Goal(kind="point", position=tuple(desired["tip"].tolist())),),
    with_object=False,
)


@dataclass(frozen=True)
class ReachPoint(CommonRules):
    name: str = "ReachPoint"
    goals: ClassVar[GoalCodec] = GOALS
    object_in_hand: ClassVar = PEN_POSE

    def permitted_contacts(self, held):
        return frozenset({("hand", "hand")})

    def achieved_goal(self, status):
        return {"tip": status.object_position, "collided": float(status.collided)}

    def success(self, achieved, desired):
        return (self._distance(achieved, desired) < 0.03) & ~self.collided(achieved)

    def potential(self, achieved, desired):
        return -POTENTIAL_PER_METRE * self._distance(achieved, desired)

    def _distance(self, achieved, desired):
        return np.linalg.norm((achieved - desired)[..., GOALS.columns("tip")], axis=-1)


RULES = ReachPoint()
