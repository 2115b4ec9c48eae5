"""The controls of a list of scenes: which scenes each solves, and in how many iterations."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.robot.kinematics import UnreachableError
from smp_gym.rollout import rollout
from smp_gym.scene import Scene
from smp_planner.agents.acting import RandomActions
from smp_planner.agents.posed_scenes import environment, posed, posing_policy
from smp_planner.experiments.controls.detour import (
    Detour,
    conditioned_course,
    detours_free,
)
from smp_planner.experiments.controls.unadapted import plan_unadapted
from smp_planner.planners import ConfiguredPlanner, make_planner
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.bumps import BumpedMean
from smp_planner.planning.plan import Plan
from smp_planner.planning.settings import PlanSettings

__all__ = [
    "Outcome",
    "detour_outcomes",
    "random_outcomes",
    "search_iterations",
    "unadapted_outcomes",
]

SEARCH_ITERATIONS = 20_000
"""Iterations after which a tree search is given up."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a control in a scene.

    Attributes:
        solved: by the planners' exact check of trajectories; None where there is no trajectory.
        executed: with success in the physics; None if it was not executed.
        iterations: of the tree search, all its segments together; None of other controls.
    """

    solved: bool | None = None
    executed: bool | None = None
    iterations: int | None = None


def _succeeds(scene: Scene, plan: Plan) -> bool:
    track = posing_policy(scene.task).track(plan, plan.chosen)
    return bool(rollout(environment(scene.task), track, scene=scene).success)


def detour_outcomes(
    scenes: Sequence[Scene], detour: Detour, *, physics: bool = False
) -> list[Outcome]:
    """Return how a fixed detour fares in each scene.

    Args:
        scenes: of one task, other than those that it was learned on.
        detour: from `learn_detour`.
        physics: whether to execute it, too.
    """
    outcomes = []
    for scene, problem in zip(scenes, posed(scenes), strict=True):
        course = conditioned_course(scene.task, problem, detour.component)
        numbers = detour.numbers[None]
        solved = bool(detours_free([course], numbers, scene.task)[0, 0])
        executed = None
        if physics:
            executed = course is not None and _succeeds(scene, _plan_of(course, detour))
        outcomes.append(Outcome(solved, executed))
    return outcomes


def _plan_of(course: BumpedMean, detour: Detour) -> Plan:
    trajectories = course.trajectories(detour.numbers[None])
    return make_plan(course.problem, trajectories, {"prior": np.zeros(1)}, PlanSettings())


def unadapted_outcomes(scenes: Sequence[Scene], *, physics: bool = False) -> list[Outcome]:
    """Return whether the unadapted primitive has a good draw in each scene.

    Args:
        scenes: of any tasks.
        physics: whether to execute the best draw, too.
    """
    outcomes = []
    for scene, problem in zip(scenes, posed(scenes), strict=True):
        plan = plan_unadapted(scene.task, problem)
        executed = (plan is not None and _succeeds(scene, plan)) if physics else None
        outcomes.append(Outcome(plan is not None and bool(plan.good.any()), executed))
    return outcomes


@functools.lru_cache(maxsize=8)
def _search(task: str, iterations: int) -> ConfiguredPlanner:
    return make_planner(
        "rrt_connect", task, settings={"particles": 1, "iterations": iterations, "shortcuts": 0}
    )


def search_iterations(
    scenes: Sequence[Scene], iterations: int = SEARCH_ITERATIONS
) -> list[Outcome]:
    """Return the iterations of a single RRT-Connect search in each scene, until its first path.

    An iteration is a step of one tree and the reach of the other for it, as MotionBenchMaker's
    tables count them. Of a task with several segments they are the sum over these; segments that a
    straight edge joins count nothing. A search that fails has all the iterations that it took.

    Args:
        scenes: of any tasks.
        iterations: of a tree search, at most.
    """
    outcomes = []
    for scene, problem in zip(scenes, posed(scenes), strict=True):
        try:
            (plan,) = _search(scene.task, iterations).plan([problem])
        except UnreachableError:
            outcomes.append(Outcome(False, iterations=iterations))
            continue
        found = bool(plan.collision_free[0] and plan.passing[0])
        outcomes.append(Outcome(found, iterations=int(plan.costs["iterations"][0])))
    return outcomes


def random_outcomes(scenes: Sequence[Scene]) -> list[Outcome]:
    """Return whether uniform random actions solve each scene, in the physics.

    Args:
        scenes: of any tasks.
    """
    return [
        Outcome(executed=rollout(environment(scene.task), RandomActions(), scene=scene).success)
        for scene in scenes
    ]
