"""One regular grid of signed distance, into which every map is baked once per scene.

Particle sets query the distance some 80 000 times in each iteration; a trilinear lookup returns it
in nanoseconds, whatever the map was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.compiling import kernel
from smp_gym.geometry.distance import check_points
from smp_gym.scene import Obstacle
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.occupancy_map import TRUNCATION, OccupancyMap

__all__ = [
    "BLOCK",
    "SPACING",
    "WORKSPACE",
    "DistanceGrid",
    "GridMap",
    "bake",
    "bake_analytic",
    "fill_slabs",
    "grid_nodes",
    "lookup",
]

WORKSPACE = ((-0.6, -0.95, -0.1), (0.95, 0.95, 1.2))
"""Corners of the default grid, m: where the arm with an object in its hand can be."""

SPACING = 0.015
"""Default distance of neighbouring nodes, m."""

BLOCK = 4
"""Cells of a grid along each edge of a block that may be passed over as a whole."""

_SLABS: tuple[int, ...] = (0, 2, 1, 3)
"""Slabs of a grid along its first axis, in an order whose halves have about as much to do."""


@kernel(inline="always")
def _cell(x, origin, inv_spacing, count):  # type: ignore[no-untyped-def]
    """Return (cell, fraction, slope) of one coordinate; slope is 0 where it had to be clamped."""
    u = (x - origin) * inv_spacing
    last = count - 1.0
    slope = inv_spacing
    # Written so that NaN, for which every comparison is false, lands in a cell of the grid.
    if not u >= 0.0:
        u, slope = 0.0, 0.0
    elif u > last:
        u, slope = last, 0.0
    i = min(int(u), count - 2)
    return i, u - i, slope


@kernel
def lookup(values, origin, inv_spacing, x, y, z):  # type: ignore[no-untyped-def]
    """Return (distance, gx, gy, gz) of one point: m, and the exact gradient of the interpolant.

    Outside the grid the value is that of the nearest boundary point, so the gradient across that
    boundary is 0. Nothing is checked; the value at a NaN coordinate has no meaning.

    Args:
        values: (X, Y, Z) m, each at least 2 nodes.
        origin: (3,) m, position of node (0, 0, 0).
        inv_spacing: 1/m.
        x: m, base frame.
        y: m.
        z: m.
    """
    i, a, sx = _cell(x, origin[0], inv_spacing, values.shape[0])
    j, b, sy = _cell(y, origin[1], inv_spacing, values.shape[1])
    k, c, sz = _cell(z, origin[2], inv_spacing, values.shape[2])
    v000, v001 = np.float64(values[i, j, k]), np.float64(values[i, j, k + 1])
    v010, v011 = np.float64(values[i, j + 1, k]), np.float64(values[i, j + 1, k + 1])
    v100, v101 = np.float64(values[i + 1, j, k]), np.float64(values[i + 1, j, k + 1])
    v110, v111 = np.float64(values[i + 1, j + 1, k]), np.float64(values[i + 1, j + 1, k + 1])
    d00, d01, d10, d11 = v001 - v000, v011 - v010, v101 - v100, v111 - v110
    v00, v01, v10, v11 = v000 + c * d00, v010 + c * d01, v100 + c * d10, v110 + c * d11
    v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
    gx = v1 - v0
    gy = (1.0 - a) * (v01 - v00) + a * (v11 - v10)
    gz = (1.0 - a) * (d00 + b * (d01 - d00)) + a * (d10 + b * (d11 - d10))
    return v0 + a * gx, sx * gx, sy * gy, sz * gz


@kernel
def _lookup_all(values, origin, inv_spacing, points):  # type: ignore[no-untyped-def]
    distance, gradient = np.empty(len(points)), np.empty((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d, gx, gy, gz = lookup(values, origin, inv_spacing, x, y, z)
        distance[i] = d
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
    return distance, gradient


@kernel
def _least_of_blocks(values):  # type: ignore[no-untyped-def]
    """Return the least value that the interpolant takes in each block of `BLOCK`^3 cells.

    Args:
        values: (X, Y, Z) m, each at least 2 nodes.
    """
    nx, ny, nz = values.shape
    columns = np.empty((nx, ny, (nz + BLOCK - 2) // BLOCK), np.float32)
    planes = np.empty((nx, (ny + BLOCK - 2) // BLOCK, columns.shape[2]), np.float32)
    least = np.empty(((nx + BLOCK - 2) // BLOCK, *planes.shape[1:]), np.float32)
    # A node between two blocks counts for both.
    for i in range(nx):
        for j in range(ny):
            for c in range(columns.shape[2]):
                lowest = values[i, j, BLOCK * c]
                for k in range(BLOCK * c + 1, min(BLOCK * c + BLOCK + 1, nz)):
                    lowest = min(lowest, values[i, j, k])
                columns[i, j, c] = lowest
        for b in range(planes.shape[1]):
            planes[i, b] = columns[i, BLOCK * b]
            for j in range(BLOCK * b + 1, min(BLOCK * b + BLOCK + 1, ny)):
                planes[i, b] = np.minimum(planes[i, b], columns[i, j])
    for a in range(least.shape[0]):
        least[a] = planes[BLOCK * a]
        for i in range(BLOCK * a + 1, min(BLOCK * a + BLOCK + 1, nx)):
            least[a] = np.minimum(least[a], planes[i])
    return least


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distance at the nodes of a regular grid.

    Attributes:
        origin: (3,) m, position of node (0, 0, 0) in the base frame.
        spacing: m, distance of neighbouring nodes along each axis.
        values: (X, Y, Z) float32 m, C-contiguous; at least 2 nodes along each axis.
    """

    origin: NDArray[np.float64]
    spacing: float
    values: NDArray[np.float32]

    def __post_init__(self) -> None:
        origin = np.ascontiguousarray(self.origin, np.float64)
        values = np.ascontiguousarray(self.values, np.float32)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise ValueError(f"DistanceGrid.origin must be 3 finite numbers, got {self.origin}")
        if not (math.isfinite(self.spacing) and self.spacing > 0.0):
            raise ValueError(f"DistanceGrid.spacing must be positive, got {self.spacing}")
        if values.ndim != 3 or min(values.shape) < 2:
            raise ValueError(
                f"DistanceGrid.values must have 3 axes of at least 2 nodes, got {values.shape}"
            )
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "values", values)

    @property
    def workspace(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lower and upper corner, m."""
        upper = self.origin + self.spacing * (np.array(self.values.shape) - 1)
        return tuple(self.origin.tolist()), tuple(upper.tolist())

    @cached_property
    def least_of_blocks(self) -> NDArray[np.float32]:
        """Least value (A, B, C) m that `query` takes in each block of `BLOCK`^3 cells.

        Most spheres are far from everything; one lookup in this small grid tells.
        """
        return np.asarray(_least_of_blocks(self.values))

    @cached_property
    def largest(self) -> float:
        """Largest value, m."""
        return float(self.values.max())

    @cached_property
    def steepness(self) -> float:
        """Bound on the change of `query` per metre of path, outside the grid, too."""
        largest = [np.abs(np.diff(self.values, axis=axis)).max() for axis in range(3)]
        return float(np.linalg.norm(largest)) / self.spacing

    def query(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the interpolated signed distance (...) m at points (..., 3) m.

        Points outside the grid take the value of the nearest point of its boundary.

        Raises:
            ValueError: `points` has the wrong shape or is not finite.
        """
        return self.query_with_gradient(points)[0]

    def query_with_gradient(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return `query` and its gradient (..., 3) with respect to the points.

        Raises:
            ValueError: `points` has the wrong shape or is not finite.
        """
        array = check_points(points)
        distance, gradient = _lookup_all(
            self.values, self.origin, 1.0 / self.spacing, array.reshape(-1, 3)
        )
        return distance.reshape(array.shape[:-1]), gradient.reshape(array.shape)


@dataclass(frozen=True)
class GridMap:
    """A distance that is known on a grid only, an `OccupancyMap`.

    Attributes:
        grid: signed distance.
        truncation: m, largest absolute value of the distance.
    """

    grid: DistanceGrid
    truncation: float

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the interpolated signed distance; see `OccupancyMap.signed_distance`."""
        return self.grid.query(points)

    def fill(
        self,
        values: NDArray[np.float32],
        origin: NDArray[np.float64],
        spacing: float,
        planes: tuple[int, int] | None = None,
    ) -> None:
        """Lower the nodes of a grid to the interpolated distance; see `OccupancyMap.fill`."""
        mine = slice(*(planes or (0, len(values))))
        axes = [origin[i] + spacing * np.arange(values.shape[i]) for i in range(3)]
        points = np.stack(np.meshgrid(axes[0][mine], *axes[1:], indexing="ij"), axis=-1)
        part = values[mine]
        np.minimum(part, self.grid.query(points), out=part, casting="same_kind")


def grid_nodes(
    workspace: tuple[Sequence[float], Sequence[float]], spacing: float
) -> tuple[NDArray[np.float64], tuple[int, int, int]]:
    """Return origin (3,) m and number of nodes along each axis of the grid over a workspace.

    Raises:
        ValueError: the corners are not finite or not in order, or `spacing` is not positive.
    """
    lower, upper = (np.asarray(corner, np.float64) for corner in workspace)
    if lower.shape != (3,) or upper.shape != (3,) or not np.isfinite([lower, upper]).all():
        raise ValueError(f"workspace must be two corners of 3 finite numbers, got {workspace}")
    if not (lower < upper).all():
        raise ValueError(f"workspace must have its lower corner first, got {workspace}")
    if not (math.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing must be positive, got {spacing}")
    # Without the rounding a box of exactly n cells may get n + 1.
    nx, ny, nz = (int(n) + 1 for n in np.ceil(np.round((upper - lower) / spacing, 6)))
    return lower, (nx, ny, nz)


Sharing = Callable[[int, Callable[[slice], None]], None]
"""Calls some work for slices that make up so many rows, on several threads perhaps."""


def _in_turn(rows: int, work: Callable[[slice], None]) -> None:
    work(slice(0, rows))


def fill_slabs(
    occupancy_map: OccupancyMap,
    values: NDArray[np.float32],
    origin: NDArray[np.float64],
    spacing: float,
    over: Sharing = _in_turn,
) -> None:
    """Lower the nodes of a grid to a map's distance, slab by slab; see `OccupancyMap.fill`.

    The slabs are the same however they are shared, and so is what comes out.

    Args:
        occupancy_map: the map.
        values: (X, Y, Z) m, changed in place.
        origin: (3,) m.
        spacing: m.
        over: shares the slabs.
    """

    def work(mine: slice) -> None:
        for slab in _SLABS[mine]:
            first, last = len(values) * slab // len(_SLABS), len(values) * (slab + 1) // len(_SLABS)
            occupancy_map.fill(values, origin, spacing, (first, last))

    over(len(_SLABS), work)


def bake(
    occupancy_map: OccupancyMap,
    workspace: tuple[Sequence[float], Sequence[float]] = WORKSPACE,
    spacing: float = SPACING,
    over: Sharing = _in_turn,
) -> DistanceGrid:
    """Return a map as a grid.

    Args:
        occupancy_map: what to bake.
        workspace: lower and upper corner, m; the grid covers at least the box between them.
        spacing: m.
        over: shares the slabs of the grid among threads.

    Returns:
        The grid; a scene without obstacles has the map's truncation everywhere.

    Raises:
        ValueError: the corners are not finite or not in order, or `spacing` is not positive.
    """
    origin, nodes = grid_nodes(workspace, spacing)
    values = np.full(nodes, occupancy_map.truncation, np.float32)
    fill_slabs(occupancy_map, values, origin, spacing, over)
    return DistanceGrid(origin, spacing, values)


def bake_analytic(
    obstacles: Sequence[Obstacle],
    workspace: tuple[Sequence[float], Sequence[float]] = WORKSPACE,
    spacing: float = SPACING,
    truncation: float = TRUNCATION,
) -> DistanceGrid:
    """Return the exact distance as a grid: the oracle of every learned map.

    Args:
        obstacles: bodies at the pose they have now.
        workspace: as in `bake`.
        spacing: m.
        truncation: m, largest absolute value of the grid.

    Raises:
        ValueError: as in `bake`, or `truncation` is not positive.
    """
    return bake(AnalyticMap(tuple(obstacles), truncation), workspace, spacing)
