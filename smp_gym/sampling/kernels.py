"""Compiled inner loops of scene sampling: distances to paths of spheres, what blocks them.

An obstacle is a row of `OBSTACLE_COLUMNS` numbers: shape (index into `smp_gym.scene.SHAPES`),
position x, y, z, cosine and sine of its yaw, and its three half-extents. Paths of spheres are
(T, S, 3) arrays of centres in the base frame; all lengths are metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smp_gym.compiling import kernel
from smp_gym.geometry import registry
from smp_gym.geometry.registry import ROUND

__all__ = [
    "OBSTACLE_COLUMNS",
    "blocked_paths",
    "clear_of_itself",
    "clear_of_path",
    "group_boxes",
    "least_clearances",
    "lowest",
    "path_clearances",
    "point_distance",
    "point_distances",
]

OBSTACLE_COLUMNS = 9
"""Numbers of an obstacle's row."""

Array = NDArray[np.float64]


@kernel
def point_distance(x: float, y: float, z: float, obstacle: Array) -> float:
    """Return the signed distance of a point to an obstacle's surface, negative inside."""
    dx = x - obstacle[1]
    dy = y - obstacle[2]
    dz = z - obstacle[3]
    shape, size = int(obstacle[0]), obstacle[6:]
    # The turn would change the last digits of what does not depend on it.
    if ROUND[shape]:
        return registry.distance(shape, dx, dy, dz, size)
    a = obstacle[4] * dx + obstacle[5] * dy
    b = obstacle[4] * dy - obstacle[5] * dx
    return registry.distance(shape, a, b, dz, size)


@kernel
def point_distances(points: Array, obstacles: Array) -> Array:
    """Return the signed distances (M, N) of points (N, 3) to the surfaces of obstacles (M, 9)."""
    out = np.empty((len(obstacles), len(points)))
    for m in range(len(obstacles)):
        for n in range(len(points)):
            out[m, n] = point_distance(points[n, 0], points[n, 1], points[n, 2], obstacles[m])
    return out


@kernel
def _apart(dx: float, dy: float, dz: float, obstacle: Array, reach: float) -> bool:
    """Return whether a point is surely farther than `reach` from an obstacle, by its upright hull.

    Obstacles turn about the vertical only, so each lies within an upright cylinder. A glance at it
    spares the distance to posts and beams, whose bounding balls are large.
    """
    if abs(dz) - obstacle[8] > reach:
        return True
    flat = math.sqrt(obstacle[6] * obstacle[6] + obstacle[7] * obstacle[7]) + reach
    return flat < 0.0 or dx * dx + dy * dy > flat * flat


_GROUP = 7
"""Spheres that follow one another and are looked at through a common box first."""


@kernel
def group_boxes(centers: Array, radius: Array) -> Array:
    """Return boxes (T, G, 6) around groups of spheres on a path (T, S, 3).

    They hold the lowest and the highest x, y, z.
    """
    samples, spheres, _ = centers.shape
    boxes = np.empty((samples, (spheres + _GROUP - 1) // _GROUP, 6))
    boxes[:, :, :3], boxes[:, :, 3:] = np.inf, -np.inf
    for t in range(samples):
        for s in range(spheres):
            box = boxes[t, s // _GROUP]
            for axis in range(3):
                reach = max(0.0, radius[s])
                box[axis] = min(box[axis], centers[t, s, axis] - reach)
                box[3 + axis] = max(box[3 + axis], centers[t, s, axis] + reach)
    return boxes


@kernel
def _box_apart(box: Array, obstacle: Array, reach: float) -> bool:
    """Return whether a box is surely farther than `reach`, not negative, from an obstacle."""
    above = max(box[2] - obstacle[3], obstacle[3] - box[5])
    if above - obstacle[8] > reach:
        return True
    flat = math.sqrt(obstacle[6] * obstacle[6] + obstacle[7] * obstacle[7]) + reach
    dx = max(0.0, box[0] - obstacle[1], obstacle[1] - box[3])
    dy = max(0.0, box[1] - obstacle[2], obstacle[2] - box[4])
    return dx * dx + dy * dy > flat * flat


@kernel
def path_clearances(
    centers: Array, radius: Array, boxes: Array, obstacles: Array, enough: float
) -> Array:
    """Return the least distance between spheres on a path and each obstacle.

    Args:
        centers: (T, S, 3).
        radius: (S,).
        boxes: of `group_boxes`.
        obstacles: (M, 9) rows.
        enough: greater distances are given as this.

    Returns:
        (M,), negative where they overlap.
    """
    out = np.full(len(obstacles), enough)
    for m in range(len(obstacles)):
        obstacle = obstacles[m]
        for t in range(centers.shape[0]):
            for g in range(boxes.shape[1]):
                if _box_apart(boxes[t, g], obstacle, max(0.0, out[m])):
                    continue
                for s in range(g * _GROUP, min((g + 1) * _GROUP, centers.shape[1])):
                    dx = centers[t, s, 0] - obstacle[1]
                    dy = centers[t, s, 1] - obstacle[2]
                    dz = centers[t, s, 2] - obstacle[3]
                    if _apart(dx, dy, dz, obstacle, out[m] + radius[s]):
                        continue
                    distance = point_distance(
                        centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], obstacle
                    )
                    out[m] = min(out[m], distance - radius[s])
    return out


@kernel
def _is_clear(
    centers: Array, radius: Array, boxes: Array, obstacle: Array, clearance: float
) -> bool:
    """Return whether an obstacle keeps a clearance from a path's spheres."""
    for t in range(centers.shape[0]):
        for g in range(boxes.shape[1]):
            if _box_apart(boxes[t, g], obstacle, max(0.0, clearance)):
                continue
            for s in range(g * _GROUP, min((g + 1) * _GROUP, centers.shape[1])):
                dx = centers[t, s, 0] - obstacle[1]
                dy = centers[t, s, 1] - obstacle[2]
                dz = centers[t, s, 2] - obstacle[3]
                if _apart(dx, dy, dz, obstacle, clearance + radius[s]):
                    continue
                distance = point_distance(
                    centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], obstacle
                )
                if distance - radius[s] < clearance:
                    return False
    return True


@kernel
def clear_of_path(
    centers: Array, radius: Array, boxes: Array, obstacles: Array, clearance: float
) -> NDArray[np.bool_]:
    """Return which obstacles keep a clearance from a path; as `path_clearances`, but sooner done.

    Returns:
        (M,).
    """
    out = np.empty(len(obstacles), np.bool_)
    for m in range(len(obstacles)):
        out[m] = _is_clear(centers, radius, boxes, obstacles[m], clearance)
    return out


@kernel
def _meets(centers: Array, radius: Array, boxes: Array, obstacle: Array) -> bool:
    """Return whether an obstacle meets a path's spheres, of which groups lie in boxes."""
    for t in range(centers.shape[0]):
        for g in range(boxes.shape[1] - 1, -1, -1):
            if _box_apart(boxes[t, g], obstacle, 0.0):
                continue
            for s in range(g * _GROUP, min((g + 1) * _GROUP, centers.shape[1])):
                dx = centers[t, s, 0] - obstacle[1]
                dy = centers[t, s, 1] - obstacle[2]
                dz = centers[t, s, 2] - obstacle[3]
                if _apart(dx, dy, dz, obstacle, radius[s]):
                    continue
                distance = point_distance(
                    centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], obstacle
                )
                if distance <= radius[s]:
                    return True
    return False


@kernel
def blocked_paths(
    centers: Array, radius: Array, obstacles: Array, depth: float
) -> NDArray[np.bool_]:
    """Return which paths each obstacle blocks.

    Args:
        centers: (N, T, S, 3).
        radius: (S,).
        obstacles: (M, 9) rows.
        depth: how deep an obstacle must reach into a sphere to block it; guards against calling
            blocked what only the cover of spheres touches. Where it is negative, an obstacle blocks
            already from that far away.

    Returns:
        (M, N).
    """
    out = np.zeros((len(obstacles), len(centers)), np.bool_)
    if len(obstacles) == 0:
        return out
    inner = radius - depth
    for n in range(len(centers)):
        boxes = group_boxes(centers[n], inner)
        for m in range(len(obstacles)):
            out[m, n] = _meets(centers[n], inner, boxes, obstacles[m])
    return out


@kernel
def least_clearances(centers: Array, radius: Array, obstacles: Array, enough: float) -> Array:
    """Return the least distance of each path's spheres to any obstacle, (N,).

    Args:
        centers: (N, T, S, 3).
        radius: (S,).
        obstacles: (M, 9) rows.
        enough: greater distances are given as this.
    """
    out = np.full(len(centers), enough)
    for n in range(len(centers)):
        boxes = group_boxes(centers[n], radius)
        for clearance in path_clearances(centers[n], radius, boxes, obstacles, enough):
            out[n] = min(out[n], clearance)
    return out


@kernel
def lowest(centers: Array, radius: Array) -> Array:
    """Return the height of the lowest point of each path's spheres, (N,), of (N, T, S, 3) paths."""
    out = np.full(len(centers), np.inf)
    for n in range(centers.shape[0]):
        for t in range(centers.shape[1]):
            for s in range(centers.shape[2]):
                out[n] = min(out[n], centers[n, t, s, 2] - radius[s])
    return out


@kernel
def clear_of_itself(
    centers: Array, radius: Array, pairs: NDArray[np.int64], clearance: float
) -> bool:
    """Return whether paired spheres keep a clearance from each other all along a path.

    Args:
        centers: (T, S, 3).
        radius: (S,).
        pairs: (P, 2) indices of spheres that may not touch.
        clearance: not negative.
    """
    for t in range(centers.shape[0]):
        for p in range(len(pairs)):
            a = pairs[p, 0]
            b = pairs[p, 1]
            dx = centers[t, a, 0] - centers[t, b, 0]
            dy = centers[t, a, 1] - centers[t, b, 1]
            dz = centers[t, a, 2] - centers[t, b, 2]
            least = radius[a] + radius[b] + clearance
            if dx * dx + dy * dy + dz * dz < least * least:
                return False
    return True
