"""The unadapted primitive: as many and as wide draws of the prior as `smp` has, and no SVGD."""

from __future__ import annotations

import numpy as np

from smp_gym.robot.kinematics import UnreachableError
from smp_planner.agents.posed_scenes import overdraw_of, primitive_of
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.conditioning import conditioned_parts
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.tries import tries
from smp_planner.torch_threads import one_thread

__all__ = ["plan_unadapted"]


def plan_unadapted(task: str, problem: Problem) -> Plan | None:
    """Return the first try of the unadapted primitive with a good draw, else its first try.

    There are as many tries as `smp` has, each with the same prior and as many draws as `smp`
    chooses its particles from in it.

    Args:
        task: whose primitive it is.
        problem: to be solved.

    Returns:
        The plan, its particles the conditioned draws; None if the goal is out of reach.
    """
    planner = primitive_of(task)
    settings, first = planner.plan_settings, None
    with one_thread():
        for particles, width in tries(settings, compete=True):
            draws = overdraw_of(task) * particles
            drawn_from = settings.model_copy(update={"particles": draws})
            try:
                parts = conditioned_parts(planner.prior, problem, drawn_from, width)
            except UnreachableError:
                break
            drawn = [
                part.primitive.trajectory(part.primitive.unwhiten(part.latent), settings.samples)
                for part in parts
            ]
            surprise = [part.surprise for part in parts]
            trajectories = np.concatenate([paths.numpy() for paths in drawn])
            plan = make_plan(problem, trajectories, {"prior": np.concatenate(surprise)}, settings)
            if first is None or plan.good.any():
                first = plan
            if plan.good.any():
                break
    return first
