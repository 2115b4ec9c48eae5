"""`promp`: the primitive conditioned on start and goal, but not adapted. The control."""

from __future__ import annotations

from smp_planner.planners.base import PlannerModel, Stopwatch, jaco_with
from smp_planner.planning.problem import Plan, Problem

__all__ = ["ProMPPlanner"]


class ProMPPlanner(PlannerModel):
    """Draws from the conditioned primitive (Sec. III-A), the best of which is executed."""

    name = "promp"

    def _plan(self, problem: Problem) -> Plan:
        stopwatch = Stopwatch()
        with stopwatch.stage("conditioning"):
            robot = jaco_with(problem)
            particles = self.draw(problem, robot)
        return self.plan_of(problem, robot, particles, {}, stopwatch)
