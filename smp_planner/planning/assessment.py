"""The assessment of finished trajectories: exact checks, constraints, homotopy classes, order."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.collision.clearance_in_time import clearance_in_time
from smp_planner.collision.verification import CLEARANCE_TOLERANCE
from smp_planner.planning.forecasting import parted, robot_of
from smp_planner.planning.modes import signatures_2d, signatures_3d
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.ranking import Merits, demanded_and_merit, rank
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.planning.tool_passing import ToolPassing

__all__ = [
    "Verdict",
    "assess",
    "constraints_met",
    "free_waypoints",
    "make_plan",
    "signatures",
]

_ASIDE = np.array([1.1e-6, 0.7e-6, 0.0])
"""Shift, m, of the middles of obstacles for signatures: in a scene made by hand, a
trajectory may lead right through one, where it has no side."""

_SIGNATURE_SAMPLES = 50
"""Samples of a path that decide its signature. Between them a hand moves by about 2 cm: finer ones
cost more time, and class otherwise only what passes close to an edge or through an obstacle."""


HOLD = 1.2
"""s, for which the arm stays where a trajectory ends: the hand opens, what it held comes to rest.
Till then nothing that moves may meet it; what is later is nothing to the trajectory."""

_HOLD_SAMPLES = 6
"""Samples of that."""


class Verdict(NamedTuple):
    """Results of the exact check of P trajectories; see `Plan` for the fields.

    Attributes:
        free: (P,).
        clearance: (P,).
        executable: (P,).
        duration: (P,) s.
        missed: (P,) by name of the constraint.
        passing: (P,).
        standing_free: (P,); None as `free`.
        apart: (P,) m; None where nothing moves.
    """

    free: BoolArray
    clearance: FloatArray
    executable: BoolArray
    duration: FloatArray
    missed: dict[str, FloatArray]
    passing: BoolArray
    standing_free: BoolArray | None = None
    apart: FloatArray | None = None

    @property
    def good(self) -> BoolArray:
        """(P,) as `Plan.good`."""
        return self.free & self.executable & self.passing


class _Limits(NamedTuple):
    """What is cheap to tell of P trajectories, all but collisions; see `Verdict` for the fields."""

    executable: BoolArray
    duration: FloatArray
    missed: dict[str, FloatArray]
    passing: BoolArray


def _limits(problem: Problem, trajectories: FloatArray, settings: PlanSettings) -> _Limits:
    rest = problem.rest(trajectories.shape[1])
    executable, duration = problem.body.execution(trajectories[:, rest], settings.duration_limit)
    return _Limits(executable, duration, *constraints_met(problem, trajectories, settings))


def _standing(
    problem: Problem, trajectories: FloatArray, settings: PlanSettings
) -> tuple[BoolArray, FloatArray]:
    """Return whether P trajectories are free of themselves and of what stands, and how clear."""
    count = len(trajectories)
    free, clearance = np.ones(count, np.bool_), np.full(count, np.inf)
    body, whole, samples = problem.body, False, trajectories.shape[1]
    for stage in problem.stages:
        steps = problem.ahead(stage, samples)
        if steps.start == steps.stop:
            continue
        standing, _ = parted(problem, stage, settings)
        found = stage.body.check(trajectories[:, steps], standing, stage.cloud)
        free, clearance = free & found.free, np.minimum(clearance, found.clearance)
        whole |= stage.body is body and (stage.first, stage.last) == (0.0, 1.0)
    if not whole:
        # With all that it carries in the end, the body must stay clear of itself, too.
        free = free & body.check(trajectories[:, problem.rest(samples)], ()).free
    return free, clearance


def _apart(problem: Problem, trajectories: FloatArray, settings: PlanSettings) -> FloatArray | None:
    """Return the clearances (P,) m of P trajectories to what moves; None where nothing does."""
    apart: FloatArray | None = None
    samples = trajectories.shape[1]
    for stage in problem.stages:
        steps = problem.ahead(stage, samples)
        _, forecast = parted(problem, stage, settings)
        if steps.start == steps.stop or forecast is None:
            continue
        robot = robot_of(stage)
        times = problem.clock.times(trajectories, robot.velocity)[:, steps]
        part = trajectories[:, steps]
        if stage.last == 1.0:
            part, times = _held(part, times, problem.foresight)
        met = clearance_in_time(part, times, robot, forecast, until=problem.foresight)
        apart = met if apart is None else np.minimum(apart, met)
    return apart


def _held(
    trajectories: FloatArray, times: FloatArray, foresight: float
) -> tuple[FloatArray, FloatArray]:
    """Return trajectories (P, T, n) that stay where they end, and the times (P, T) of all that."""
    shares = np.linspace(0.0, 1.0, _HOLD_SAMPLES + 1)[1:]
    long = np.clip(foresight - times[:, -1:], 0.0, HOLD)
    stay = np.repeat(trajectories[:, -1:], _HOLD_SAMPLES, axis=1)
    held = np.concatenate([trajectories, stay], axis=1)
    return held, np.concatenate([times, times[:, -1:] + long * shares], axis=1)


def assess(problem: Problem, trajectories: FloatArray, settings: PlanSettings) -> Verdict:
    """Check trajectories (P, T, D): collisions stage by stage, limits, and constraints.

    Args:
        problem: to be solved.
        trajectories: (P, T, D).
        settings: limit of the duration, and what may be missed.
    """
    standing_free, clearance = _standing(problem, trajectories, settings)
    apart = _apart(problem, trajectories, settings)
    free = standing_free
    if apart is not None:
        free, clearance = free & _clear(apart), np.minimum(clearance, apart)
    limits = _limits(problem, trajectories, settings)
    return Verdict(free, clearance, *limits, standing_free, apart)


def _clear(apart: FloatArray) -> BoolArray:
    """Return whether clearances (P,) m to what moves are certain to be none below 0."""
    return np.asarray(apart >= CLEARANCE_TOLERANCE)


class _BestFirst:
    """Checks of collisions in the order of preference, until the best particle is certain.

    What moves is looked at first, for all particles. One that is not checked yet against what
    stands is at best free of it with a safe clearance, which gives a bound on its place in `rank`.
    Particles are checked by that bound, the highest first, until one that is checked is above the
    bounds of all others: it is the first of `rank`.

    Args:
        problem: to be solved.
        trajectories: (P, T, D).
        costs: as of `rank`.
        settings: see `assess`.
        limits: what else there is to tell.
        until: time of `time.perf_counter` from which on nothing more is checked, but for the first.
        verdict: of the check, if it is made already.
        bonus: as of `rank`.

    Attributes:
        chosen: see `Checks`.
        solved: see there.
        ended_early: whether the time was over before the best one was certain.
        apart: see `Plan`.
    """

    def __init__(
        self,
        problem: Problem,
        trajectories: FloatArray,
        costs: Mapping[str, FloatArray],
        settings: PlanSettings,
        limits: _Limits,
        until: float = math.inf,
        verdict: Verdict | None = None,
        bonus: FloatArray | float = 0.0,
    ) -> None:
        self._problem, self._trajectories, self._costs = problem, trajectories, costs
        self._settings, self._limits, self._bonus = settings, limits, bonus
        count = len(trajectories)
        self._checked = np.full(count, verdict is not None)
        self._standing, self._clearance = np.zeros(count, np.bool_), np.full(count, np.nan)
        if verdict is None:
            self.apart = _apart(problem, trajectories, settings)
        else:
            standing = verdict.standing_free
            self._standing = verdict.free if standing is None else standing
            self._clearance, self.apart = verdict.clearance, verdict.apart
        self._unmet = np.ones(count, np.bool_) if self.apart is None else _clear(self.apart)
        self._nearest = np.full(count, np.inf) if self.apart is None else self.apart
        bounds = self._keys(self._unmet, self._nearest)
        order = sorted(range(count), key=bounds.__getitem__, reverse=True)
        best = None
        self.ended_early = False
        for index in order:
            if best is not None and best >= bounds[index]:
                break
            if best is not None and time.perf_counter() > until:
                self.ended_early = True
                break
            if not self._checked[index]:
                self._check(np.array([index]))
            key = self._keys(self._free, self._clearance)[index]
            best = key if best is None else max(best, key)
        assert best is not None
        self.chosen = best[2]
        self.solved = bool(
            self._free[self.chosen] & limits.executable[self.chosen] & limits.passing[self.chosen]
        )

    def _keys(self, free: BoolArray, clearance: FloatArray) -> list[tuple[float, float, int]]:
        """Return the order of `rank`, the greatest first, if particles were free and as clear."""
        demanded, merit = demanded_and_merit(self._merits(free, clearance))
        return list(zip(demanded.tolist(), merit.tolist(), range(len(free)), strict=True))

    def _merits(self, free: BoolArray, clearance: FloatArray) -> Merits:
        limits = self._limits
        return Merits(
            free,
            limits.passing,
            limits.executable,
            clearance,
            limits.missed,
            self._costs,
            self._bonus,
        )

    def _check(self, indices: IntArray) -> None:
        self._standing[indices], clearance = _standing(
            self._problem, self._trajectories[indices], self._settings
        )
        self._clearance[indices] = np.minimum(clearance, self._nearest[indices])
        self._checked[indices] = True

    @property
    def _free(self) -> BoolArray:
        """(P,) whether particles that have been checked are free of what stands and moves."""
        return self._standing & self._unmet

    @property
    def count(self) -> int:
        """How many particles have been checked."""
        return int(self._checked.sum())

    def complete(self) -> dict[str, Any]:
        """Return the open fields of a `Plan`; see `Checks.complete`."""
        rest = np.flatnonzero(~self._checked)
        if len(rest):
            self._check(rest)
        ranks = rank(self._merits(self._free, self._clearance))
        # A deadline may have ended the search for the best one before it was found.
        ranks[ranks < ranks[self.chosen]] += 1
        ranks[self.chosen] = 0
        return {
            "collision_free": self._free,
            "standing_free": self._standing,
            "clearance": self._clearance,
            "ranks": ranks,
            "signatures": signatures(self._problem, self._trajectories),
        }


def constraints_met(
    problem: Problem, trajectories: FloatArray, settings: PlanSettings
) -> tuple[dict[str, FloatArray], BoolArray]:
    """Return by how much trajectories (P, T, D) miss constraints, and (P,) whether all are met."""
    missed, passing = {}, np.ones(len(trajectories), np.bool_)
    for constraint in problem.constraints:
        value = constraint.missed(trajectories)
        passing &= value <= constraint.slack(settings)
        if constraint.cost(settings) is not None:
            missed[constraint.name] = np.maximum(value, 0.0)
        if isinstance(constraint, ToolPassing) and constraint.oriented:
            turned = constraint.turned(trajectories)
            passing &= turned <= constraint.slack(settings)
            missed[f"{constraint.name} orientation"] = turned
    return missed, passing


def make_plan(
    problem: Problem,
    trajectories: FloatArray,
    costs: Mapping[str, FloatArray],
    settings: PlanSettings,
    *,
    weights: FloatArray | None = None,
    components: IntArray | None = None,
    reason: str = "no particle is good",
    until: float = math.inf,
    verdict: Verdict | None = None,
    bonus: Callable[[IntArray, FloatArray], FloatArray] | None = None,
) -> Plan:
    """Return the plan that trajectories amount to: the best one is checked, the rest on demand.

    Args:
        problem: to be solved.
        trajectories: (P, T, D).
        costs: what is known already of each particle, each (P,), `prior` or `length` among them.
        settings: see `assess`.
        weights: (P, K, D) of the primitive, if there is one.
        components: (P,), see `Plan`.
        reason: what the plan's message begins with if no particle is good.
        until: time of `time.perf_counter` from which on the best one of those checked so far is
            taken.
        verdict: of the check, if it is made already.
        bonus: from homotopy classes and durations of particles to what is added to their merit
            (P,), in units of the log-prior.
    """
    if verdict is None:
        limits = _limits(problem, trajectories, settings)
    else:
        limits = _Limits(verdict.executable, verdict.duration, verdict.missed, verdict.passing)
    added: FloatArray | float = 0.0
    if bonus is not None:
        added = bonus(signatures(problem, trajectories), limits.duration)
    checks = _BestFirst(problem, trajectories, costs, settings, limits, until, verdict, bonus=added)
    plan = Plan.pending(
        checks,
        trajectories=trajectories,
        costs=costs,
        missed=limits.missed,
        passing=limits.passing,
        duration=limits.duration,
        executable=limits.executable,
        weights=weights,
        components=components,
        apart=checks.apart,
        display={"problem": problem},
    )
    if checks.ended_early and not checks.solved:
        return plan.changed(
            message=f"{reason} of the {checks.count} that were checked before the deadline: the "
            "least bad one of them is chosen"
        )
    if not checks.solved:
        return plan.changed(
            message=f"{reason}: of {len(trajectories)} particles "
            f"{int(plan.collision_free.sum())} are collision-free, "
            f"{int(plan.executable.sum())} executable, "
            f"{int(plan.passing.sum())} meet all constraints; the least bad one is chosen"
        )
    return plan


def free_waypoints(problem: Problem, trajectories: FloatArray) -> BoolArray:
    """Return (P, T) whether the configurations of trajectories (P, T, D) touch nothing."""
    count = trajectories.shape[1]
    free = np.ones(trajectories.shape[:2], np.bool_)
    for stage in problem.stages:
        steps = stage.steps(count)
        free[:, steps] &= stage.body.free_waypoints(
            trajectories[:, steps], stage.obstacles, stage.cloud
        )
    return free


def signatures(problem: Problem, trajectories: FloatArray) -> IntArray:
    """Return the homotopy class (P, 1 + S) of trajectories (P, T, D), see `Plan.signatures`.

    The path is that of the carried point. Trajectories with one goal are compared with each other,
    for the signatures of different ends are not comparable. In space, over or under an obstacle is
    what crosses the circle around its outline as seen from above.
    """
    movable = problem.movable
    reaching = [
        (c, c.goals if isinstance(c, Reaching) else c.places)
        for c in problem.constraints
        if isinstance(c, Reaching | ToolPassing) and c.phases == (1.0,)
    ]
    ends = np.zeros(len(trajectories), np.int64)
    if reaching:
        ends = reaching[0][0].distances(trajectories).argmin(axis=0)
    last = trajectories.shape[1] - 1
    steps = np.unique(
        np.linspace(0, last, min(_SIGNATURE_SAMPLES, last + 1)).round().astype(np.int64)
    )
    passed: list[FloatArray] = [np.empty(0)] * len(trajectories)
    for number in np.unique(ends):
        of_goal = np.flatnonzero(ends == number)
        point = reaching[0][1][number].point if reaching else None
        paths = problem.body.paths(trajectories[of_goal][:, steps], point)
        for index, signature in zip(of_goal, _passing(paths, movable), strict=True):
            passed[index] = signature
    return np.column_stack([ends, np.array(passed)]).astype(np.int64)


def _passing(paths: FloatArray, movable: tuple[Obstacle, ...]) -> IntArray:
    """Return the signatures (P, S) of paths (P, T, 2 or 3) among obstacles."""
    centers = np.array([o.position for o in movable]).reshape(-1, 3)
    if not movable:
        return np.empty((len(paths), 0), np.int64)
    if paths.shape[-1] == 2:
        return signatures_2d(paths, (centers + _ASIDE)[:, :2])
    extents = np.array([_extents(o) for o in movable]).reshape(-1, 2)
    found = signatures_3d(paths, centers + _ASIDE, extents[:, 1], extents[:, 0])
    return found.reshape(len(paths), -1)


def _extents(obstacle: Obstacle) -> tuple[float, float]:
    """Return radius and half height, m, of an upright cylinder around an obstacle."""
    rotation = Rotation.from_quat(obstacle.quaternion).as_matrix()
    return REGISTRY[obstacle.shape].upright(rotation, np.array(obstacle.size))
