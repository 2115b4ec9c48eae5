"""Scenes as planning problems, posed by the observation as a policy sees it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import gymnasium

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.scene import Scene
from smp_planner.adaptation import SteinSettings
from smp_planner.planners import make_planner, task_settings
from smp_planner.planners.primitive_planner import PrimitivePlanner
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings, PriorSettings
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = ["environment", "overdraw_of", "posed", "posing_policy", "primitive_of"]


@functools.lru_cache(maxsize=4)
def environment(task: str) -> gymnasium.Env[Any, Any]:
    """Return the environment of this process in which a task's scenes are posed and played."""
    return gymnasium.make(environment_id(task), difficulty="none")


@functools.lru_cache(maxsize=4)
def primitive_of(task: str) -> PrimitivePlanner:
    """Return the unadapted primitive of a task: `smp`'s own prior and settings, without SVGD."""
    known = {*PriorSettings.model_fields, *PlanSettings.model_fields}
    settings = {name: value for name, value in task_settings("smp", task).items() if name in known}
    planner = make_planner("promp", task, settings=settings)
    assert isinstance(planner, PrimitivePlanner)
    return planner


def overdraw_of(task: str) -> int:
    """Return how many draws of the prior `smp` wants for each particle of a task."""
    settings = task_settings("smp", task)
    known = {name: value for name, value in settings.items() if name in SteinSettings.model_fields}
    return SteinSettings.model_validate(known).overdraw


@functools.lru_cache(maxsize=4)
def posing_policy(task: str) -> PlannerPolicy:
    """Return the policy that turns a task's observations into problems and executes plans."""
    from smp_gym.datasets.demonstrations import Demonstrations

    return PlannerPolicy(primitive_of(task), Demonstrations.load(task))


def posed(scenes: Sequence[Scene]) -> list[Problem]:
    """Return the problem that each scene's first observation poses.

    Args:
        scenes: of any tasks.
    """
    problems = []
    for scene in scenes:
        observation, _ = environment(scene.task).reset(options={"scene": scene})
        problems.append(posing_policy(scene.task).problem(observation))
    return problems
