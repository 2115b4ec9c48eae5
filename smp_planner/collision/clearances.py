"""Clearances of single configurations with their derivatives, for constraints that must hold.

A cost sums the spheres up; a constraint asks for each of them. Clearances are functions of one
configuration: of the spheres of a robot on a map, and of its joints to their limits.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.robot.forward_kernels import link_poses, place
from smp_planner.collision.robot_model import RobotModel
from smp_planner.occupancy.grid import DistanceGrid, lookup

__all__ = ["Clearances", "JointLimitClearances", "SphereClearances"]

_TOGETHER = 64
"""Configurations that are taken through the chain at once, to keep them in cache."""


class Clearances(Protocol):
    """M clearances of a configuration; m or rad for a robot, or extents."""

    def __call__(self, configurations: FloatArray) -> FloatArray:
        """Return clearances (N, M) of configurations (N, D)."""
        ...

    def pull_back(self, configurations: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the gradient (N, D) of what has the derivatives (N, M) by the clearances."""
        ...


def _checked(configurations: Any, dimension: int, slopes: Any = None, count: int = 0) -> FloatArray:
    """Return configurations (N, D) as a contiguous array.

    Raises:
        ValueError: they are not of that shape or not finite, or the slopes are not (N, M).
    """
    q = np.ascontiguousarray(configurations, np.float64)
    if q.ndim != 2 or q.shape[1] != dimension:
        raise ValueError(f"configurations must have shape (N, {dimension}), got {q.shape}")
    if not np.isfinite(q).all():
        raise ValueError("configurations must be finite, got NaN or infinity")
    if slopes is not None and np.shape(slopes) != (len(q), count):
        raise ValueError(f"slopes must have shape {(len(q), count)}, got {np.shape(slopes)}")
    return q


@kernel(fastmath=FAST)
def _posed(configurations, begin, robot, sine, cosine, rotation, position, placed):
    """Write the poses of links and spheres of `_TOGETHER` configurations, the last one repeated."""
    base, origins, prismatic, link, center, _ = robot
    count, joints = configurations.shape
    for k in range(joints):
        for t in range(_TOGETHER):
            sine[k, t] = configurations[min(begin + t, count - 1), k]
    link_poses(sine.copy(), prismatic, base, origins, sine, cosine, rotation, position)
    place(rotation, position, link, center, placed)


@kernel(fastmath=FAST)
def _sphere_clearances(configurations, robot, grid, clearance):
    """Write the clearances (N,S) of spheres.

    Args:
        configurations: (N,n) rad or m.
        robot: base (4,4), origins (n,4,4), prismatic (n,), and link (S,), centre (S,3) m and
            radius (S,) m of the spheres.
        grid: (X,Y,Z) signed distances in m, (3,) position of the first, and 1/m inverse spacing.
        clearance: (N,S) m, written.
    """
    values, origin, inv_spacing = grid
    link, radius = robot[3], robot[5]
    count, joints = configurations.shape
    sine, cosine = np.empty((joints, _TOGETHER)), np.empty((joints, _TOGETHER))
    rotation = np.empty((joints + 1, 3, 3, _TOGETHER))
    position = np.empty((joints + 1, 3, _TOGETHER))
    placed = np.empty((link.shape[0], 3, _TOGETHER))
    for begin in range(0, count, _TOGETHER):
        _posed(configurations, begin, robot, sine, cosine, rotation, position, placed)
        for s in range(link.shape[0]):
            for t in range(min(_TOGETHER, count - begin)):
                found = lookup(
                    values, origin, inv_spacing, placed[s, 0, t], placed[s, 1, t], placed[s, 2, t]
                )
                clearance[begin + t, s] = found[0] - radius[s]


@kernel(fastmath=FAST)
def _pull_back(configurations, robot, grid, slopes, gradient):
    """Write the gradient (N,n) of what has the derivatives (N,S) by the clearances of spheres.

    As for the costs (`smp_planner.collision.kernels`), forces on the spheres are summed from the
    tip to the base and projected on the joint axes.

    Args:
        configurations: as of `_sphere_clearances`, like the next two.
        robot: see there.
        grid: see there.
        slopes: (N,S) 1/m.
        gradient: (N,n) 1/rad or 1/m, written.
    """
    values, origin, inv_spacing = grid
    prismatic, link = robot[2], robot[3]
    count, joints = configurations.shape
    sine, cosine = np.empty((joints, _TOGETHER)), np.empty((joints, _TOGETHER))
    rotation = np.empty((joints + 1, 3, 3, _TOGETHER))
    position = np.empty((joints + 1, 3, _TOGETHER))
    placed = np.empty((link.shape[0], 3, _TOGETHER))
    wrench = np.empty((joints + 1, 6))
    for begin in range(0, count, _TOGETHER):
        _posed(configurations, begin, robot, sine, cosine, rotation, position, placed)
        for t in range(min(_TOGETHER, count - begin)):
            wrench[:] = 0.0
            for s in range(link.shape[0]):
                slope = slopes[begin + t, s]
                if slope == 0.0:
                    continue
                x, y, z = placed[s, 0, t], placed[s, 1, t], placed[s, 2, t]
                _, fx, fy, fz = lookup(values, origin, inv_spacing, x, y, z)
                fx, fy, fz = slope * fx, slope * fy, slope * fz
                on = wrench[link[s]]
                on[0] += fx
                on[1] += fy
                on[2] += fz
                on[3] += y * fz - z * fy
                on[4] += z * fx - x * fz
                on[5] += x * fy - y * fx
            for k in range(joints, 0, -1):
                fx, fy, fz, mx, my, mz = wrench[k]
                x, y, z = position[k, 0, t], position[k, 1, t], position[k, 2, t]
                gradient[begin + t, k - 1] = (
                    rotation[k, 0, 2, t] * (mx - (y * fz - z * fy))
                    + rotation[k, 1, 2, t] * (my - (z * fx - x * fz))
                    + rotation[k, 2, 2, t] * (mz - (x * fy - y * fx))
                )
                for i in range(6):
                    wrench[k - 1, i] += wrench[k, i]
            for k in range(1, joints + 1):
                if prismatic[k - 1]:
                    # The force along the axis, of all that is beyond the joint.
                    gradient[begin + t, k - 1] = (
                        rotation[k, 0, 2, t] * wrench[k, 0]
                        + rotation[k, 1, 2, t] * wrench[k, 1]
                        + rotation[k, 2, 2, t] * wrench[k, 2]
                    )


@dataclass(frozen=True, eq=False)
class SphereClearances:
    """Clearances of the moving spheres of a robot from what is on a map, m.

    Attributes:
        robot: the arm and what it carries; spheres on link 0 do not move and are left out, so that
            M is `CollisionCost.summed_spheres`.
        grid: the scene's map.
    """

    robot: RobotModel
    grid: DistanceGrid

    @cached_property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        robot = self.robot
        moves = robot.link > 0
        return (
            robot.base,
            robot.joint_origins,
            robot.prismatic,
            robot.link[moves],
            robot.center[moves],
            robot.radius[moves],
        )

    @property
    def _map(self) -> tuple[Any, FloatArray, float]:
        return self.grid.values, self.grid.origin, 1.0 / self.grid.spacing

    def __call__(self, configurations: FloatArray) -> FloatArray:
        """Return clearances (N, M) m of configurations (N, n) rad or m, negative in collision.

        Raises:
            ValueError: wrong shape or not finite.
        """
        q = _checked(configurations, self.robot.joints)
        clearance = np.empty((len(q), len(self._arrays[3])))
        _sphere_clearances(q, self._arrays, self._map, clearance)
        return clearance

    def pull_back(self, configurations: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the gradient (N, n) 1/rad or 1/m of what has the derivatives (N, M) 1/m.

        Raises:
            ValueError: wrong shapes or not finite.
        """
        q = _checked(configurations, self.robot.joints, slopes, len(self._arrays[3]))
        gradient = np.empty(q.shape)
        _pull_back(q, self._arrays, self._map, np.ascontiguousarray(slopes, np.float64), gradient)
        return gradient


@dataclass(frozen=True, eq=False)
class JointLimitClearances:
    """Distances, rad or m, of joints from their lower and their upper limits: M = 2 n.

    Attributes:
        lower: (n,) rad or m.
        upper: (n,) rad or m.
    """

    lower: FloatArray
    upper: FloatArray

    def __call__(self, configurations: FloatArray) -> FloatArray:
        """Return (N, 2 n) rad or m: how far above the lower limits, then how far below the upper.

        Raises:
            ValueError: wrong shape or not finite.
        """
        q = _checked(configurations, len(self.lower))
        return np.concatenate([q - self.lower, self.upper - q], axis=1)

    def pull_back(self, configurations: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the gradient (N, n) of what has the derivatives (N, 2 n) by the clearances.

        Raises:
            ValueError: wrong shapes or not finite.
        """
        joints = len(self.lower)
        _checked(configurations, joints, slopes, 2 * joints)
        return np.asarray(slopes[:, :joints] - slopes[:, joints:])
