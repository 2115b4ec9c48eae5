"""The grid on which obstacles are compared: occupancy of its points by the spheres of paths.

Every centre of a sphere sets a bit at the point nearest to it; a query then visits the points
around an obstacle, farther for larger spheres. That takes one step for each sphere of a path, where
drawing whole balls takes a hundred. Centres are moved by up to half the spacing along each axis, so
what is found on the grid is a guess; what is chosen by it is checked without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import kernel
from smp_gym.sampling.kernels import point_distance

__all__ = ["GRID_SHAPE", "Grid", "near", "passing", "points", "rasterise", "within"]

_FIRST_POINT = np.array([0.04, -0.76, 0.0])
_SPACING = 0.04
GRID_SHAPE = (24, 39, 26)
"""First point (m), spacing (m) and numbers of points: all that the arm can reach with its hand in
front of it."""

_SMALL = 0.03
"""m: spheres are told apart by whether their radius is below this or not."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Occupancy of the grid's points by the spheres of each path.

    Attributes:
        words: (2, X, Y, Z, ceil(N / 64)), a bit for each path, of its small and its large spheres.
        radius: (2,) m, mean of the small and of the large ones; negative where there are none.
    """

    words: NDArray[np.uint64]
    radius: FloatArray


def rasterise(paths: FloatArray, radius: FloatArray) -> Grid:
    """Return the grid of (N, T, S, 3) m paths of spheres with radii (S,) m."""
    large = radius >= _SMALL
    means = [radius[kind].mean() if kind.any() else -1.0 for kind in (~large, large)]
    return Grid(
        _set_bits(paths, large.astype(np.int64), _FIRST_POINT, _SPACING, GRID_SHAPE),
        np.array(means),
    )


def near(grid: Grid, rows: FloatArray, distance: float, members: int) -> BoolArray:
    """Return a mask (C, members) of paths of a grid within a distance (m) of obstacles."""
    reach = np.where(grid.radius < 0.0, -np.inf, grid.radius + distance)
    return _collect(grid.words, reach, rows, _FIRST_POINT, _SPACING, members)


def points() -> FloatArray:
    """Return the (X * Y * Z, 3) m points of the grid."""
    axes = [
        first + _SPACING * np.arange(n) for first, n in zip(_FIRST_POINT, GRID_SHAPE, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def within(path: FloatArray, radius: FloatArray, distance: float) -> BoolArray:
    """Return a mask (X, Y, Z) of points within a distance (m) of spheres on a path (T, S, 3)."""
    return _within(path, radius + distance, _FIRST_POINT, _SPACING, GRID_SHAPE)


def passing(grid: Grid, cells: BoolArray, members: int) -> BoolArray:
    """Return a mask (members,) of the first paths: which pass some of the points (X, Y, Z)."""
    words = _united(grid.words, cells, -(-members // 64))
    flags = np.unpackbits(words.view(np.uint8), bitorder="little")[:members]
    return flags.astype(np.bool_)


@kernel
def _united(words: NDArray[np.uint64], cells: BoolArray, count: int) -> NDArray[np.uint64]:
    out = np.zeros(count, np.uint64)
    for i in range(words.shape[1]):
        for j in range(words.shape[2]):
            for k in range(words.shape[3]):
                if cells[i, j, k]:
                    for w in range(count):
                        out[w] |= words[0, i, j, k, w] | words[1, i, j, k, w]
    return out


@kernel
def _squared(index: int, first: float, spacing: float, value: float) -> float:
    """Return the squared distance of a value from one of the grid's along an axis."""
    apart = first + index * spacing - value
    return float(apart * apart)


@kernel
def _within(
    path: FloatArray,
    reach: FloatArray,
    origin: FloatArray,
    spacing: float,
    shape: tuple[int, int, int],
) -> BoolArray:
    out = np.zeros(shape, np.bool_)
    low = np.zeros(3, np.int64)
    high = np.zeros(3, np.int64)
    for t in range(path.shape[0]):
        for s in range(path.shape[1]):
            for axis in range(3):
                middle = path[t, s, axis] - origin[axis]
                low[axis] = max(0, math.ceil((middle - reach[s]) / spacing))
                high[axis] = min(shape[axis], math.floor((middle + reach[s]) / spacing) + 1)
            for i in range(low[0], high[0]):
                dx = origin[0] + i * spacing - path[t, s, 0]
                for j in range(low[1], high[1]):
                    dy = origin[1] + j * spacing - path[t, s, 1]
                    flat = dx * dx + dy * dy
                    limit = reach[s] * reach[s]
                    # What lies within is one piece of the column.
                    z, first, last = path[t, s, 2], low[2], high[2]
                    while first < last and flat + _squared(first, origin[2], spacing, z) > limit:
                        first += 1
                    while first < last and flat + _squared(last - 1, origin[2], spacing, z) > limit:
                        last -= 1
                    out[i, j, first:last] = True
    return out


@kernel
def _set_bits(
    paths: FloatArray,
    kind: NDArray[np.int64],
    origin: FloatArray,
    spacing: float,
    shape: tuple[int, int, int],
) -> NDArray[np.uint64]:
    count, samples, spheres, _ = paths.shape
    words = np.zeros((2, shape[0], shape[1], shape[2], (count + 63) // 64), np.uint64)
    for n in range(count):
        bit = np.uint64(1) << np.uint64(n % 64)
        for t in range(samples):
            for s in range(spheres):
                i = math.floor((paths[n, t, s, 0] - origin[0]) / spacing + 0.5)
                j = math.floor((paths[n, t, s, 1] - origin[1]) / spacing + 0.5)
                k = math.floor((paths[n, t, s, 2] - origin[2]) / spacing + 0.5)
                if 0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]:
                    words[kind[s], i, j, k, n // 64] |= bit
    return words


@kernel
def _collect(
    words: NDArray[np.uint64],
    reach: FloatArray,
    rows: FloatArray,
    origin: FloatArray,
    spacing: float,
    members: int,
) -> BoolArray:
    out = np.zeros((len(rows), members), np.bool_)
    found = np.zeros(words.shape[4], np.uint64)
    low = np.zeros(3, np.int64)
    high = np.zeros(3, np.int64)
    widest = max(reach[0], reach[1])
    for m in range(len(rows)):
        row = rows[m]
        # The corners of a box reach out farther than its sides.
        flat = math.sqrt(row[6] ** 2 + row[7] ** 2) if row[0] == 0 else row[6]
        for axis in range(3):
            around = (row[8] if axis == 2 else flat) + max(widest, 0.0)
            middle = row[1 + axis] - origin[axis]
            low[axis] = max(0, math.ceil((middle - around) / spacing))
            high[axis] = min(words.shape[1 + axis], math.floor((middle + around) / spacing) + 1)
        found[:] = 0
        for i in range(low[0], high[0]):
            for j in range(low[1], high[1]):
                for k in range(low[2], high[2]):
                    distance = point_distance(
                        origin[0] + i * spacing,
                        origin[1] + j * spacing,
                        origin[2] + k * spacing,
                        row,
                    )
                    for kind in range(2):
                        if distance <= reach[kind]:
                            for w in range(len(found)):
                                found[w] |= words[kind, i, j, k, w]
        for n in range(members):
            out[m, n] = (found[n // 64] >> np.uint64(n % 64)) & np.uint64(1)
    return out
