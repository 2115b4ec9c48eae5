"""`rrt_connect`: RRT-Connect in joint space, with shortcuts and smoothing. The sampling baseline.

What one would take who has no demonstrations to keep to. Randomness comes from the problem's seed
and budgets are counts, so a plan depends neither on the machine nor on what was planned before.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from smp_planner.edge_check import EdgeChecker, edge_is_free, new_scratch
from smp_planner.movement_primitives import phases
from smp_planner.planners.base import (
    SAMPLES,
    PlannerModel,
    PlannerSettings,
    Stopwatch,
    jaco_with,
)
from smp_planner.planners.judging import choose, goal_distance, missed_via_points
from smp_planner.problem import Plan, Problem
from smp_planner.robot_model import RobotModel
from smp_planner.shortcutting import path_length, shortcut, smooth, stop_at_corners
from smp_planner.verification import TOLERANCE, check_collisions, verify

__all__ = ["RRTConnectPlanner", "RRTConnectSettings", "goal_postures", "rrt_connect", "solve"]

FloatArray = NDArray[np.float64]

_CONTROL_POINTS = (7, 10, 14, 20, 28, 40, 56, 80)
"""Of the splines that are tried, from smooth to true to the path."""


@njit(cache=True, nogil=True)
def _nearest(nodes, count, target):
    """Return the index of the nearest of the first `count` nodes (N,n) to a configuration."""
    best, index = np.inf, -1
    for i in range(count):
        square = 0.0
        for j in range(target.shape[0]):
            square += (nodes[i, j] - target[j]) ** 2
        if square < best:
            best, index = square, i
    return index


@njit(cache=True, nogil=True)
def _extend(world, scratch, nodes, parents, count, source, target, step):
    """Write the node that is one step from `source` towards a target.

    Returns:
        0 if the way there is not free, 2 if the node is the target, else 1.
    """
    distance = 0.0
    for j in range(target.shape[0]):
        distance += (target[j] - nodes[source, j]) ** 2
    distance = math.sqrt(distance)
    last = distance <= step
    for j in range(target.shape[0]):
        here = nodes[source, j]
        nodes[count, j] = target[j] if last else here + step / distance * (target[j] - here)
    if not edge_is_free(world, scratch, nodes[source], nodes[count]):
        return 0
    parents[count] = source
    return 2 if last else 1


@njit(cache=True, nogil=True)
def _search(world, samples, step, nodes, parents, counts):
    """Grow both trees until they meet; return the nodes where they do, or (-1, -1).

    Args:
        world: an `edge_check.World`.
        samples: (I,n), towards which the trees grow.
        step: rad, longest edge.
        nodes: (2,N,n) of the tree from the start and of that from the goals; the roots are given.
        parents: (2,N) indices, -1 for roots.
        counts: (2,) how many nodes there are.
    """
    scratch = new_scratch(world)
    room = nodes.shape[1]
    for i in range(samples.shape[0]):
        tree = i % 2
        target, greedy = samples[i], False
        # First one tree takes a step, then the other goes as far as it comes.
        while True:
            node = _nearest(nodes[tree], counts[tree], target)
            outcome = 1
            while outcome == 1:
                if counts[tree] == room:
                    return -1, -1
                outcome = _extend(
                    world, scratch, nodes[tree], parents[tree], counts[tree], node, target, step
                )
                if outcome > 0:
                    node = counts[tree]
                    counts[tree] += 1
                if not greedy:
                    break
            if greedy and outcome == 2:
                met = counts[1 - tree] - 1
                return (node, met) if tree == 0 else (met, node)
            if greedy or outcome == 0:
                break
            target, greedy = nodes[tree, node], True
            tree = 1 - tree
    return -1, -1


def _endless(robot: RobotModel) -> NDArray[np.bool_]:
    """Return (n,) which joints reach the same place in more than one way."""
    return np.asarray(robot.upper - robot.lower > 2 * np.pi)


def _branch(nodes: FloatArray, parents: NDArray[np.int64], leaf: int) -> FloatArray:
    """Return the configurations (V,n) from a leaf to its root."""
    indices = [leaf]
    while parents[indices[-1]] >= 0:
        indices.append(int(parents[indices[-1]]))
    return nodes[indices]


def rrt_connect(
    start: ArrayLike,
    goals: ArrayLike,
    checker: EdgeChecker,
    rng: np.random.Generator,
    *,
    iterations: int = 10_000,
    step: float = 0.5,
) -> FloatArray | None:
    """Return a path from a configuration to one of several others, or None if none was found.

    Kuffner & LaValle 2000, Fig. 5: two trees; one grows a step towards a random configuration, the
    other as far as it comes towards what the first one gained; then they change places. All goals
    are roots of the second tree. The first step is towards the first goal; after that,
    configurations are drawn evenly within the joint limits, those of joints with more than one turn
    within half a turn of the start.

    Args:
        start: (n,) rad.
        goals: (G,n) rad; those that are not free are passed over.
        checker: says what is free.
        rng: source of all randomness.
        iterations: how often a tree takes a step, at most.
        step: rad, longest edge.

    Returns:
        (V,n) rad, its edges free.

    Raises:
        ValueError: wrong shape, not finite, or `iterations` or `step` not positive.
    """
    robot = checker.robot
    root = np.ascontiguousarray(start, np.float64)
    ends = np.ascontiguousarray(goals, np.float64)
    if root.shape != (robot.joints,) or not np.isfinite(root).all():
        raise ValueError(f"start must be {robot.joints} finite numbers, got {start!r}")
    if ends.ndim != 2 or ends.shape[1] != robot.joints or not np.isfinite(ends).all():
        raise ValueError(f"goals must be finite, of shape (G, {robot.joints}), got {ends.shape}")
    if iterations < 1:
        raise ValueError(f"iterations must be at least 1, got {iterations}")
    if not (math.isfinite(step) and step > 0.0):
        raise ValueError(f"step must be positive, got {step}")
    ends = ends[checker.configurations_free(ends)]
    if not len(ends) or not checker.configurations_free(root[None])[0]:
        return None
    reach = np.where(_endless(robot), np.pi, np.inf)
    lower, upper = np.maximum(robot.lower, root - reach), np.minimum(robot.upper, root + reach)
    samples = rng.uniform(lower, upper, (iterations, robot.joints))
    samples[0] = ends[0]
    room = len(ends) + 8 * iterations
    nodes = np.empty((2, room, robot.joints))
    parents = np.empty((2, room), np.int64)
    counts = np.array([1, len(ends)])
    for tree, roots in enumerate((root[None], ends)):
        nodes[tree, : len(roots)] = roots
        parents[tree, : len(roots)] = -1
    met = _search(checker.world, samples, float(step), nodes, parents, counts)
    if met[0] < 0:
        return None
    there = _branch(nodes[0], parents[0], met[0])[::-1]
    # Both branches end in the configuration where the trees met.
    return np.concatenate([there, _branch(nodes[1], parents[1], met[1])[1:]])


def goal_postures(
    problem: Problem,
    robot: RobotModel,
    postures: ArrayLike,
    rng: np.random.Generator,
    *,
    count: int = 64,
    spread: float = 0.2,
) -> FloatArray:
    """Return configurations that reach the problem's goals, found by inverse kinematics.

    Damped least squares from random neighbours of given postures to random points of the inner
    half of the goal regions; what orientation the hand keeps is left to the postures.

    Args:
        problem: gives the goals; their endless joints are turned to be near its start.
        robot: the arm.
        postures: (N,n) rad, for example the last configurations of demonstrations.
        rng: source of all randomness.
        count: how many are tried.
        spread: rad, standard deviation of the neighbours.

    Returns:
        (G,n) rad, within the joint limits, in the order in which they were drawn, not yet checked
        for collisions; possibly none.

    Raises:
        ValueError: `postures` has the wrong shape or is not finite.
    """
    given = np.asarray(postures, np.float64)
    if given.ndim != 2 or given.shape[1] != robot.joints or not len(given):
        raise ValueError(f"postures must have shape (N, {robot.joints}), got {given.shape}")
    if not np.isfinite(given).all():
        raise ValueError("postures must be finite, got NaN or infinity")
    of_goal = np.arange(count) % len(problem.goals)
    q = given[rng.integers(len(given), size=count)]
    q = q + spread * rng.standard_normal(q.shape)
    inner = 0.25 + 0.5 * rng.random((count, 3))
    error = np.full(count, np.inf)
    for index, goal in enumerate(problem.goals):
        mine = of_goal == index
        if not mine.any():
            break
        target = goal.lower + inner[mine] * (goal.upper - goal.lower)
        near = q[mine]
        for _ in range(30):
            point, jacobian = robot.carried_points(near, goal.point)
            offset = target - point
            square = jacobian @ jacobian.swapaxes(1, 2) + 1e-6 * np.eye(3)
            change = (jacobian.swapaxes(1, 2) @ np.linalg.solve(square, offset[..., None]))[..., 0]
            largest = np.abs(change).max(axis=1, keepdims=True)
            change *= np.minimum(1.0, 0.3 / np.maximum(largest, 1e-12))
            near = np.clip(near + change, robot.lower, robot.upper)
            if largest.max() < 1e-6:
                break
        q[mine] = near
        point = robot.carried_points(near, goal.point)[0]
        error[mine] = np.linalg.norm(target - point, axis=1)
    turns = np.where(_endless(robot), np.round((q - problem.start) / (2 * np.pi)), 0.0)
    turned = q - 2 * np.pi * turns
    within = (turned >= robot.lower) & (turned <= robot.upper)
    return np.where(within, turned, q)[error < 1e-3]


class RRTConnectSettings(PlannerSettings):
    """Settings of RRT-Connect.

    Attributes:
        particles: P, size of the set: so many searches, each with randomness of its own.
        margin: m, distance to keep to obstacles.
        iterations: of a search, at most.
        step: rad, longest edge of the trees.
        postures: how many goal configurations are tried.
        posture_spread: rad, how far around the demonstrations' last configurations.
        shortcuts: iterations of shortcutting.
    """

    particles: int = Field(default=4, ge=1)
    margin: float = Field(default=0.005, ge=TOLERANCE, allow_inf_nan=False)
    iterations: int = Field(default=5_000, ge=1)
    step: float = Field(default=0.5, gt=0.0, allow_inf_nan=False)
    postures: int = Field(default=64, ge=1)
    posture_spread: float = Field(default=0.2, ge=0.0, allow_inf_nan=False)
    shortcuts: int = Field(default=100, ge=0)


def _timed(path: FloatArray, problem: Problem, robot: RobotModel, margin: float) -> FloatArray:
    """Return the smoothest trajectory (T, n) along a path that keeps the margin.

    The path itself does, so that there always is one: in the worst case it stops at each corner.
    """
    splines = np.stack([smooth(path, robot.velocity, n, SAMPLES) for n in _CONTROL_POINTS])
    for spline in splines:
        check = check_collisions(spline[None], robot, problem.obstacles)
        if check.free[0] and check.clearance[0] >= margin:
            return spline
    return stop_at_corners(path, robot.velocity, SAMPLES)


def _one(
    problem: Problem,
    checker: EdgeChecker,
    goals: FloatArray,
    index: int,
    settings: RRTConnectSettings,
) -> FloatArray | None:
    """Return the trajectory (T, n) of one of several independent searches, or None."""
    rng = np.random.default_rng([problem.seed, 2, index])
    path = rrt_connect(
        problem.start, goals, checker, rng, iterations=settings.iterations, step=settings.step
    )
    if path is None:
        return None
    path = shortcut(path, checker, settings.shortcuts, rng)
    return _timed(path, problem, checker.robot, checker.world.margin)


def _check_single_stage(problem: Problem) -> None:
    if problem.via_poses or problem.stages:
        raise ValueError(
            "rrt_connect searches from a start to a goal; it cannot solve problems with via-poses "
            f"or stages, got {len(problem.via_poses)} and {len(problem.stages)}"
        )


def _approach(
    problem: Problem, robot: RobotModel, postures: ArrayLike, settings: RRTConnectSettings
) -> tuple[EdgeChecker, FloatArray]:
    """Return what is free, and the free configurations (G,n) at the goals, possibly none.

    Where the start or all goals are nearer to something than the margin, the least one is taken.
    """
    rng = np.random.default_rng([problem.seed, 1])
    goals = goal_postures(
        problem,
        robot,
        postures,
        rng,
        count=settings.postures,
        spread=settings.posture_spread,
    )
    for margin in (settings.margin, TOLERANCE):
        checker = EdgeChecker(robot, problem.obstacles, margin)
        free = goals[checker.configurations_free(goals)]
        if len(free) and checker.configurations_free(problem.start[None])[0]:
            break
    return checker, free


def solve(
    problem: Problem, postures: ArrayLike, settings: RRTConnectSettings | None = None
) -> FloatArray | None:
    """Return one collision-free trajectory that solves a problem, or None if none was found.

    Args:
        problem: to be solved; its seed decides all that is random.
        postures: (N,6) rad, around which configurations that reach a goal are sought, for example
            the last configurations of demonstrations.
        settings: budgets; `particles` is not used.

    Returns:
        (T,6) rad, from rest to rest at equal steps of phase.

    Raises:
        ValueError: `postures` has the wrong shape or is not finite, or the problem has via-poses or
            stages.
    """
    _check_single_stage(problem)
    settings = settings or RRTConnectSettings()
    checker, goals = _approach(problem, jaco_with(problem), postures, settings)
    return _one(problem, checker, goals, 0, settings)


class RRTConnectPlanner(PlannerModel):
    """Independent RRT-Connect solutions, shortened and smoothed.

    The demonstrations lend the postures at the goal and, for the plan's `weights` and its cost
    `prior`, the primitive: the weights of a particle are those whose trajectory is nearest to its
    own in the sense of least squares. What is verified and executed is the trajectory itself.
    """

    name = "rrt_connect"
    Settings = RRTConnectSettings
    settings: RRTConnectSettings

    def _plan(self, problem: Problem) -> Plan:
        _check_single_stage(problem)
        settings = self.settings
        stopwatch = Stopwatch()
        with stopwatch.stage("conditioning"):
            robot = jaco_with(problem)
            tied = self.tie(problem, robot)
        with stopwatch.stage("goals"):
            postures = np.array([path[-1] for path in self.demonstrations.configurations])
            checker, goals = _approach(problem, robot, postures, settings)
        with stopwatch.stage("search"):
            found = [
                _one(problem, checker, goals, index, settings)
                for index in range(settings.particles)
            ]
        with stopwatch.stage("verification"):
            # Where no path was found the straight one stands, so that the set has its size.
            end = goals[0] if len(goals) else tied.posture
            straight = stop_at_corners(np.stack([problem.start, end]), robot.velocity, SAMPLES)
            trajectories = np.stack([straight if path is None else path for path in found])
            verdict = verify(trajectories, robot, problem.obstacles, settings.duration_limit)
            goal_error = goal_distance(problem, robot, trajectories[:, -1])
            basis = tied.primitive.basis.values(phases(SAMPLES))
            weights = torch.linalg.pinv(basis) @ torch.from_numpy(trajectories)
            latent = tied.primitive.whiten(weights.flatten(-2))
            costs = {
                "prior": 0.5 * latent.square().sum(-1).numpy(),
                "length": np.array([path_length(path) for path in trajectories]),
            }
            missed = missed_via_points(problem, robot, trajectories)
            chosen = choose(verdict, goal_error, missed, costs)
        message = ""
        if not (verdict.collision_free & verdict.executable).any():
            message = (
                f"no path was found: {len(goals)} of {settings.postures} configurations at the "
                f"goal are free, {sum(path is not None for path in found)} of "
                f"{settings.particles} searches succeeded within {settings.iterations} iterations"
            )
        return Plan(
            weights=weights.numpy(),
            trajectories=trajectories,
            costs=costs,
            collision_free=verdict.collision_free,
            clearance=verdict.clearance,
            goal_error=goal_error,
            duration=verdict.duration,
            executable=verdict.executable,
            chosen=chosen,
            timings=stopwatch.timings,
            message=message,
            passing=missed <= 0.0,
        )
