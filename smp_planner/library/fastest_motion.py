"""The fastest motion along a path within limits of velocity and acceleration: TOPP-RA.

Pham and Pham 2018, doi:10.1109/TRO.2018.2819195; the package `toppra`. Squared speeds are found at
points of a grid; between two of them the acceleration along the path is constant.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq

from smp_gym.arrays import FloatArray
from smp_gym.optional_packages import require
from smp_planner.library.joint_path import JointPath
from smp_planner.library.motion_limits import MotionLimits, refused_speeds, too_long

_BENT = "path has no motion within the limits: it bends too sharply"

__all__ = ["ConstantAccelerations", "fastest_motion"]

_GRID = 4
"""Points of the grid, at which limits are kept, in each interval between two samples; more, where
there are few samples."""

_LEAST_GRID = 200
"""Points of the whole grid at least: where a motion begins and ends, its speed bends sharply."""

_END_GRID = np.linspace(0.0, 1.0, 6)[1:-1] ** 3
"""Further points in the first and in the last interval of the grid, as shares of it."""

_FASTEST = 1e4
"""Speed along the path, rad/s, in place of one without limit."""

_SLOWEST = np.log(1e-9)
"""Logarithm of the least share of the fastest motion in one that is slower."""

_ROUNDING = 1e-6
"""Share of a squared speed by which TOPP-RA may miss what is allowed."""


class ConstantAccelerations:
    """A motion whose acceleration along the path is constant between points of a grid.

    Args:
        grid: (G,) rad, lengths along the path, ascending.
        speeds: (G,) rad/s, at them, no two neighbours 0.
    """

    def __init__(self, grid: FloatArray, speeds: FloatArray) -> None:
        self.grid = grid
        self.speeds = speeds
        step = np.diff(grid)
        self.accelerations = 0.5 * np.diff(speeds**2) / step
        self.times = np.append(0.0, np.cumsum(2.0 * step / (speeds[1:] + speeds[:-1])))

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        return float(self.times[-1])

    def progress(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return length, speed, acceleration and jerk along the path; see `Motion`."""
        at = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, len(self.grid) - 2)
        since = times - self.times[at]
        speed, acceleration = self.speeds[at], self.accelerations[at]
        length = self.grid[at] + speed * since + 0.5 * acceleration * since**2
        length = np.clip(length, 0.0, self.grid[-1])
        return length, speed + acceleration * since, acceleration, np.zeros(len(times))


def fastest_motion(
    path: JointPath, limits: MotionLimits, lasting: Callable[[float], float] | None = None
) -> ConstantAccelerations:
    """Return the fastest motion along a path.

    Args:
        path: that is gone through.
        limits: to be kept at the grid; those of jerk are not.
        lasting: returns how long it shall last, s, of the shortest duration; None is the shortest.

    Raises:
        ModuleNotFoundError: the package `toppra` is not installed.
        ValueError: no motion keeps the limits, with the speeds at the ends or at all.
    """
    require("timing", "timing a trajectory")
    import toppra
    from toppra.algorithm import TOPPRA

    logging.getLogger("toppra").setLevel(logging.ERROR)
    grid = _grid(path)
    greatest = np.minimum(limits.greatest_speed(path, grid), _FASTEST)
    spline = toppra.SplineInterpolator(path.knots, path.samples)
    instance = TOPPRA(_constraints(greatest, limits), spline, gridpoints=grid)
    start, end = _allowed(instance, path, limits)
    _, speeds, _ = instance.compute_parameterization(start, end)
    # It begins more slowly than asked for, where rounding leaves it no other way.
    if speeds is None or not np.isfinite(speeds).all() or speeds[0] < start * (1.0 - _ROUNDING):
        raise ValueError(_BENT)
    if lasting is None:
        return ConstantAccelerations(grid, speeds)
    turned = toppra.SplineInterpolator(path.length - path.knots[::-1], path.samples[::-1])
    back = TOPPRA(_constraints(greatest[::-1], limits), turned, gridpoints=path.length - grid[::-1])
    # The slowest motion brakes from its start and gains what its end asks for.
    slowest = np.maximum(
        instance.compute_controllable_sets(end, end)[:, 0],
        back.compute_controllable_sets(start, start)[::-1, 0],
    )
    slowest[[0, -1]] = start**2, end**2
    return _slower(grid, speeds**2, np.minimum(slowest, speeds**2), lasting)


def _grid(path: JointPath) -> FloatArray:
    intervals = len(path.knots) - 1
    points = max(_GRID, -(-_LEAST_GRID // intervals)) * intervals + 1
    grid = np.interp(np.linspace(0.0, intervals, points), np.arange(intervals + 1), path.knots)
    # From rest, speed rises fast with length.
    first, last = grid[1] * _END_GRID, path.length - (path.length - grid[-2]) * _END_GRID
    return np.sort(np.concatenate([grid, first, last]))


def _slower(
    grid: FloatArray, fast: FloatArray, slow: FloatArray, lasting: Callable[[float], float]
) -> ConstantAccelerations:
    """Return a motion between two others, whose squared speeds lie between theirs.

    Limits are linear in squared speeds, so all between keep them, too.
    """

    def between(logarithm: float) -> ConstantAccelerations:
        share = np.exp(logarithm)
        return ConstantAccelerations(grid, np.sqrt(share * fast + (1.0 - share) * slow))

    duration = lasting(between(0.0).duration)
    if between(0.0).duration >= duration:
        return between(0.0)
    longest = between(_SLOWEST).duration
    if longest < duration:
        raise too_long(longest, duration)
    excess = brentq(lambda x: between(x).duration - duration, _SLOWEST, 0.0, xtol=1e-13)
    return between(excess)


def _constraints(greatest: FloatArray, limits: MotionLimits) -> list[Any]:
    """Return toppra's constraints, with the greatest speeds at the points of its grid."""
    from toppra.constraint import (
        DiscretizationType,
        JointAccelerationConstraint,
        LinearConstraint,
    )

    class GreatestSpeed(LinearConstraint):
        def compute_constraint_params(self, *_: Any) -> tuple[Any, ...]:
            return (*(None,) * 6, np.stack([np.zeros(len(greatest)), greatest**2], axis=1))

    speed = GreatestSpeed()
    speed.dof = len(limits.velocity)
    acceleration = JointAccelerationConstraint(
        limits.acceleration, discretization_scheme=DiscretizationType.Interpolation
    )
    return [speed, acceleration]


def _allowed(instance: Any, path: JointPath, limits: MotionLimits) -> tuple[float, float]:
    """Return the speeds at start and end, put right within rounding."""
    squared_start, squared_end = limits.start_speed**2, limits.end_speed**2
    least, most = instance.compute_feasible_sets()[-1]
    if not squared_end <= most * (1.0 + _ROUNDING):
        raise refused_speeds(path, limits, "end_velocity", np.sqrt(least), np.sqrt(most))
    end = float(np.sqrt(min(squared_end, most)))
    controllable = instance.compute_controllable_sets(end, end)
    if not np.isfinite(controllable).all():
        raise ValueError(_BENT)
    least, most = controllable[0]
    if not least * (1.0 - _ROUNDING) - 1e-9 <= squared_start <= most * (1.0 + _ROUNDING):
        raise refused_speeds(path, limits, "start_velocity", np.sqrt(least), np.sqrt(most))
    return float(np.sqrt(min(squared_start, most))), end
