"""Spheres that cover a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from smp_gym.arrays import FloatArray

__all__ = ["cover_mesh"]


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
