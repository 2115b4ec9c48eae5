"""Spheres that cover the collision shapes of a robot's links."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

__all__ = ["cover_box", "cover_cylinder", "cover_mesh"]

FloatArray = NDArray[np.float64]


def cover_box(half_extents: ArrayLike, cell: float) -> FloatArray:
    """Return spheres (S, 4), centre and radius, that cover a box around the origin.

    The box is cut into cells of sides up to `cell`, each of which lies in the ball through its
    corners; cells that only cover what other balls cover anyway are left out.

    Args:
        half_extents: (3,) m, positive.
        cell: m.
    """
    half = np.asarray(half_extents, np.float64)
    counts = np.ceil(2.0 * half / cell - 1e-9).astype(int)
    axes = [h * ((2 * np.arange(n) + 1) / n - 1) for h, n in zip(half, counts, strict=True)]
    center = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = (np.abs(center) < half - 2.0 * half / counts).all(axis=1)
    center = center[~inner]
    radius = np.full(len(center), np.linalg.norm(half / counts))
    return np.column_stack([center, radius])


def cover_cylinder(radius: float, half_height: float, cell: float) -> FloatArray:
    """Return spheres (S, 4) that cover a cylinder around the origin, its axis along z.

    Slender ones are cut across the axis, flat ones as the box around them.

    Args:
        radius: m.
        half_height: m.
        cell: m, longest side of a piece.
    """
    if radius > max(cell, half_height):
        return cover_box((radius, radius, half_height), cell)
    count = int(np.ceil(2.0 * half_height / cell - 1e-9))
    height = half_height * ((2 * np.arange(count) + 1) / count - 1)
    spheres = np.zeros((count, 4))
    spheres[:, 2] = height
    spheres[:, 3] = np.hypot(radius, half_height / count)
    return spheres


def cover_mesh(mesh: Any, cell: float) -> FloatArray:
    """Return spheres (S, 4) that cover the surface of a `trimesh.Trimesh`.

    Its triangles are cut until no edge is longer than half a cell, and sorted into cells by their
    centroids; a ball holds all triangles of a cell.

    Args:
        mesh: at least one triangle, m.
        cell: m, side of the cells.
    """
    vertices, faces = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, cell / 2, max_iter=20
    )
    triangles = np.asarray(vertices, np.float64)[np.asarray(faces)]
    index = np.floor(triangles.mean(axis=1) / cell).astype(np.int64)
    _, which = np.unique(index, axis=0, return_inverse=True)
    which = which.reshape(-1)
    spheres = np.empty((which.max() + 1, 4))
    for number in range(len(spheres)):
        corners = triangles[which == number].reshape(-1, 3)
        center = (corners.min(axis=0) + corners.max(axis=0)) / 2
        spheres[number, :3] = center
        spheres[number, 3] = np.linalg.norm(corners - center, axis=1).max()
    return spheres
