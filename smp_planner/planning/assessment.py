"""The assessment of finished trajectories: exact checks, constraints, homotopy classes, order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.collision.moving import clearance_in_time
from smp_planner.collision.verification import CLEARANCE_TOLERANCE
from smp_planner.planning.constraints import Reaching
from smp_planner.planning.forecasting import parted, robot_of
from smp_planner.planning.modes import signatures_2d, signatures_3d
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.ranking import rank
from smp_planner.planning.settings import PlanSettings

__all__ = ["Verdict", "assess", "free_waypoints", "make_plan", "signatures"]

_ASIDE = np.array([1.1e-6, 0.7e-6, 0.0])
"""Shift, m, of the middles of obstacles for signatures: in a scene made by hand, a
trajectory may lead right through one, where it has no side."""

_SIGNATURE_SAMPLES = 50
"""Samples of a path that decide its signature. Between them a hand moves by about 2 cm: finer ones
cost more time, and class otherwise only what passes close to an edge or through an obstacle."""


class Verdict(NamedTuple):
    """Results of the exact check of P trajectories; see `Plan` for the fields.

    Attributes:
        free: (P,).
        clearance: (P,).
        standing_free: (P,).
        apart: (P,) m; None where nothing moves.
        executable: (P,).
        duration: (P,) s.
        missed: (P,) by name of the constraint.
        passing: (P,).
    """

    free: BoolArray
    clearance: FloatArray
    standing_free: BoolArray
    apart: FloatArray | None
    executable: BoolArray
    duration: FloatArray
    missed: dict[str, FloatArray]
    passing: BoolArray

    @property
    def good(self) -> BoolArray:
        """(P,) as `Plan.good`."""
        return self.free & self.executable & self.passing


def assess(problem: Problem, trajectories: FloatArray, settings: PlanSettings) -> Verdict:
    """Check trajectories (P, T, D): collisions stage by stage, limits, and constraints.

    Args:
        problem: to be solved.
        trajectories: (P, T, D).
        settings: limit of the duration, and what may be missed.
    """
    count = len(trajectories)
    free, clearance = np.ones(count, np.bool_), np.full(count, np.inf)
    body, whole = problem.body, False
    samples, clock = trajectories.shape[1], problem.clock
    apart: FloatArray | None = None
    for stage in problem.stages:
        steps = problem.ahead(stage, samples)
        if steps.start == steps.stop:
            continue
        part = trajectories[:, steps]
        standing, forecast = parted(problem, stage, settings)
        found = stage.body.check(part, standing, stage.cloud)
        free, clearance = free & found.free, np.minimum(clearance, found.clearance)
        if forecast is not None:
            robot = robot_of(stage)
            times = clock.times(trajectories, robot.velocity)[:, steps]
            met = clearance_in_time(part, times, robot, forecast, until=problem.foresight)
            apart = met if apart is None else np.minimum(apart, met)
        whole |= stage.body is body and (stage.first, stage.last) == (0.0, 1.0)
    rest = slice(clock.first(samples) if clock.phase > 0.0 else 0, None)
    if not whole:
        # With all that it carries in the end, the body must stay clear of itself, too.
        free = free & body.check(trajectories[:, rest], ()).free
    executable, duration = body.execution(trajectories[:, rest], settings.duration_limit)
    standing_free = free
    if apart is not None:
        free, clearance = free & (apart >= CLEARANCE_TOLERANCE), np.minimum(clearance, apart)
    missed, passing = {}, np.ones(count, np.bool_)
    for constraint in problem.constraints:
        value = constraint.missed(trajectories)
        passing &= value <= constraint.slack(settings)
        if constraint.cost(settings) is not None:
            missed[constraint.name] = np.maximum(value, 0.0)
    return Verdict(free, clearance, standing_free, apart, executable, duration, missed, passing)


def make_plan(
    problem: Problem,
    trajectories: FloatArray,
    costs: Mapping[str, FloatArray],
    settings: PlanSettings,
    *,
    weights: FloatArray | None = None,
    components: IntArray | None = None,
    reason: str = "no particle is good",
    bonus: Callable[[IntArray, FloatArray], FloatArray] | None = None,
) -> Plan:
    """Return the plan that trajectories amount to: checked and put in order.

    Args:
        problem: to be solved.
        trajectories: (P, T, D).
        costs: what is known already of each particle, each (P,), `prior` or `length` among them.
        settings: see `assess`.
        weights: (P, K, D) of the primitive, if there is one.
        components: (P,), see `Plan`.
        reason: what the plan's message begins with if no particle is good.
        bonus: from homotopy classes and durations of particles to what is added to their merit
            (P,), in units of the log-prior.
    """
    verdict = assess(problem, trajectories, settings)
    message = ""
    if not verdict.good.any():
        message = (
            f"{reason}: of {len(trajectories)} particles {int(verdict.free.sum())} are "
            f"collision-free, {int(verdict.executable.sum())} executable, "
            f"{int(verdict.passing.sum())} meet all constraints; the least bad one is chosen"
        )
    classes = signatures(problem, trajectories)
    ranks = rank(
        verdict.free,
        verdict.passing,
        verdict.executable,
        verdict.clearance,
        verdict.missed,
        costs,
        0.0 if bonus is None else bonus(classes, verdict.duration),
    )
    return Plan(
        trajectories=trajectories,
        costs=costs,
        collision_free=verdict.free,
        clearance=verdict.clearance,
        missed=verdict.missed,
        passing=verdict.passing,
        duration=verdict.duration,
        executable=verdict.executable,
        ranks=ranks,
        signatures=classes,
        weights=weights,
        components=components,
        message=message,
        standing_free=verdict.standing_free,
        apart=verdict.apart,
    )


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
    reaching = [c for c in problem.constraints if isinstance(c, Reaching)]
    ends = np.zeros(len(trajectories), np.int64)
    if reaching:
        ends = reaching[0].distances(trajectories).argmin(axis=0)
    last = trajectories.shape[1] - 1
    steps = np.unique(
        np.linspace(0, last, min(_SIGNATURE_SAMPLES, last + 1)).round().astype(np.int64)
    )
    passed: list[FloatArray] = [np.empty(0)] * len(trajectories)
    for number in np.unique(ends):
        of_goal = np.flatnonzero(ends == number)
        point = reaching[0].goals[number].point if reaching else None
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
