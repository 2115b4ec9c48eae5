"""Compiled inner loops of scene sampling: sphere paths, distances to obstacles, early exits.

An obstacle is a row of `OBSTACLE_COLUMNS` numbers: shape (index into `smp_gym.scene.SHAPES`),
position x, y, z, cosine and sine of its yaw, and its three half-extents. Paths of spheres are
(T, S, 3) arrays of centres in the base frame; all lengths are metres.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "OBSTACLE_COLUMNS",
    "best_pair",
    "blocked_paths",
    "longest_steps",
    "ones",
    "packed",
    "path_clearances",
    "point_distance",
    "rasterised",
    "self_clearance",
    "sphere_paths",
    "touched",
]

OBSTACLE_COLUMNS = 9
"""Numbers of an obstacle's row."""

_BOX, _CYLINDER = 0, 1

Array = NDArray[np.float64]


@njit(cache=True)
def sphere_paths(
    configurations: Array,
    base: Array,
    origins: Array,
    link: NDArray[np.int64],
    center: Array,
) -> Array:
    """Return the centres of link spheres for many configurations.

    Args:
        configurations: (N, 6) rad.
        base: (4, 4) transform from the base frame to link 0.
        origins: (6, 4, 4) transform from each link to the frame of the next joint at angle 0.
        link: (S,) link of each sphere.
        center: (S, 3) in the link's frame.

    Returns:
        (N, S, 3).
    """
    count, joints = configurations.shape
    spheres = len(link)
    out = np.empty((count, spheres, 3))
    frames = np.empty((joints + 1, 3, 4))
    for i in range(3):
        for j in range(4):
            frames[0, i, j] = base[i, j]
    for n in range(count):
        for k in range(joints):
            c = math.cos(configurations[n, k])
            s = math.sin(configurations[n, k])
            for i in range(3):
                a = frames[k, i, 0]
                b = frames[k, i, 1]
                d = frames[k, i, 2]
                x = a * origins[k, 0, 0] + b * origins[k, 1, 0] + d * origins[k, 2, 0]
                y = a * origins[k, 0, 1] + b * origins[k, 1, 1] + d * origins[k, 2, 1]
                frames[k + 1, i, 0] = x * c + y * s
                frames[k + 1, i, 1] = y * c - x * s
                frames[k + 1, i, 2] = (
                    a * origins[k, 0, 2] + b * origins[k, 1, 2] + d * origins[k, 2, 2]
                )
                frames[k + 1, i, 3] = (
                    a * origins[k, 0, 3]
                    + b * origins[k, 1, 3]
                    + d * origins[k, 2, 3]
                    + frames[k, i, 3]
                )
        for m in range(spheres):
            f = frames[link[m]]
            for i in range(3):
                out[n, m, i] = (
                    f[i, 0] * center[m, 0]
                    + f[i, 1] * center[m, 1]
                    + f[i, 2] * center[m, 2]
                    + f[i, 3]
                )
    return out


@njit(cache=True)
def point_distance(x: float, y: float, z: float, obstacle: Array) -> float:
    """Return the signed distance of a point to an obstacle's surface, negative inside."""
    dx = x - obstacle[1]
    dy = y - obstacle[2]
    dz = z - obstacle[3]
    if obstacle[0] == _BOX:
        u = abs(obstacle[4] * dx + obstacle[5] * dy) - obstacle[6]
        v = abs(obstacle[4] * dy - obstacle[5] * dx) - obstacle[7]
        w = abs(dz) - obstacle[8]
        outside = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
        return outside + min(max(u, max(v, w)), 0.0)
    if obstacle[0] == _CYLINDER:
        u = math.sqrt(dx * dx + dy * dy) - obstacle[6]
        w = abs(dz) - obstacle[8]
        outside = math.sqrt(max(u, 0.0) ** 2 + max(w, 0.0) ** 2)
        return outside + min(max(u, w), 0.0)
    return math.sqrt(dx * dx + dy * dy + dz * dz) - obstacle[6]


@njit(cache=True)
def _bounding_radius(obstacle: Array) -> float:
    if obstacle[0] == _BOX:
        return math.sqrt(obstacle[6] ** 2 + obstacle[7] ** 2 + obstacle[8] ** 2)
    if obstacle[0] == _CYLINDER:
        return math.sqrt(obstacle[6] ** 2 + obstacle[8] ** 2)
    return float(obstacle[6])


@njit(cache=True)
def path_clearances(centers: Array, radius: Array, obstacles: Array, enough: float) -> Array:
    """Return the least distance between spheres on a path and each obstacle.

    Args:
        centers: (T, S, 3).
        radius: (S,).
        obstacles: (M, 9) rows.
        enough: greater distances are given as this.

    Returns:
        (M,), negative where they overlap.
    """
    out = np.full(len(obstacles), enough)
    for m in range(len(obstacles)):
        obstacle = obstacles[m]
        bound = _bounding_radius(obstacle)
        for t in range(centers.shape[0]):
            for s in range(centers.shape[1]):
                far = out[m] + radius[s] + bound
                dx = centers[t, s, 0] - obstacle[1]
                dy = centers[t, s, 1] - obstacle[2]
                dz = centers[t, s, 2] - obstacle[3]
                if far <= 0.0 or dx * dx + dy * dy + dz * dz > far * far:
                    continue
                distance = point_distance(
                    centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], obstacle
                )
                out[m] = min(out[m], distance - radius[s])
    return out


@njit(cache=True)
def _blocked(centers: Array, radius: Array, step: float, obstacle: Array, depth: float) -> bool:
    """Return whether an obstacle reaches `depth` deep into a path's spheres.

    Steps in which nothing can touch are skipped: no sphere moves more than `step` per sample.
    """
    bound = _bounding_radius(obstacle)
    samples, spheres = centers.shape[0], centers.shape[1]
    t = 0
    while t < samples:
        nearest = np.inf
        for s in range(spheres - 1, -1, -1):
            dx = centers[t, s, 0] - obstacle[1]
            dy = centers[t, s, 1] - obstacle[2]
            dz = centers[t, s, 2] - obstacle[3]
            reach = radius[s] - depth
            gap = math.sqrt(dx * dx + dy * dy + dz * dz) - bound - reach
            if gap <= 0.0:
                gap = (
                    point_distance(centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], obstacle)
                    - reach
                )
                if gap <= 0.0:
                    return True
            nearest = min(nearest, gap)
        t += max(1, int(nearest / step))
    return False


@njit(cache=True)
def blocked_paths(
    centers: Array, radius: Array, steps: Array, obstacles: Array, depth: float
) -> NDArray[np.bool_]:
    """Return which obstacles block which paths.

    Args:
        centers: (N, T, S, 3).
        radius: (S,).
        steps: (N,) from `longest_steps`.
        obstacles: (M, 9) rows.
        depth: how deep an obstacle must reach into a sphere to block it; guards against calling
            blocked what only the cover of spheres touches.

    Returns:
        (M, N), whether obstacle m blocks path n.
    """
    out = np.zeros((len(obstacles), len(centers)), np.bool_)
    for m in range(len(obstacles)):
        for n in range(len(centers)):
            out[m, n] = _blocked(centers[n], radius, steps[n], obstacles[m], depth)
    return out


@njit(cache=True)
def longest_steps(centers: Array) -> Array:
    """Return the longest way of any sphere between two samples, (N,), of (N, T, S, 3) paths."""
    out = np.full(len(centers), 1e-9)
    for n in range(centers.shape[0]):
        for t in range(1, centers.shape[1]):
            for s in range(centers.shape[2]):
                dx = centers[n, t, s, 0] - centers[n, t - 1, s, 0]
                dy = centers[n, t, s, 1] - centers[n, t - 1, s, 1]
                dz = centers[n, t, s, 2] - centers[n, t - 1, s, 2]
                out[n] = max(out[n], math.sqrt(dx * dx + dy * dy + dz * dz))
    return out


@njit(cache=True)
def self_clearance(centers: Array, radius: Array, pairs: NDArray[np.int64]) -> float:
    """Return the least distance between paired spheres on a path.

    Args:
        centers: (T, S, 3).
        radius: (S,).
        pairs: (P, 2) indices of spheres that may not touch.
    """
    least = np.inf
    for t in range(centers.shape[0]):
        for p in range(len(pairs)):
            a = pairs[p, 0]
            b = pairs[p, 1]
            dx = centers[t, a, 0] - centers[t, b, 0]
            dy = centers[t, a, 1] - centers[t, b, 1]
            dz = centers[t, a, 2] - centers[t, b, 2]
            distance = math.sqrt(dx * dx + dy * dy + dz * dz) - radius[a] - radius[b]
            least = min(least, distance)
    return least


@njit(cache=True)
def rasterised(
    centers: Array, radius: Array, origin: Array, spacing: float, shape: tuple[int, int, int]
) -> NDArray[np.uint64]:
    """Return which paths sweep over which points of a grid.

    Args:
        centers: (N, T, S, 3).
        radius: (S,).
        origin: (3,) first point of the grid.
        spacing: between neighbouring points.
        shape: (X, Y, Z) points along each axis.

    Returns:
        (ceil(N / 64), X, Y, Z), a bit for each path: set where one of its spheres covers the
        point. A sphere is drawn again only when it has moved by half the spacing.
    """
    count, samples, spheres, _ = centers.shape
    grid = np.zeros(((count + 63) // 64, shape[0], shape[1], shape[2]), np.uint64)
    for n in range(count):
        word = n // 64
        bit = np.uint64(1) << np.uint64(n % 64)
        for s in range(spheres):
            reach = radius[s] / spacing
            px = py = pz = np.inf
            for t in range(samples):
                x = (centers[n, t, s, 0] - origin[0]) / spacing
                y = (centers[n, t, s, 1] - origin[1]) / spacing
                z = (centers[n, t, s, 2] - origin[2]) / spacing
                if (x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2 < 0.25:
                    continue
                px, py, pz = x, y, z
                for i in range(max(0, math.ceil(x - reach)), min(shape[0], int(x + reach) + 1)):
                    left = reach * reach - (i - x) ** 2
                    if left < 0.0:
                        continue
                    wide = math.sqrt(left)
                    for j in range(max(0, math.ceil(y - wide)), min(shape[1], int(y + wide) + 1)):
                        rest = left - (j - y) ** 2
                        if rest < 0.0:
                            continue
                        high = math.sqrt(rest)
                        first = max(0, math.ceil(z - high))
                        last = min(shape[2], int(z + high) + 1)
                        for k in range(first, last):
                            grid[word, i, j, k] |= bit
    return grid


@njit(cache=True)
def touched(
    grid: NDArray[np.uint64],
    origin: Array,
    spacing: float,
    obstacles: Array,
    distance: float,
    count: int,
) -> NDArray[np.bool_]:
    """Return which of the paths in a grid come near which obstacles.

    Args:
        grid: (words, X, Y, Z), from `rasterised`.
        origin: (3,) first point of the grid.
        spacing: between neighbouring points.
        obstacles: (M, 9) rows.
        distance: of a covered point to the obstacle's surface at which its paths count; negative
            for points inside.
        count: paths in the grid.

    Returns:
        (M, count).
    """
    out = np.zeros((len(obstacles), count), np.bool_)
    words = np.zeros(grid.shape[0], np.uint64)
    low = np.zeros(3, np.int64)
    high = np.zeros(3, np.int64)
    for m in range(len(obstacles)):
        obstacle = obstacles[m]
        flat = max(obstacle[6], obstacle[7])
        if obstacle[0] == _BOX:
            flat = math.sqrt(obstacle[6] ** 2 + obstacle[7] ** 2)
        for axis in range(3):
            reach = (obstacle[8] if axis == 2 else flat) + distance
            middle = obstacle[1 + axis] - origin[axis]
            low[axis] = max(0, math.ceil((middle - reach) / spacing))
            high[axis] = min(grid.shape[axis + 1], int((middle + reach) / spacing) + 1)
        words[:] = 0
        for i in range(low[0], high[0]):
            for j in range(low[1], high[1]):
                for k in range(low[2], high[2]):
                    d = point_distance(
                        origin[0] + i * spacing,
                        origin[1] + j * spacing,
                        origin[2] + k * spacing,
                        obstacle,
                    )
                    if d <= distance:
                        for w in range(len(words)):
                            words[w] |= grid[w, i, j, k]
        for n in range(count):
            out[m, n] = (words[n // 64] >> np.uint64(n % 64)) & np.uint64(1)
    return out


@njit(cache=True)
def packed(flags: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Return (M, N) flags as (M, ceil(N / 64)) words of bits."""
    out = np.zeros((flags.shape[0], (flags.shape[1] + 63) // 64), np.uint64)
    for m in range(flags.shape[0]):
        for n in range(flags.shape[1]):
            if flags[m, n]:
                out[m, n // 64] |= np.uint64(1) << np.uint64(n % 64)
    return out


@njit(cache=True)
def ones(word: np.uint64) -> np.uint64:
    """Return how many bits of a word are set (the parallel sum of Knuth, TAOCP 7.1.3)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    low = np.uint64(0x3333333333333333)
    word = (word & low) + ((word >> np.uint64(2)) & low)
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True)
def best_pair(
    blocks: NDArray[np.uint64], clears: NDArray[np.uint64], allowed: NDArray[np.bool_]
) -> tuple[int, int]:
    """Return the two obstacles that together block most and both clear somebody.

    Args:
        blocks: (M, V) words, bit 0 of which must be set in one of the two.
        clears: (M, W) words, which must have a bit in common.
        allowed: (M, M), which pairs may be chosen at all.

    Returns:
        The first of the best pairs, (-1, -1) if there is none.
    """
    first, second = -1, -1
    best = np.int64(-1)
    for i in range(len(blocks)):
        for j in range(i):
            if not allowed[i, j] or not (blocks[i, 0] | blocks[j, 0]) & np.uint64(1):
                continue
            total = np.uint64(0)
            for v in range(blocks.shape[1]):
                total += ones(blocks[i, v] | blocks[j, v])
            if np.int64(total) <= best:
                continue
            common = False
            for w in range(clears.shape[1]):
                common = common or (clears[i, w] & clears[j, w]) != np.uint64(0)
            if common:
                best, first, second = np.int64(total), i, j
    return first, second
