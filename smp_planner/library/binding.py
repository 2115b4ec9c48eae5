"""What keeps the chosen particle of a plan from being good: obstacles, links, joints, requests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle
from smp_planner.collision.verification import (
    CLEARANCE_TOLERANCE,
    LIMIT_TOLERANCE,
    minimum_duration,
)
from smp_planner.library.frame import Frame
from smp_planner.library.urdf import Robot
from smp_planner.planning.constraints import Passing
from smp_planner.planning.path_clearance import PATH_TOLERANCE
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_passing import ToolPassing

__all__ = ["what_binds"]

_MOST_NAMED = 3
"""Of one kind; how many more there are is said."""


def what_binds(
    problem: Problem,
    path: FloatArray,
    settings: PlanSettings,
    frame: Frame,
    robot: Robot | None,
    order: Sequence[int],
) -> str:
    """Return in words what a path violates, the worst of each kind first; empty if nothing.

    Args:
        problem: of one stage, in normalised coordinates.
        path: (T, D), likewise.
        settings: what may be missed, and the limit of duration.
        frame: of the user's coordinates.
        robot: whose joints they are; None for a path.
        order: numbers of the user's obstacles in the order of the problem's, a point cloud last.
    """
    found = list(_met(problem, path, robot, frame.scale, order))
    if robot is not None:
        found += [*_touched(path, robot), *_beyond_limits(path, robot, settings.duration_limit)]
    return ", ".join([*found, *_missed(problem, path, settings, robot, frame.scale)])


def _met(
    problem: Problem,
    path: FloatArray,
    robot: Robot | None,
    scale: float,
    order: Sequence[int],
) -> Iterator[str]:
    """Yield the obstacles that a path comes too near to."""
    body, (stage,) = problem.body, problem.stages
    least = PATH_TOLERANCE if robot is None else CLEARANCE_TOLERANCE
    depths: list[tuple[float, int]] = []
    waiting = [list(range(len(stage.obstacles)))]
    while waiting:
        group = waiting.pop()
        obstacles: tuple[Obstacle, ...] = tuple(stage.obstacles[index] for index in group)
        clearance = float(body.check(path[None], obstacles).clearance[0])
        if clearance >= least:
            continue
        if len(group) == 1:
            depths.append((clearance, order[group[0]]))
        else:
            half = len(group) // 2
            waiting += [group[:half], group[half:]]
    if stage.cloud is not None:
        clearance = float(body.check(path[None], (), stage.cloud).clearance[0])
        if clearance < least:
            depths.append((clearance, order[-1]))
    unit = "" if robot is None else " m"
    names = [
        f"obstacles[{index}] (clearance {scale * clearance:.3g}{unit})"
        for clearance, index in sorted(depths)
    ]
    if names:
        yield f"meets {_several(names)}"


def _touched(path: FloatArray, robot: Robot) -> Iterator[str]:
    """Yield the links that come too near to each other, at the samples of a path."""
    model = robot.model
    first, second = model.collision_pairs.T
    centers = model.sphere_centers(torch.from_numpy(np.array(path))).numpy()
    gap = np.full(len(first), np.inf)
    for posture in centers:
        apart = np.linalg.norm(posture[first] - posture[second], axis=1)
        gap = np.minimum(gap, apart - model.radius[first] - model.radius[second])
    close = np.flatnonzero(gap < CLEARANCE_TOLERANCE)
    names = robot.bodies or [f"number {index}" for index in model.link]
    pairs: dict[tuple[str, str], float] = {}
    for pair in close[np.argsort(gap[close], kind="stable")].tolist():
        pairs.setdefault((names[first[pair]], names[second[pair]]), float(gap[pair]))
    if pairs:
        links = [f"{a} by {b} ({least:.3g} m)" for (a, b), least in pairs.items()]
        yield (
            f"has links too near to each other: {_several(links)}; spheres stand out of links: a "
            "smaller overshoot= leaves more room, touching= or srdf= says what may touch"
        )


def _beyond_limits(path: FloatArray, robot: Robot, limit: float) -> Iterator[str]:
    """Yield the joint that is farthest beyond its limits, and the one that takes too long."""
    model = robot.model
    beyond = np.maximum(model.lower - path, path - model.upper).max(axis=0)
    if beyond.max() > LIMIT_TOLERANCE:
        joint = int(beyond.argmax())
        yield (
            f"has joint {robot.joints[joint]!r} beyond its limits "
            f"[{model.lower[joint]:.6g}, {model.upper[joint]:.6g}] by {beyond[joint]:.3g} "
            f"{model.units[joint]}"
        )
    duration = float(minimum_duration(path[None], model.velocity)[0])
    if duration > limit:
        joint = int((np.abs(np.diff(path, axis=0)).max(axis=0) / model.velocity).argmax())
        yield (
            f"takes {duration:.3g} s, beyond duration_limit={limit:.3g} s, for joint "
            f"{robot.joints[joint]!r} at {model.velocity[joint]:.3g} {model.units[joint]}/s"
        )


def _missed(
    problem: Problem,
    path: FloatArray,
    settings: PlanSettings,
    robot: Robot | None,
    scale: float,
) -> Iterator[str]:
    """Yield the requests that a path does not meet, and by how much."""
    units = set() if robot is None else set(robot.units)
    joints = f" {units.pop()}" if len(units) == 1 else ""
    for constraint in problem.constraints:
        unit = joints if robot is None or isinstance(constraint, Passing) else " m"
        missed = [(constraint.name, float(constraint.missed(path[None])[0]), unit)]
        if isinstance(constraint, ToolPassing) and constraint.oriented:
            turned = float(constraint.turned(path[None])[0])
            missed.append((f"the orientation of {constraint.name}", turned, " rad"))
        for name, by, unit in missed:
            if by > constraint.slack(settings):
                yield f"misses {name} by {scale * by:.3g}{unit}"


def _several(names: Sequence[str]) -> str:
    """Return the first of names, and how many more there are."""
    more = len(names) - _MOST_NAMED
    return " and ".join([*names[:_MOST_NAMED], *([f"{more} more"] if more > 0 else [])])
