"""`rrt_connect`: RRT-Connect in joint space, with shortcuts and smoothing. The sampling baseline.

The choice of a user without demonstrations to keep to: they only give the postures in which a
place is reached, and where a problem asks for orientations of the tool or for places of joints, not
even these (`asked_postures`). Randomness comes from the problem's seed and budgets are counts, so a
plan depends neither on the machine nor on what was planned before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import UnreachableError, end_effector_pose, inverse_kinematics
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import RobotModel
from smp_planner.collision.verification import CLEARANCE_TOLERANCE, minimum_duration
from smp_planner.planners.rrt_connect.asked_postures import (
    AskedPostures,
    asked_postures,
    is_asked,
)
from smp_planner.planners.rrt_connect.layered_search import PathSearch, path_through
from smp_planner.planners.rrt_connect.shortcutting import (
    path_length,
    shortcut,
    smooth,
    stop_at_corners,
)
from smp_planner.planners.rrt_connect.tree_search import rrt_connect
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.plan import Plan
from smp_planner.planning.postures import pose_chain, reaching
from smp_planner.planning.problem import Problem
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.stopwatch import Stopwatch
from smp_planner.planning.tool_constraints import ToolPath
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint, ViaPose
from smp_planner.strict_settings import StrictSettings

__all__ = [
    "RRTConnectPlanner",
    "RRTConnectSettings",
    "SearchPlanner",
    "SearchSettings",
    "rrt_connect_plan",
]

_CONTROL_POINTS = (7, 10, 14, 20, 28, 40, 56, 80)
"""Control points of the splines that are tried, from smooth to true to the path."""

_LIFT_OFF = 0.03
"""Metres by which the hand goes straight up with what it has grasped."""


SAMPLES = 200
"""T of the trajectories in a plan, as in the demonstrations."""


class SearchSettings(StrictSettings):
    """Settings of what is around a search for paths, whichever it is.

    Attributes:
        particles: P, size of the set: so many searches, each with randomness of its own.
        margin: m, distance to keep to obstacles.
        postures: how many configurations are tried for each goal or via-point.
        posture_spread: rad, how far around the demonstrations' last configurations goal
            configurations are sought.
        branches: how many chains of configurations at the via-poses are tried.
        shortcuts: iterations of shortcutting.
        duration_limit: s, within which an executable trajectory must be feasible.
    """

    particles: int = Field(default=4, ge=1)
    margin: float = Field(default=0.005, ge=CLEARANCE_TOLERANCE, allow_inf_nan=False)
    postures: int = Field(default=64, ge=1)
    posture_spread: float = Field(default=0.2, ge=0.0, allow_inf_nan=False)
    branches: int = Field(default=8, ge=1)
    shortcuts: int = Field(default=100, ge=0)
    duration_limit: float = Field(default=15.0, gt=0.0, allow_inf_nan=False)


class RRTConnectSettings(SearchSettings):
    """Settings of RRT-Connect, beside those of `SearchSettings`.

    Attributes:
        iterations: of a search, at most.
        step: rad, longest edge of the trees.
    """

    iterations: int = Field(default=5_000, ge=1)
    step: float = Field(default=0.5, gt=0.0, allow_inf_nan=False)


def _timed(
    path: FloatArray,
    samples: int,
    checker: EdgeChecker,
    seconds: float,
    passes: Callable[[FloatArray], bool] = lambda _: True,
) -> FloatArray:
    """Return the smoothest trajectory (T,n) along a path that is free, in time, and passes a test.

    Where none is in time, the fastest. The path itself is free, so that there always is a
    trajectory: in the worst case it stops at each corner.
    """
    velocity = checker.robot.velocity
    best: tuple[float, FloatArray] | None = None
    for points in _CONTROL_POINTS:
        spline = smooth(path, velocity, points, samples)
        if not (checker.edges_free(spline[:-1], spline[1:]).all() and passes(spline)):
            continue
        duration = float(minimum_duration(spline[None], velocity)[0])
        if duration <= seconds:
            return spline
        if best is None or duration < best[0]:
            best = duration, spline
    return stop_at_corners(path, velocity, samples) if best is None else best[1]


def _via_region(via: ToolViaPoint) -> GoalRegion:
    """Return the largest cube within the ball in which a via-point is passed."""
    half = via.tolerance / np.sqrt(3.0)
    return GoalRegion(via.point, via.position - half, via.position + half)


@dataclass(frozen=True)
class _Search:
    """One problem and all that the search for its trajectories shares.

    Attributes:
        problem: to be solved.
        demonstrated: (N,T,6) rad, around which configurations are sought.
        settings: budgets.
        join: searches for a path.
    """

    problem: Problem
    demonstrated: FloatArray
    settings: SearchSettings
    join: PathSearch

    @property
    def robot(self) -> RobotModel:
        """The arm with all that it carries."""
        return self.problem.robot

    def goals(self, near: FloatArray) -> FloatArray:
        """Return configurations (G,6) rad at the goals, not checked for collisions."""
        rng = np.random.default_rng([self.problem.seed, 1])
        seeds = self._seeds((1.0,), rng)[0]
        return reaching(self.problem.goals, self.robot, seeds, near, rng)

    def _seeds(self, due: Sequence[float], rng: np.random.Generator) -> list[FloatArray]:
        """Return configurations (N,6) rad near those demonstrated at each of several phases.

        At all phases they are of the same demonstrations and as far aside, so that what follows
        upon each other is near in posture, too.
        """
        s = self.settings
        chosen = rng.integers(len(self.demonstrated), size=s.postures)
        aside = s.posture_spread * rng.standard_normal((s.postures, self.robot.joints))
        there = at_phases(self.demonstrated, due)[chosen]
        return [there[:, k] + aside for k in range(len(due))]

    def layers(self) -> list[FloatArray]:
        """Return configurations (C,6) rad at each via-point in turn, and at last at the goals."""
        via_points = self.problem.via_points
        rng = np.random.default_rng([self.problem.seed, 1])
        seeds = self._seeds([*(via.phase for via in via_points), 1.0], rng)
        regions = [*((_via_region(via),) for via in via_points), self.problem.goals]
        return [
            reaching(region, self.robot, near, near[0], rng)
            for region, near in zip(regions, seeds, strict=True)
        ]

    def checker(
        self, ends: Sequence[FloatArray], first: float = 0.0, last: float = 1.0
    ) -> EdgeChecker:
        """Return the collision check of a stretch of the phase.

        Args:
            ends: of each layer (C,6) rad one configuration should keep the margin; where all of one
                are nearer to something than that, the least margin is taken.
            first: phase at which the stretch begins.
            last: phase at which it ends.
        """
        stages = [s for s in self.problem.stages if s.first < last and s.last > first]
        bodies = [(s.body.model, s.obstacles) for s in stages if isinstance(s.body, RobotBody)]
        cloud = self.problem.cloud
        grid = None if cloud is None else cloud.grid
        for margin in (self.settings.margin, CLEARANCE_TOLERANCE):
            checker = EdgeChecker.of_all(bodies, margin, grid)
            if all(checker.configurations_free(layer).any() for layer in ends):
                break
        return checker

    def path(
        self, start: FloatArray, goals: FloatArray, checker: EdgeChecker, rng: np.random.Generator
    ) -> FloatArray | None:
        """Return a short free path (V,6) rad from a configuration to one of several, or None."""
        path = self.join(start, goals, checker, rng)
        return None if path is None else shortcut(path, checker, self.settings.shortcuts, rng)

    def passes(self, trajectory: FloatArray) -> bool:
        """Return whether a trajectory (T,6) rad passes all via-points."""
        return all(
            constraint.missed(trajectory[None])[0] <= 0.0
            for constraint in self.problem.constraints
            if isinstance(constraint, ToolPath)
        )

    def direct(self, goals: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """Return a trajectory (T,6) rad from the start to a goal, or None."""
        start = self.problem.start
        checker = self.checker([start[None], goals])
        path = self.path(start, goals, checker, rng)
        if path is None:
            return None
        return _timed(path, SAMPLES, checker, self.settings.duration_limit)

    def through(self, layers: Sequence[FloatArray], rng: np.random.Generator) -> FloatArray | None:
        """Return a trajectory (T,6) rad from the start through all layers, or None."""
        s, start = self.settings, self.problem.start
        checker = self.checker([start[None], *layers])
        # Each search has its own half of the configurations, so that not all find the same path.
        halves = [layer[rng.permutation(len(layer))[: (len(layer) + 1) // 2]] for layer in layers]
        found = path_through(start, halves, checker, rng, self.join)
        if found is None:
            return None
        pieces = [shortcut(piece, checker, s.shortcuts, rng) for piece in found]
        path = np.concatenate([start[None], *(piece[1:] for piece in pieces)])
        return _timed(path, SAMPLES, checker, s.duration_limit, self.passes)

    def in_time(self, asked: AskedPostures, rng: np.random.Generator) -> FloatArray | None:
        """Return a trajectory (T,n) rad with a configuration of each layer at its phase, or None.

        It stands still at each, so that the phase in which one is passed is that asked for.
        """
        s, start = self.settings, asked.start
        checker = self.checker([start[None], *asked.layers])
        halves = [
            layer[rng.permutation(len(layer))[: (len(layer) + 1) // 2]] for layer in asked.layers
        ]
        found = path_through(start, halves, checker, rng, self.join)
        if found is None:
            return None
        first, trajectory = 0.0, [start[None]]
        for path, last in zip(found, asked.phases, strict=True):
            samples = round(last * (SAMPLES - 1)) - round(first * (SAMPLES - 1)) + 1
            short = shortcut(path, checker, s.shortcuts, rng)
            if len(short) > samples:
                # There are fewer moments between the two phases than the path has corners.
                return None
            seconds = s.duration_limit * (last - first)
            trajectory.append(_timed(short, samples, checker, seconds)[1:])
            first = last
        return np.concatenate(trajectory)

    def branches(self, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Yield configurations (H,6) rad at the via-poses, free from one to the next.

        First that nearest to what was demonstrated, then those nearest to random ones.
        """
        via_poses = self.problem.via_poses
        expected = at_phases(self.demonstrated, via_poses[-1].phase)[:, 0].mean(axis=0)
        checker = self.checker((), via_poses[0].phase, via_poses[-1].phase)
        for attempt in range(self.settings.branches):
            turn = rng.uniform(-np.pi, np.pi, self.robot.joints) if attempt else 0.0
            try:
                chain = pose_chain([via.pose for via in via_poses], expected + turn)
            except UnreachableError:
                continue
            if checker.edges_free(chain[:-1], chain[1:]).all():
                yield chain

    def by_poses(self, rng: np.random.Generator) -> FloatArray | None:
        """Return a trajectory (T,6) rad that takes the via-poses and ends in a goal, or None."""
        for chain in self.branches(rng):
            trajectory = self.along(chain, rng)
            if trajectory is not None:
                return trajectory
        return None

    def along(self, chain: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """Return a trajectory (T,6) rad with a chain (H,6) at the via-poses, or None."""
        problem, limit = self.problem, self.settings.duration_limit
        first, last = problem.via_poses[0].phase, problem.via_poses[-1].phase
        before, after = round(first * (SAMPLES - 1)), round(last * (SAMPLES - 1))
        approach = self.checker([problem.start[None], chain[:1]], 0.0, first)
        there = self.path(problem.start, chain[:1], approach, rng)
        lifted = _lifted(chain[-1])
        if there is None or lifted is None:
            return None
        goals = self.goals(lifted)
        grid = None if problem.cloud is None else problem.cloud.grid
        clear = EdgeChecker(self.robot, problem.obstacles, grid=grid)
        carry = self.checker([chain[-1:], lifted[None], goals], last, 1.0)
        away = self.path(lifted, goals, clear, rng)
        if away is None:
            return None
        away = np.concatenate([chain[-1:], away])
        return np.concatenate(
            [
                _timed(there, before + 1, approach, limit * first)[:-1],
                _followed(chain, problem.via_poses, after - before + 1)[:-1],
                _timed(away, SAMPLES - after, carry, limit * (1.0 - last)),
            ]
        )


def _lifted(configuration: FloatArray) -> FloatArray | None:
    """Return the configuration (6,) rad with the hand straight above that of another, or None."""
    pose = end_effector_pose(configuration)
    try:
        raised = pose[:3, 3] + np.array([0.0, 0.0, _LIFT_OFF])
        return inverse_kinematics(raised, pose[:3, :3], seed=configuration)
    except UnreachableError:
        return None


def _followed(chain: FloatArray, via_poses: Sequence[ViaPose], samples: int) -> FloatArray:
    """Return a trajectory (T,6) rad, from rest to rest, with a chain (H,6) at its via-poses."""
    due = np.array([via.phase for via in via_poses])
    spline = CubicSpline(due, chain, bc_type="clamped")
    return np.asarray(spline(np.linspace(due[0], due[-1], samples)))


class SearchPlanner:
    """Independent solutions of a search for paths, shortened and smoothed.

    Via-points are passed through configurations found by inverse kinematics, joined by straight
    edges or, where none is free, by a search. Where a problem has via-poses, the stretch between
    the first and the last of them is followed as posed, and the paths to and from it are searched.
    Of several solutions the shortest is best.

    Args:
        demonstrations: give the postures in which a place is reached, and nothing else.
        settings: budgets.
        join: searches for a path.
        budget: of a search, in words, such as "5000 iterations".
        counted: to which `join` adds its iterations, if it counts them: the plan then holds them.
    """

    def __init__(
        self,
        demonstrations: Demonstrations,
        settings: SearchSettings,
        join: PathSearch,
        budget: str,
        counted: list[int] | None = None,
    ) -> None:
        self._settings = settings
        self._join, self._budget, self._counted = join, budget, counted
        self._demonstrated = np.array(demonstrations.configurations)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by name, as plain data."""
        return self._settings.model_dump(mode="json")

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem.

        Raises:
            UnreachableError: a goal is out of reach.
            ValueError: a constraint that a search for paths does not keep.
        """
        return [
            _plan(
                problem, self._demonstrated, self._settings, self._join, self._budget, self._counted
            )
            for problem in problems
        ]


def _plan(
    problem: Problem,
    demonstrated: FloatArray,
    settings: SearchSettings,
    join: PathSearch,
    budget: str,
    counted: list[int] | None,
    checks: PlanSettings | None = None,
) -> Plan:
    """Return the plan of a problem; arguments as of `SearchPlanner`.

    Args:
        problem: to be solved.
        demonstrated: (N,T,n) rad.
        settings: budgets.
        join: searches for a path.
        budget: of a search, in words.
        counted: to which `join` adds its iterations.
        checks: settings of the checks; by default those of the environments' tasks.
    """
    stopwatch = Stopwatch()
    with stopwatch.stage("goals"):
        search = _Search(problem, demonstrated, settings, join)
        asked, layers = None, []
        if is_asked(problem):
            rng = np.random.default_rng([problem.seed, 1])
            asked = asked_postures(problem, settings.postures, SAMPLES - 1, rng)
            start, goals = asked.start, asked.layers[-1]
        else:
            start = problem.start
            goals = search.goals(start)
            if not len(goals):
                named = ", ".join(f"{np.round(goal.center, 3)}" for goal in problem.goals)
                raise UnreachableError(
                    f"goal {named} is out of reach from each of {settings.postures} configurations"
                )
            layers = search.layers() if problem.via_points else []
    with stopwatch.stage("search"):
        found, iterations = [], []
        for index in range(settings.particles):
            if counted is not None:
                counted.clear()
            rng = np.random.default_rng([problem.seed, 2, index])
            if asked is not None:
                found.append(search.in_time(asked, rng))
            elif problem.via_poses:
                found.append(search.by_poses(rng))
            elif problem.via_points:
                found.append(search.through(layers, rng))
            else:
                found.append(search.direct(goals, rng))
            if counted is not None:
                iterations.append(sum(counted))
    with stopwatch.stage("verification"):
        # Where no path was found a straight one stands, so that the set has its size.
        ends = np.stack([start, goals[0]])
        straight = stop_at_corners(ends, problem.robot.velocity, SAMPLES)
        trajectories = np.stack([straight if path is None else path for path in found])
        checker = search.checker([start[None], goals])
        free = int(checker.configurations_free(goals).sum())
        reason = f"{sum(path is not None for path in found)} of {settings.particles} searches "
        reason += f"succeeded within {budget}, "
        if asked is None:
            reason += f"{free} of {settings.postures} configurations at the goal are free"
        else:
            reason += f"{free} of {len(goals)} configurations at the goal are free"
            for phase, layer in zip(asked.phases[:-1], asked.layers[:-1], strict=True):
                count = int(checker.configurations_free(layer).sum())
                reason += f" and {count} of {len(layer)} at phase {phase:g}"
        costs = {"length": np.array([path_length(path) for path in trajectories])}
        if counted is not None:
            costs["iterations"] = np.array(iterations, np.float64)
        plan = make_plan(
            problem,
            trajectories,
            costs,
            checks or PlanSettings(particles=len(found), duration_limit=settings.duration_limit),
            reason=reason,
        )
    return plan.changed(timings=stopwatch.timings)


def _counting(settings: RRTConnectSettings) -> tuple[PathSearch, str, list[int]]:
    """Return RRT-Connect as a search, its budget in words, and where it counts iterations."""
    counted: list[int] = []
    join = partial(rrt_connect, iterations=settings.iterations, step=settings.step, counted=counted)
    return join, f"{settings.iterations} iterations", counted


def rrt_connect_plan(problem: Problem, settings: RRTConnectSettings, checks: PlanSettings) -> Plan:
    """Return independent RRT-Connect solutions of a problem of any robot, without demonstrations.

    Args:
        problem: with a start that is certain, a goal, and one constraint at a phase.
        settings: budgets; their particles and limit of duration are those of `checks`.
        checks: settings of the checks that the trajectories pass.

    Raises:
        UnreachableError: a place of the tool is out of reach, or not with its orientation.
        ValueError: a constraint that a search for paths does not keep.
    """
    own = {"particles": checks.particles, "duration_limit": checks.duration_limit}
    settings = settings.model_copy(update=own)
    none = np.empty((0, 0, problem.robot.joints))
    return _plan(problem, none, settings, *_counting(settings), checks)


class RRTConnectPlanner(SearchPlanner):
    """Independent RRT-Connect solutions; see `SearchPlanner`.

    The same problem gives the same plan.

    Args:
        demonstrations: give the postures in which a place is reached, and nothing else.
        settings: of `RRTConnectSettings` by name; the rest keep their defaults.

    Raises:
        ValueError: an unknown setting, or one out of range.
    """

    def __init__(self, demonstrations: Demonstrations, settings: Mapping[str, Any]) -> None:
        s = RRTConnectSettings.model_validate(dict(settings))
        super().__init__(demonstrations, s, *_counting(s))
