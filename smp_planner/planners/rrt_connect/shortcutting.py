"""From the ragged path of a tree search to a short and smooth trajectory."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_planner.collision.edge_check import EdgeChecker, edge_is_free, new_scratch

__all__ = ["minimum_jerk", "path_length", "shortcut", "smooth", "stop_at_corners"]


def path_length(path: ArrayLike) -> float:
    """Return the length, rad, of a path (V,n) rad of straight edges in joint space."""
    return float(np.linalg.norm(np.diff(np.asarray(path, np.float64), axis=0), axis=1).sum())


@kernel
def _distance(a, b):
    total = 0.0
    for j in range(a.shape[0]):
        total += (a[j] - b[j]) ** 2
    return math.sqrt(total)


@kernel
def _without_needless_corners(world, scratch, path, count):
    """Leave out corners whose neighbours a free edge joins; return how many are left."""
    v = 1
    while v < count - 1:
        if edge_is_free(world, scratch, path[v - 1], path[v + 1]):
            for w in range(v, count - 1):
                path[w] = path[w + 1]
            count -= 1
        else:
            v += 1
    return count


@kernel
def _shortcut(world, path, count, draws):
    """Shorten `path` (V,n), of which the first `count` rows are used; return how many are left."""
    scratch = new_scratch(world)
    joints = path.shape[1]
    arc_length = np.empty(path.shape[0])
    ends = np.empty((2, joints))
    segment = np.empty(2, np.int64)
    count = _without_needless_corners(world, scratch, path, count)
    for d in range(draws.shape[0]):
        if count < 3:
            break
        arc_length[0] = 0.0
        for v in range(1, count):
            arc_length[v] = arc_length[v - 1] + _distance(path[v - 1], path[v])
        for e in range(2):
            target = (min(draws[d]) if e == 0 else max(draws[d])) * arc_length[count - 1]
            v = 0
            while v < count - 2 and arc_length[v + 1] < target:
                v += 1
            segment[e] = v
            share = (target - arc_length[v]) / max(arc_length[v + 1] - arc_length[v], 1e-12)
            ends[e] = path[v] + share * (path[v + 1] - path[v])
        first, last = segment[0], segment[1]
        if first == last or not edge_is_free(world, scratch, ends[0], ends[1]):
            continue
        # Of the corners first + 1 .. last, the two ends of the shortcut take the place.
        shift = 2 - (last - first)
        if shift > 0:
            for v in range(count - 1, last, -1):
                path[v + 1] = path[v]
        else:
            for v in range(last + 1, count):
                path[v + shift] = path[v]
        path[first + 1] = ends[0]
        path[first + 2] = ends[1]
        count += shift
    return _without_needless_corners(world, scratch, path, count)


def shortcut(
    path: ArrayLike, checker: EdgeChecker, iterations: int, rng: np.random.Generator
) -> FloatArray:
    """Return a path with the same ends that is not longer.

    Two points of the path are drawn, and what lies between them is replaced by the straight edge
    if that is free (Geraerts & Overmars 2007). Before and after, corners that can be left out are.

    Args:
        path: (V,n) rad, its edges free.
        checker: says what is free.
        iterations: how many pairs of points are drawn.
        rng: source of all randomness.

    Returns:
        (V',n) rad.

    Raises:
        ValueError: wrong shape, fewer than two configurations, or not finite.
    """
    corners = _checked_path(path)
    draws = rng.random((iterations, 2))
    # A shortcut within two neighbouring edges adds a corner.
    room = np.empty((len(corners) + iterations, corners.shape[1]))
    room[: len(corners)] = corners
    count = _shortcut(checker.world, room, len(corners), draws)
    return room[:count].copy()


def _checked_path(path: ArrayLike) -> FloatArray:
    corners = np.ascontiguousarray(path, np.float64)
    if corners.ndim != 2 or len(corners) < 2:
        raise ValueError(f"path must have shape (V, n) with V of at least 2, got {corners.shape}")
    if not np.isfinite(corners).all():
        raise ValueError("path must be finite, got NaN or infinity")
    return corners


def minimum_jerk(phase: ArrayLike) -> FloatArray:
    """Return the share of the path length at phases in [0, 1], from rest to rest.

    Flash & Hogan 1985: the polynomial of least integrated squared jerk.
    """
    s = np.asarray(phase, np.float64)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def _along(corners: FloatArray, velocity: FloatArray, shares: FloatArray) -> FloatArray:
    """Return points at shares of the time that the path takes at full speed."""
    times = (np.abs(np.diff(corners, axis=0)) / velocity).max(axis=1)
    # Edges without length would make the interpolation ambiguous.
    keep = np.append(True, times > 1e-12)
    corners, times = corners[keep], times[keep[1:]]
    if len(corners) == 1:
        return np.repeat(corners, len(shares), axis=0)
    clock = np.append(0.0, np.cumsum(times))
    return np.stack([np.interp(shares * clock[-1], clock, column) for column in corners.T], axis=1)


def _within(trajectory: FloatArray, corners: FloatArray) -> FloatArray:
    """Undo the rounding that takes a trajectory beyond its corners, which may be joint limits."""
    return np.clip(trajectory, corners.min(axis=0), corners.max(axis=0))


def smooth(path: ArrayLike, velocity: ArrayLike, points: int, samples: int) -> FloatArray:
    """Return a smooth trajectory along a path, at rest at both ends.

    A cubic B-spline whose control points stand on the path at equal distances of time at full
    speed. It stays within the convex hull of four neighbours, hence within joint limits; the more
    control points, the nearer it keeps to the path and the sharper its bends.

    Args:
        path: (V,n) rad.
        velocity: (n,) rad/s, joint velocity limits.
        points: number of control points, at least 2.
        samples: T.

    Returns:
        (T,n) rad, at equal steps of phase; ends where the path ends.

    Raises:
        ValueError: `path` of a wrong shape or not finite, or `points` is less than 2.
    """
    corners = _checked_path(path)
    if points < 2:
        raise ValueError(f"points must be at least 2, got {points}")
    control = _along(corners, np.asarray(velocity, np.float64), np.linspace(0.0, 1.0, points))
    # Mirrored neighbours make the spline end in its first and last control point, without bend.
    control = np.vstack([2 * control[0] - control[1], control, 2 * control[-1] - control[-2]])
    spline = BSpline(np.arange(-3.0, points + 3.0), control, 3)
    trajectory = spline(minimum_jerk(np.linspace(0.0, 1.0, samples)) * (points - 1))
    trajectory[0], trajectory[-1] = corners[0], corners[-1]
    return _within(trajectory, corners)


def stop_at_corners(path: ArrayLike, velocity: ArrayLike, samples: int) -> FloatArray:
    """Return a trajectory that runs exactly along a path, at rest at each corner.

    Args:
        path: (V,n) rad, with fewer corners than `samples`.
        velocity: (n,) rad/s, joint velocity limits; time is shared among the edges by them.
        samples: T.

    Returns:
        (T,n) rad, at equal steps of phase; each corner is one of them.

    Raises:
        ValueError: `path` of a wrong shape or not finite, or has more edges than there are steps.
    """
    corners = _checked_path(path)
    edges = len(corners) - 1
    if edges > samples - 1:
        raise ValueError(f"path must have at most {samples - 1} edges, got {edges}")
    times = (np.abs(np.diff(corners, axis=0)) / np.asarray(velocity, np.float64)).max(axis=1)
    total = times.sum()
    share = times / total if total > 0.0 else np.full(edges, 1.0 / edges)
    # One step for each edge, the others by time, rounded so that all are given.
    ends = np.round(np.cumsum(share) * (samples - 1 - edges)).astype(int)
    ends += np.arange(1, edges + 1)
    pieces = [corners[:1]]
    for k, steps in enumerate(np.diff(ends, prepend=0)):
        done = minimum_jerk(np.arange(1, steps + 1) / steps)[:, None]
        pieces.append(corners[k] + done * (corners[k + 1] - corners[k]))
    return _within(np.concatenate(pieces), corners)
