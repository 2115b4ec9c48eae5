"""Few spheres that cover a body and stand out of it by no more than a bound.

The ball around a point that lies d deep in a body stands out by r - d at most, r its radius: for a
bound b each point has a largest ball, r = d + b. Of these balls a greedy set cover (Chvatal 1979)
takes few. What is to be covered are prisms of the outermost layer, each held by one ball with its
six corners and so with all its points, and cubes of the inside: there is no hole between samples.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label, maximum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.compiling import kernel

__all__ = [
    "MOST_CELLS",
    "MOST_PATCHES",
    "GriddedBody",
    "TooLargeError",
    "closed_mesh",
    "tight_cover",
]

MOST_CELLS = 20_000_000
"""Cells of the grid that tells the inside of a body at most."""

_MOST_CENTERS = 5000
"""Balls among which the cover is chosen; were there more, they would stand farther apart."""

_MOST_CHOSEN_FOR = 4000
"""Patches for which balls are chosen at once; were there more, they would be thinned further."""

MOST_PATCHES = 4_000_000
"""Triangles that a mesh is cut into at most."""

_PITCH = 1.0 / 3.0
"""Bounds, side of a cell: a cube of the inside is held by the largest ball around its middle."""

_PATCH = 0.5
"""Bounds, longest edge of a triangle: a ball of one bound around its centroid holds its prism."""

_SAMPLE = 0.8
"""Cells, longest edge of the triangles whose corners mark the cells of the surface. Below 0.86 no
path between middles of neighbouring cells crosses the surface unmarked."""

_THINNED = 0.5
"""Bounds, side of the cells of which one patch each stands for all."""

_DEEPENING = 8
"""Steps to where a point is deepest, each as long as before or half as long."""

_LEEWAY = 0.001
"""Share by which a depth may be taken too small: it is found much faster."""

_COARSENESS = 0.4
"""Radii of the largest balls, distance of their centres."""


class TooLargeError(ValueError):
    """A body is too large for a bound."""


def closed_mesh(mesh: Any) -> Any:
    """Return a `trimesh.Trimesh` whose rims are spanned by triangles to their middle.

    Meshes of links are often open where the next one is mounted.
    """
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    edges, count = np.unique(np.sort(solid.edges, axis=1), axis=0, return_counts=True)
    rim = edges[count == 1]
    if not len(rim):
        return solid
    corners = len(solid.vertices)
    graph = coo_array((np.ones(len(rim)), rim.T), (corners, corners))
    which = connected_components(graph, directed=False)[1][rim[:, 0]]
    middles, which = np.unique(which, return_inverse=True)
    sums = np.zeros((len(middles), 3))
    np.add.at(sums, which, solid.vertices[rim].mean(axis=1))
    spanned = sums / np.bincount(which)[:, None]
    return trimesh.Trimesh(
        np.concatenate([solid.vertices, spanned]),
        np.concatenate([solid.faces, np.column_stack([rim, corners + which])]),
        process=False,
    )


def tight_cover(mesh: Any, overshoot: float) -> FloatArray:
    """Return spheres (S, 4) m, centre and radius, that cover a body.

    The body is the surface of a mesh and all that cannot be reached from afar through openings
    wider than a third of `overshoot`. Open meshes are closed first (`closed_mesh`).

    Args:
        mesh: a `trimesh.Trimesh` of at least one triangle, m.
        overshoot: m, largest distance of a point of a sphere from the body, positive.

    Raises:
        TooLargeError: the grid would have more than `MOST_CELLS` cells, or the mesh would be cut
            into more than `MOST_PATCHES` triangles.
    """
    solid = closed_mesh(mesh)
    cells = float(np.prod(np.ceil(solid.extents / (_PITCH * overshoot)) + 5.0))
    if cells > MOST_CELLS:
        raise TooLargeError(f"its inside would take {cells:.3g} cells, beyond {MOST_CELLS}")
    body = GriddedBody(solid, overshoot)
    patches = _cut(np.asarray(solid.triangles), _PATCH * overshoot)
    patches = body.layer(patches[body.is_outer(patches.mean(axis=1))])
    return _shrunk(body, patches, _selected(body, patches, overshoot))


def _cut(triangles: FloatArray, longest: float) -> FloatArray:
    """Return triangles (N, 3, 3) of edges up to a length, by halving longest edges."""
    short, count = [], 0
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        first, rows = edges.argmax(axis=1), np.arange(len(triangles))
        long = edges[rows, first] > longest
        short.append(triangles[~long])
        count += 2 * len(triangles) - len(short[-1])
        if count > MOST_PATCHES:
            raise TooLargeError(f"it would be cut into more than {MOST_PATCHES} triangles")
        rows, first = rows[long], first[long]
        a, b, c = (triangles[rows, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        triangles = np.concatenate(halves)
    return np.concatenate(short)


def _unrepeated(points: FloatArray) -> FloatArray:
    """Return points (N, 3) once that are there to the last bit several times, sorted."""
    ordered = points[np.lexsort(points.T)]
    return ordered[np.append(True, (ordered[1:] != ordered[:-1]).any(axis=1))]


class GriddedBody:
    """The inside of a closed mesh, on a grid.

    Attributes:
        inside: (V, 3) m, middles of the cells inside that the outer surface does not touch.
        centers: (C, 3) m, where balls may stand: closer together where the body is thin.
        radii: (C) m, of the largest ball around each.
        half_diagonal: m, of a cell.
    """

    def __init__(self, mesh: Any, overshoot: float) -> None:
        pitch = _PITCH * overshoot
        self.half_diagonal = pitch * math.sqrt(3.0) / 2.0
        self._pitch, self._origin = pitch, mesh.bounds[0] - 2.0 * pitch
        samples = _cut(np.asarray(mesh.triangles), _SAMPLE * pitch).reshape(-1, 3)
        shape = np.ceil(mesh.extents / pitch).astype(np.int64) + 5
        places = self._places(samples)
        surface = np.zeros(shape, bool)
        surface[tuple(places.T)] = True
        parts, _ = label(~surface)
        outside = parts == parts[0, 0, 0]
        # Surfaces deep inside bound nothing: only those are kept that the outside touches.
        self._outside = outside
        self._outer = binary_dilation(outside, np.ones((3, 3, 3)), iterations=2)
        samples = _unrepeated(samples[self._outer[tuple(places.T)]])
        where = np.argwhere(~(outside | (surface & self._outer)))
        self.inside = self._middles(where)
        # Balanced trees are slow for the many equal coordinates of flat faces.
        tree = cKDTree(samples, balanced_tree=False)
        depth = _depth(tree, self.inside, pitch)
        depths = np.zeros(shape)
        depths[tuple(where.T)] = depth
        ridge = maximum_filter(depths, 3)[tuple(where.T)] <= depth
        coarseness, kept = _COARSENESS, np.ones(len(where), bool)
        while kept.sum() > _MOST_CENTERS or coarseness == _COARSENESS:
            spacing = np.maximum(coarseness * (depth + overshoot) / pitch, 1.0)
            step = 2 ** np.floor(np.log2(spacing)).astype(np.int64)
            kept = (where % step[:, None] == 0).all(axis=1)
            # A line of the deepest cells may miss that lattice: one of each block is kept.
            step = np.maximum(step[ridge] // 2, 1)
            blocks = np.column_stack([where[ridge] // step[:, None], step])
            kept[np.flatnonzero(ridge)[np.unique(blocks, axis=0, return_index=True)[1]]] = True
            coarseness *= 1.25
        at, deep = _deepened(tree, self.inside[kept & ridge], depth[kept & ridge], pitch)
        self.centers = np.concatenate([self.inside[kept], at])
        self.radii = np.concatenate([depth[kept], deep]) + overshoot

    def _places(self, points: FloatArray) -> IntArray:
        return np.floor((points - self._origin) / self._pitch).astype(np.int64)

    def _middles(self, places: IntArray) -> FloatArray:
        return np.asarray(self._origin + self._pitch * (places + 0.5))

    def layer(self, triangles: FloatArray) -> FloatArray:
        """Return prisms (N, 6, 3) from triangles (N, 3, 3) of the surface inwards.

        They are as high as a cell's diagonal: no point inside that is in a cell of the surface is
        farther from it. Inwards is where the outside is not; where it is on both sides, the body is
        thinner than that, and the side is that of the mesh.
        """
        first, second, third = np.moveaxis(triangles, 1, 0)
        normals = np.cross(second - first, third - first)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        inwards = -2.0 * self.half_diagonal * normals
        middles = triangles.mean(axis=1)
        free = [self._is_outside(middles + side * inwards) for side in (1.0, -1.0)]
        inwards[free[0] & ~free[1]] *= -1.0
        return np.concatenate([triangles, triangles + inwards[:, None]], axis=1)

    def _is_outside(self, points: FloatArray) -> NDArray[np.bool_]:
        places = np.clip(self._places(points), 0, np.array(self._outside.shape) - 1)
        return np.asarray(self._outside[tuple(places.T)])

    def is_outer(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return whether points (N, 3) of the surface can be reached from outside."""
        return np.asarray(self._outer[tuple(self._places(points).T)])


def _depth(tree: cKDTree, points: FloatArray, pitch: float) -> FloatArray:
    """Return how deep points (N, 3) inside are at least, m, from samples of the surface."""
    distance = tree.query(points, eps=_LEEWAY)[0] / (1.0 + _LEEWAY)
    # A point of the surface is within this of a sample, across the line to it (Pythagoras).
    gap = _SAMPLE * pitch / math.sqrt(3.0)
    return np.sqrt(np.maximum(distance**2 - gap**2, 0.0))


def _deepened(
    tree: cKDTree, points: FloatArray, depth: FloatArray, pitch: float
) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) moved to where they are deeper, as to the axis of a rod, and depths.

    A step away from the surface is shorter than the depth, so that it stays inside.
    """
    points, depth = points.copy(), depth.copy()
    step = np.full(len(points), pitch / 2)
    for _ in range(_DEEPENING):
        if not len(points):
            break
        away = points - tree.data[tree.query(points)[1]]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        moved = points + np.minimum(step, 0.9 * depth)[:, None] * away
        there = _depth(tree, moved, pitch)
        deeper = there > depth
        points[deeper], depth[deeper] = moved[deeper], there[deeper]
        step[~deeper] /= 2
    return points, depth


def _selected(body: GriddedBody, patches: FloatArray, overshoot: float) -> FloatArray:
    """Return spheres (S, 4) that hold each patch and each cell of the inside."""
    balls = np.column_stack([body.centers, body.radii])
    chosen, left = _greedy(balls, patches, 0.0, overshoot)
    # Where the body is thinner than the grid, balls stand on the surface.
    thin = _of_radius(left[:, :3].mean(axis=1), overshoot)
    on_surface, left = _greedy(thin, left, 0.0, overshoot)
    assert not len(left), "the ball of one bound around its centroid holds a prism"
    spheres = np.concatenate([chosen, on_surface])
    cells = body.inside[:, None]
    holes = cells[~_held(spheres, cells, body.half_diagonal)]
    within = np.concatenate([balls, _of_radius(holes[:, 0], overshoot)])
    chosen, left = _greedy(within, holes, body.half_diagonal, overshoot)
    assert not len(left), "the ball of one bound around its middle holds a cell"
    return np.concatenate([spheres, chosen])


def _of_radius(centers: FloatArray, radius: float) -> FloatArray:
    return np.column_stack([centers, np.full(len(centers), radius)])


def _held(spheres: FloatArray, patches: FloatArray, slack: float) -> NDArray[np.bool_]:
    """Return whether a sphere holds each patch (N, corners, 3) with some slack, (N)."""
    held = np.zeros(len(patches), bool)
    for ball in spheres:
        held |= _reach(ball[:3], patches) + slack <= ball[3]
    return held


@kernel
def _reach(center, patches):  # type: ignore[no-untyped-def]
    """Return how large a ball must be to hold each patch (N, corners, 3), (N) m."""
    reach = np.empty(patches.shape[0])
    for n in range(patches.shape[0]):
        farthest = 0.0
        for k in range(patches.shape[1]):
            total = 0.0
            for axis in range(3):
                total += (patches[n, k, axis] - center[axis]) ** 2
            farthest = max(farthest, total)
        reach[n] = math.sqrt(farthest)
    return reach


def _greedy(
    balls: FloatArray, patches: FloatArray, slack: float, spacing: float
) -> tuple[FloatArray, FloatArray]:
    """Return balls (S, 4) that are chosen, and the patches (K, corners, 3) that none can hold.

    They are chosen for patches that are some distance apart, then for those that are left.
    """
    if not len(balls):
        return np.empty((0, 4)), patches
    chosen = [np.empty((0, 4))]
    hopeless = [np.empty((0, *patches.shape[1:]))]
    while len(patches):
        first, count = _thinned(patches.mean(axis=1), _THINNED * spacing)
        few = patches[first]
        holds = _incidence(balls, few, slack)
        hopeless.append(few[~holds.any(axis=0)])
        picked = balls[_set_cover(holds, count.astype(np.float32))]
        chosen.append(picked)
        done = _held(picked, patches, slack)
        done[first] = True
        patches = patches[~done]
    return np.concatenate(chosen), np.concatenate(hopeless)


def _thinned(points: FloatArray, spacing: float) -> tuple[IntArray, IntArray]:
    """Return of points (N, 3) the index of one in each cell, and how many it stands for."""
    while True:
        places = np.floor((points - points.min(axis=0)) / spacing).astype(np.int64)
        keys = np.ravel_multi_index(tuple(places.T), tuple(places.max(axis=0) + 1))
        _, first, count = np.unique(keys, return_index=True, return_counts=True)
        if len(first) <= _MOST_CHOSEN_FOR:
            return first, count
        spacing *= 1.25


def _incidence(balls: FloatArray, patches: FloatArray, slack: float) -> NDArray[np.float32]:
    """Return 1 where a ball holds a patch, (B, N)."""
    holds = np.ones((len(balls), len(patches)), bool)
    centers, radii = balls[:, :3], balls[:, 3] - slack
    # |x - c|^2 <= r^2, of which only one product is not of a single argument.
    bound = (np.maximum(radii, 0.0) ** 2 - (centers**2).sum(axis=1))[:, None]
    for corner in np.moveaxis(patches, 1, 0):
        holds &= (corner**2).sum(axis=1) - 2.0 * (centers @ corner.T) <= bound
    return holds.astype(np.float32)


def _set_cover(holds: NDArray[np.float32], worth: NDArray[np.float32]) -> IntArray:
    """Return the balls of a greedy set cover of all patches that can be held."""
    chosen: list[int] = []
    while True:
        gains = holds @ worth
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            return np.array(chosen, np.int64)
        chosen.append(best)
        worth = np.where(holds[best] > 0.0, np.float32(0.0), worth)


def _shrunk(body: GriddedBody, patches: FloatArray, spheres: FloatArray) -> FloatArray:
    """Return the spheres that are needed, each no larger than what it alone is to hold."""

    def reach(center: FloatArray) -> FloatArray:
        of_cells = _reach(center, body.inside[:, None]) + body.half_diagonal
        return np.concatenate([_reach(center, patches), of_cells])

    # Rounding must not lose what touches the surface of its ball.
    holds = np.array([reach(ball[:3]) <= ball[3] + 1e-12 for ball in spheres])
    times = holds.sum(axis=0, dtype=np.int32)
    kept = np.ones(len(spheres), bool)
    for s in np.argsort(spheres[:, 3], kind="stable"):
        if (times[holds[s]] > 1).all():
            kept[s] = False
            times -= holds[s]
    spheres = spheres[kept]
    # Each patch and cell belongs to the ball in which it lies deepest.
    owner = np.zeros(len(times), np.int64)
    nearest = np.zeros(len(times))
    deepest = np.full(len(times), -np.inf)
    for s, ball in enumerate(spheres):
        needed = reach(ball[:3])
        deeper = ball[3] - needed > deepest
        owner[deeper], nearest[deeper] = s, needed[deeper]
        deepest[deeper] = ball[3] - needed[deeper]
    radii = np.zeros(len(spheres))
    np.maximum.at(radii, owner, nearest)
    return np.column_stack([spheres[:, :3], radii])[radii > 0.0]
