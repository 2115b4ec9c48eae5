"""The planners of OMPL (Şucan et al. 2012) in joint space, as oracles of what can be solved.

They take the place of RRT-Connect in `smp_planner.planners.rrt_connect`: the same goals, stretches,
collision check, shortcuts and smoothing. BIT* (Gammell et al. 2015) and RRT* (Karaman & Frazzoli
2011) improve their path for as long as they may; here the first one ends the search. OMPL is
imported when a planner is made (``pip install "smp-gym[ompl]"``). As a method of the benchmark,
``ompl=smp_planner.planners.ompl_search:OMPLPlanner``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from pydantic import Field

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.optional_packages import require
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.planners.rrt_connect.planner import SearchPlanner, SearchSettings
from smp_planner.planners.rrt_connect.tree_search import search_box

__all__ = ["OMPLPlanner", "OMPLSettings", "ompl_is_installed", "ompl_path"]

Algorithm = Literal["BITstar", "RRTConnect", "RRTstar"]


class OMPLSettings(SearchSettings):
    """Settings of OMPL's planners, beside those of `SearchSettings`.

    Attributes:
        algorithm: name of the planner's class in OMPL.
        seconds: for which one search lasts at most, by the clock.
        step: rad, longest edge; of RRT* and RRT-Connect only.
    """

    particles: int = Field(default=1, ge=1)
    algorithm: Algorithm = "BITstar"
    seconds: float = Field(default=60.0, gt=0.0, allow_inf_nan=False)
    step: float = Field(default=0.5, gt=0.0, allow_inf_nan=False)


def ompl_is_installed() -> bool:
    """Return whether OMPL can be imported."""
    return find_spec("ompl") is not None


def _configuration(state: Any, joints: int) -> FloatArray:
    return np.array([[state[i] for i in range(joints)]])


def ompl_path(
    start: FloatArray,
    goals: FloatArray,
    checker: EdgeChecker,
    rng: np.random.Generator,
    *,
    algorithm: Algorithm = "BITstar",
    seconds: float = 60.0,
    step: float = 0.5,
) -> FloatArray | None:
    """Return a path from a configuration to one of several others, or None if none was found.

    Args:
        start: (n,) rad.
        goals: (G,n) rad; those that are not free are passed over.
        checker: says what is free.
        rng: not used: OMPL draws its own random numbers, and paths differ from call to call.
        algorithm: see `OMPLSettings`, as the next two.
        seconds: see there.
        step: see there.

    Returns:
        (V,n) rad, its edges free.

    Raises:
        ModuleNotFoundError: OMPL is not installed.
    """
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    robot, joints = checker.robot, checker.robot.joints
    ends = goals[checker.configurations_free(goals)]
    if not len(ends) or not checker.configurations_free(start[None])[0]:
        return None

    class Edges(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any, last_valid: Any = None) -> bool:  # noqa: N802
            pair = _configuration(first, joints), _configuration(second, joints)
            return bool(checker.edges_free(*pair)[0])

    space = base.RealVectorStateSpace(joints)
    bounds = base.RealVectorBounds(joints)
    for i, (low, high) in enumerate(zip(*search_box(robot, start), strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(
        lambda state: bool(checker.configurations_free(_configuration(state, joints))[0])
    )
    edges = Edges(information)
    information.setMotionValidator(edges)
    information.setup()

    def state_of(configuration: FloatArray) -> Any:
        state = space.allocState()
        for i in range(joints):
            state[i] = float(configuration[i])
        return state

    definition = base.ProblemDefinition(information)
    definition.addStartState(state_of(start))
    region = base.GoalStates(information)
    for end in ends:
        region.addState(state_of(end))
    definition.setGoal(region)
    objective = base.PathLengthOptimizationObjective(information)
    # Any length will do.
    objective.setCostThreshold(base.Cost(np.inf))
    definition.setOptimizationObjective(objective)
    planner = getattr(geometric, algorithm)(information)
    if algorithm != "BITstar":
        planner.setRange(step)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(base.timedPlannerTerminationCondition(seconds))
    if not definition.hasExactSolution():
        return None
    states = definition.getSolutionPath()
    return np.concatenate(
        [_configuration(states.getState(k), joints) for k in range(states.getStateCount())]
    )


class OMPLPlanner(SearchPlanner):
    """Solutions of one of OMPL's planners; see `smp_planner.planners.rrt_connect.planner`.

    Args:
        demonstrations: give the postures in which a place is reached, and nothing else.
        settings: of `OMPLSettings`; the rest keep their defaults.

    Raises:
        ValueError: an unknown setting, or one out of range.
        ModuleNotFoundError: OMPL is not installed.
    """

    def __init__(self, demonstrations: Demonstrations, **settings: Any) -> None:
        require("ompl", "a planner of OMPL's")
        s = OMPLSettings.model_validate(settings)
        join: Callable[..., FloatArray | None] = partial(
            ompl_path, algorithm=s.algorithm, seconds=s.seconds, step=s.step
        )
        super().__init__(demonstrations, s, join, f"{s.seconds:g} s")
