"""Compiled inverse kinematics from a near start: a few Newton steps, no search.

Where sampling needs a configuration it knows one nearby, from the demonstrations; the search of
`smp_gym.robot.kinematics.inverse_kinematics` would take a hundred times as long.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smp_gym.compiling import kernel
from smp_gym.robot import kinematics

__all__ = ["reach_points", "reach_pose"]

_ITERATIONS = 12
_TOLERANCE = 1e-7
_LARGEST_STEP = 0.3

Array = NDArray[np.float64]


@kernel
def _frames(configuration: Array, base: Array, origins: Array) -> Array:
    """Return the (7, 4, 4) transforms from the base frame to the links.

    In another order of sums than `exact_chain`: scenes depend on the last bit of it.
    """
    frames = np.zeros((7, 4, 4))
    frames[0] = base
    turn = np.zeros((4, 4))
    turn[2, 2] = turn[3, 3] = 1.0
    for k in range(6):
        c, s = math.cos(configuration[k]), math.sin(configuration[k])
        turn[0, 0] = turn[1, 1] = c
        turn[0, 1], turn[1, 0] = -s, s
        frames[k + 1] = _product(frames[k], _product(origins[k], turn))
    return frames


@kernel
def _product(a: Array, b: Array) -> Array:
    out = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            for k in range(4):
                out[i, j] += a[i, k] * b[k, j]
    return out


@kernel
def _solved(matrix: Array, right: Array) -> Array:
    """Return the solution of a small linear system, by elimination with pivots."""
    count = len(right)
    a, x = matrix.copy(), right.copy()
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        for j in range(count):
            a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        x[k], x[pivot] = x[pivot], x[k]
        for i in range(k + 1, count):
            share = a[i, k] / a[k, k]
            for j in range(k, count):
                a[i, j] -= share * a[k, j]
            x[i] -= share * x[k]
    for k in range(count - 1, -1, -1):
        for j in range(k + 1, count):
            x[k] -= a[k, j] * x[j]
        x[k] /= a[k, k]
    return x


@kernel
def _newton(
    near: Array, target: Array, tool: Array, rotate: bool, base: Array, origins: Array
) -> tuple[Array, float]:
    """Return the configuration that least steps from `near` lead to, and its error in m and rad.

    Each step is the shortest that solves the linearised problem, damped a little.
    """
    q = near.copy()
    rows = 6 if rotate else 3
    error = np.zeros(rows)
    jacobian = np.zeros((rows, 6))
    gram = np.zeros((rows, rows))
    step = np.zeros(6)
    for _ in range(_ITERATIONS):
        frames = _frames(q, base, origins)
        hand = _product(frames[6], tool)
        for i in range(3):
            error[i] = target[i, 3] - hand[i, 3]
        if rotate:
            error[3:] = 0.0
            for j in range(3):
                a, b = hand[:, j], target[:, j]
                error[3] += 0.5 * (a[1] * b[2] - a[2] * b[1])
                error[4] += 0.5 * (a[2] * b[0] - a[0] * b[2])
                error[5] += 0.5 * (a[0] * b[1] - a[1] * b[0])
        size = np.abs(error).max()
        if size < _TOLERANCE:
            return q, size
        for k in range(6):
            axis, at = frames[k + 1, :3, 2], frames[k + 1, :3, 3]
            x, y, z = hand[0, 3] - at[0], hand[1, 3] - at[1], hand[2, 3] - at[2]
            jacobian[0, k] = axis[1] * z - axis[2] * y
            jacobian[1, k] = axis[2] * x - axis[0] * z
            jacobian[2, k] = axis[0] * y - axis[1] * x
            if rotate:
                jacobian[3:, k] = axis
        for i in range(rows):
            for j in range(rows):
                gram[i, j] = 1e-9 if i == j else 0.0
                for k in range(6):
                    gram[i, j] += jacobian[i, k] * jacobian[j, k]
        pull = _solved(gram, error)
        for k in range(6):
            step[k] = 0.0
            for i in range(rows):
                step[k] += jacobian[i, k] * pull[i]
        scale = min(1.0, _LARGEST_STEP / max(np.abs(step).max(), 1e-12))
        for k in range(6):
            q[k] += scale * step[k]
    return q, np.inf


@kernel
def _each_point(near: Array, target: Array, tool: Array, base: Array, origins: Array) -> Array:
    out = np.full(near.shape, np.nan)
    for n in range(len(near)):
        q, error = _newton(near[n], target, tool, False, base, origins)
        if error < _TOLERANCE:
            out[n] = q
    return out


def reach_pose(pose: Array, near: Array) -> Array:
    """Return the configuration (6,) rad next to another whose end effector is at a pose.

    Args:
        pose: (4, 4) of the end effector in the base frame.
        near: (6,) rad.

    Raises:
        UnreachableError: the steps from there do not lead to one.
    """
    target = np.ascontiguousarray(pose, np.float64)
    q, error = _newton(
        np.asarray(near, np.float64),
        target,
        kinematics.END_EFFECTOR,
        True,
        kinematics.BASE_TRANSFORM,
        kinematics.JOINT_ORIGINS,
    )
    if not error < _TOLERANCE:
        raise kinematics.UnreachableError(
            f"no configuration near {near} has the end effector at {target[:3, 3]} m"
        )
    solution: Array = q
    return solution


def reach_points(position: Array, point: Array, near: Array) -> Array:
    """Return the configurations next to others at which the hand carries a point to a place.

    Args:
        position: (3,) m, in the base frame.
        point: (3,) m, carried along, in the end-effector frame.
        near: (N, 6) rad.

    Returns:
        (N, 6) rad; not a number where the steps do not lead to one.
    """
    target, tool = np.eye(4), kinematics.END_EFFECTOR.copy()
    target[:3, 3] = position
    tool[:3, 3] += tool[:3, :3] @ point
    solutions: Array = _each_point(
        np.ascontiguousarray(near),
        target,
        tool,
        kinematics.BASE_TRANSFORM,
        kinematics.JOINT_ORIGINS,
    )
    return solutions
