"""Spheres that cover the collision shapes of a robot's links, as few as a bound allows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from smp_gym.arrays import FloatArray
from smp_gym.geometry.registry import REGISTRY
from smp_planner.library.urdf_reading import Link, Shape

__all__ = [
    "MOST_SPHERES",
    "check_mesh",
    "cover_link",
    "cover_mesh",
    "read_mesh",
    "refuse_fine",
    "size_of",
]

MOST_SPHERES = 4096
"""Spheres of a robot at most: the pairs of them that may touch grow with the square."""

_MOST_TRIANGLES = 1_000_000
"""Triangles that those of a mesh are cut into at most."""

_MESH_KINDS = {"dae", "glb", "obj", "off", "ply", "stl"}
"""Kinds of files that are a mesh of their own, not archives or lists of other files."""

_MILLIMETRES = 'if its lengths are millimetres, give it scale="0.001 0.001 0.001"'

_LARGEST_MESH = 256 * 2**20
"""Bytes of a file."""


def cover_link(link: Link, cell: float, left: int = MOST_SPHERES) -> FloatArray:
    """Return spheres (S, 4) that cover the collision shapes of a link, in its frame.

    Args:
        link: of a URDF.
        cell: m, size of the pieces that each get a sphere.
        left: how many spheres there may be.

    Raises:
        ValueError: there would be more, or a mesh cannot be read; the message names the link.
    """
    covers = [np.empty((0, 4))]
    for shape in link.shapes:
        if shape.kind == "mesh":
            mesh = _mesh(shape, link.name)
            extent, needed = mesh.extents, float(mesh.area) / cell**2
            _refuse_beyond(left, link, shape, extent, cell, needed)
            refuse_fine(mesh, cell, f"the mesh of link {link.name!r}", _MILLIMETRES)
            spheres = cover_mesh(mesh, cell)
        else:
            half = REGISTRY[shape.kind].of_dimensions(shape.size.tolist())
            extent, counts = 2.0 * half, np.ceil(2.0 * half / cell)
            needed = float(2.0 * (counts * np.roll(counts, 1)).sum())
            _refuse_beyond(left, link, shape, extent, cell, needed)
            spheres = REGISTRY[shape.kind].cover(half, cell)
        _refuse_beyond(left, link, shape, extent, cell, len(spheres))
        left -= len(spheres)
        centers = spheres[:, :3] @ shape.origin[:3, :3].T + shape.origin[:3, 3]
        covers.append(np.column_stack([centers, spheres[:, 3]]))
    return np.concatenate(covers)


def size_of(extent: FloatArray) -> str:
    """Return the extents (3,) of a body, m, as text."""
    return " x ".join(f"{length:.3g}" for length in extent) + " m"


def _refuse_beyond(
    left: int, link: Link, shape: Shape, extent: FloatArray, cell: float, needed: float
) -> None:
    if needed > left:
        raise ValueError(
            f"the {shape.kind} of link {link.name!r}, {size_of(extent)}, would need about "
            f"{needed:.0f} spheres of cell={cell} m, beyond the {MOST_SPHERES} that a robot may "
            f"have: choose a larger cell or, {_MILLIMETRES}"
        )


def _mesh(shape: Shape, link: str) -> Any:
    """Return the mesh of a shape, scaled, m."""
    assert shape.mesh is not None
    return read_mesh(shape.mesh, shape.size, f"the mesh {shape.mesh} of link {link!r}")


def read_mesh(file: Path, scale: FloatArray, where: str) -> Any:
    """Return the `trimesh.Trimesh` that a file holds, scaled.

    Args:
        file: of one of `_MESH_KINDS`.
        scale: (3,) factors of its coordinates.
        where: what it is, for errors.

    Raises:
        OSError: there is no such file.
        ValueError: it is of another kind, too large, damaged, or has no triangles of finite size.
    """
    kinds = sorted(_MESH_KINDS & set(trimesh.available_formats()))
    kind = file.suffix.lower().lstrip(".")
    if kind not in kinds:
        raise ValueError(f"{where} must be of a kind of {', '.join(kinds)}; got {kind!r}")
    if file.stat().st_size > _LARGEST_MESH:
        raise ValueError(f"{where} must not be larger than {_LARGEST_MESH} bytes")
    try:
        mesh: Any = trimesh.load(file, force="mesh", skip_materials=True)
        mesh.apply_transform(np.diag([*scale, 1.0]))
    except Exception as error:
        # Readers of meshes raise almost anything at damaged bytes.
        raise ValueError(f"{where} cannot be read: {error!r}") from error
    check_mesh(mesh, where)
    return mesh


def check_mesh(mesh: Any, where: str) -> None:
    """Raise ValueError unless a `trimesh.Trimesh` has triangles of finite size."""
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all() or not mesh.area > 0.0:
        raise ValueError(f"{where} must have triangles of finite size, got {len(mesh.faces)} faces")


def refuse_fine(mesh: Any, cell: float, where: str, advice: str) -> None:
    """Raise ValueError if a mesh would be cut into too many triangles."""
    cut = _cut_triangles(mesh, cell)
    if cut > _MOST_TRIANGLES:
        raise ValueError(
            f"{where}, {size_of(mesh.extents)}, would be cut into about {cut:.0f} triangles for "
            f"cell={cell} m, beyond {_MOST_TRIANGLES}: choose a larger cell or a mesh of fewer "
            f"triangles or, {advice}"
        )


def _cut_triangles(mesh: Any, cell: float) -> float:
    """Return how many triangles there may be after cutting them to edges of half a cell."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return float((4.0 ** np.ceil(np.log2(np.maximum(2.0 * longest / cell, 1.0)))).sum())


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
    order = np.argsort(which.reshape(-1), kind="stable")
    triangles, which = triangles[order], which.reshape(-1)[order]
    first = np.flatnonzero(np.diff(which, prepend=-1))
    lower = np.minimum.reduceat(triangles.min(axis=1), first)
    upper = np.maximum.reduceat(triangles.max(axis=1), first)
    center = (lower + upper) / 2
    reach = np.linalg.norm(triangles - center[which][:, None], axis=2).max(axis=1)
    return np.column_stack([center, np.maximum.reduceat(reach, first)])
