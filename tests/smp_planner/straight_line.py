"""A planner of one's own: a straight line in joint space to where the demonstrations end."""

from collections.abc import Sequence

import numpy as np

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import end_effector_pose, inverse_kinematics
from smp_planner.collision.robot_model import jaco_model
from smp_planner.collision.verification import verify
from smp_planner.planning.problem import Plan, Problem


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
        verdict = verify(line, jaco_model(problem.attached), problem.obstacles, 15.0)
        return Plan(
            weights=np.empty((1, 0, 6)),
            trajectories=line,
            costs={},
            collision_free=verdict.collision_free,
            clearance=verdict.clearance,
            goal_error=np.zeros(1),
            duration=verdict.duration,
            executable=verdict.executable,
            chosen=0,
        )
