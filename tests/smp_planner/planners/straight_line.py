"""A planner of one's own: a straight line in joint space to where the demonstrations end."""

from collections.abc import Sequence

import numpy as np

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import end_effector_pose, inverse_kinematics
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings


class StraightLine:
    """Moves all joints at once; disregards obstacles."""

    def __init__(self, demonstrations: Demonstrations, samples: int = 100) -> None:
        self.end = demonstrations.configurations[:, -1].mean(axis=0)
        self.samples = samples

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        return [self._line(problem) for problem in problems]

    def _line(self, problem: Problem) -> Plan:
        goal, rotation = problem.goals[0], end_effector_pose(self.end)[:3, :3]
        end = inverse_kinematics(goal.center - rotation @ goal.point, rotation, seed=self.end)
        line = np.linspace(problem.start, end, self.samples)[None]
        length = np.linalg.norm(end - problem.start, keepdims=True)
        return make_plan(problem, line, {"length": length}, PlanSettings())
