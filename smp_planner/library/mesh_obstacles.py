"""Obstacles from meshes: spheres that cover a surface, and fill it where it is closed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_gym.geometry.pose import Pose, checked_pose
from smp_gym.scene import Obstacle
from smp_planner.library.covering import (
    MOST_SPHERES,
    check_mesh,
    cover_mesh,
    read_mesh,
    refuse_fine,
    size_of,
)

__all__ = ["mesh_obstacles", "placed_spheres", "spheres_of"]

_MOST_VOXELS = 20_000_000
"""Cells of the grid on which the inside of a mesh is filled at most."""


def mesh_obstacles(
    mesh: str | os.PathLike[str] | Any,
    *,
    cell: float,
    position: ArrayLike = (0.0, 0.0, 0.0),
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    scale: float | Sequence[float] = 1.0,
) -> list[Obstacle]:
    """Return spheres that cover a mesh, as obstacles for paths in space and for robots.

    The surface is covered without a hole, and nothing lies further off it than a cell's diagonal.
    The inside of a closed (watertight) mesh is filled with the largest spheres that fit, so that
    what has got in is pushed out; of an open one the surface alone is an obstacle. Hundreds of
    spheres make a plan little longer to compute.

    Args:
        mesh: path of a file (dae, glb, obj, off, ply or stl), or a `trimesh.Trimesh`.
        cell: m, size of the pieces of the surface that each get a sphere: how closely the mesh is
            followed.
        position: (3,) m, where its origin is put.
        quaternion: (4,) x, y, z, w of norm 1, how it is turned.
        scale: factor of its coordinates, one or three; 0.001 for millimetres.

    Raises:
        OSError: there is no such file.
        ValueError: it is no mesh, an argument is out of range, or more than 4096 spheres are
            needed; the message says how many, and how large the mesh is.

    Example:
        >>> import trimesh
        >>> from smp_planner import mesh_obstacles
        >>> shelf = trimesh.creation.box((0.4, 0.3, 0.02))
        >>> spheres = mesh_obstacles(shelf, cell=0.05, position=(0.5, 0.0, 0.3))
    """
    cell = checked_number("cell", cell, above=0.0)
    pose = checked_pose(position, quaternion)
    factors = np.full(3, scale) if np.ndim(scale) == 0 else scale
    factors = checked_array("scale", factors, (3,))
    if not (factors > 0.0).all():
        raise ValueError(f"scale must be positive, got {scale!r}")
    if isinstance(mesh, str | os.PathLike):
        solid, where = read_mesh(Path(mesh), factors, f"the mesh {mesh}"), f"the mesh {mesh}"
    elif isinstance(mesh, trimesh.Trimesh):
        where = "mesh"
        solid = mesh.copy()
        solid.apply_transform(np.diag([*factors, 1.0]))
        check_mesh(solid, where)
    else:
        raise ValueError(f"mesh must be a path or a trimesh.Trimesh, got {type(mesh).__name__}")
    spheres = spheres_of(solid, cell, where, "if its lengths are millimetres, give scale=0.001")
    return placed_spheres(spheres, pose)


def spheres_of(mesh: Any, cell: float, where: str, advice: str) -> FloatArray:
    """Return spheres (S, 4) that cover a `trimesh.Trimesh`, and fill it where it is closed.

    Args:
        mesh: at least one triangle, m.
        cell: m, as of `mesh_obstacles`.
        where: what the mesh is, for errors.
        advice: what else than a larger cell may help, for errors.

    Raises:
        ValueError: more than 4096 spheres are needed.
    """
    _refuse_beyond(float(mesh.area) / cell**2, mesh, cell, where, advice)
    refuse_fine(mesh, cell, where, advice)
    spheres = cover_mesh(mesh, cell)
    if mesh.is_watertight:
        spheres = np.concatenate([spheres, _filling(mesh, cell)])
    _refuse_beyond(len(spheres), mesh, cell, where, advice)
    return spheres


def placed_spheres(spheres: FloatArray, pose: Pose) -> list[Obstacle]:
    """Return spheres (S, 4), centre and radius, m, as obstacles, their frame put at a pose."""
    return [
        Obstacle(shape="sphere", position=(x, y, z), size=(radius, radius, radius))
        for (x, y, z), radius in zip(
            pose.of(spheres[:, :3]).tolist(), spheres[:, 3].tolist(), strict=True
        )
    ]


def _refuse_beyond(needed: float, mesh: Any, cell: float, where: str, advice: str) -> None:
    if needed > MOST_SPHERES:
        raise ValueError(
            f"{where}, {size_of(mesh.extents)}, would need about {needed:.0f} spheres of "
            f"cell={cell} m, beyond {MOST_SPHERES}: choose a larger cell or, {advice}"
        )


def _filling(mesh: Any, cell: float) -> FloatArray:
    """Return spheres (S, 4) inside a closed mesh, the largest first, up to half a cell beyond it.

    The centres of a grid of half cells that lie deeper than a cell are covered.
    """
    pitch = 0.5 * cell
    shape = np.ceil(mesh.extents / pitch).astype(np.int64) + 3
    if shape.prod() > _MOST_VOXELS:
        raise ValueError(
            f"a mesh of {size_of(mesh.extents)} is too large to be filled with cell={cell} m: "
            "choose a larger cell"
        )
    filled = mesh.voxelized(pitch).fill()
    inside = np.pad(np.asarray(filled.matrix), 1)
    # The surface's own voxels count as outside: a sphere keeps within the mesh.
    depth = distance_transform_edt(inside) * pitch - pitch
    left = depth > cell
    places = np.stack(np.nonzero(left), axis=1)
    depths = depth[left]
    order = np.argsort(-depths, kind="stable")
    places, depths = places[order], depths[order]
    chosen = []
    while len(places):
        place, radius = places[0], depths[0]
        chosen.append((*place, radius))
        apart = np.linalg.norm((places - place) * pitch, axis=1) > radius
        apart[0] = False
        places, depths = places[apart], depths[apart]
        if len(chosen) > MOST_SPHERES:
            break
    found = np.array(chosen).reshape(-1, 4)
    centers = filled.indices_to_points(found[:, :3] - 1.0)
    return np.column_stack([np.asarray(centers).reshape(-1, 3), found[:, 3]])
