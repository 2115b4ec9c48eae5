"""Spheres that cover the collision shapes of a robot's links, and the surfaces of meshes."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle
from smp_planner.library.tight_cover import TooLargeError, tight_cover
from smp_planner.library.urdf_reading import Link, Shape

__all__ = [
    "MOST_SPHERES",
    "check_mesh",
    "cover_link",
    "cover_mesh",
    "cover_obstacle",
    "read_mesh",
    "refuse_fine",
    "size_of",
]

MOST_SPHERES = 4096
"""Spheres of a robot at most: the pairs of them that may touch grow with the square."""

_MOST_TRIANGLES = 1_000_000
"""Triangles that those of a mesh are cut into at most."""

_OF_PRISM = 0.1
"""Share of the overshoot by which the edges of a prism stand out of its cylinder at most."""

_MESH_KINDS = {"dae", "glb", "obj", "off", "ply", "stl"}
"""Kinds of files that are a mesh of their own, not archives or lists of other files."""

_MILLIMETRES = 'if its lengths are millimetres, give it scale="0.001 0.001 0.001"'

_LARGEST_MESH = 256 * 2**20
"""Bytes of a file."""

_LEAST_MESH = 1e-3
"""m, size below which a mesh has been scaled once too often."""

_LOGGER = logging.getLogger(__name__)


def cover_link(link: Link, overshoot: float, left: int = MOST_SPHERES) -> FloatArray:
    """Return spheres (S, 4) that cover the collision shapes of a link, in its frame.

    Args:
        link: of a URDF.
        overshoot: m, largest distance of a point of a sphere from the shape that it covers.
        left: how many spheres there may be.

    Raises:
        ValueError: there would be more, or a mesh cannot be read; the message names the link.
    """
    covers = [np.empty((0, 4))]
    for shape in link.shapes:
        spheres = _cover_shape(shape, link.name, overshoot)
        if len(spheres) > left:
            raise ValueError(
                f"link {link.name!r} would need {len(spheres)} spheres for a {shape.kind} with "
                f"overshoot={overshoot} m, beyond the {MOST_SPHERES} that a robot may have: choose "
                f"a larger overshoot or, {_MILLIMETRES}"
            )
        left -= len(spheres)
        centers = spheres[:, :3] @ shape.origin[:3, :3].T + shape.origin[:3, 3]
        covers.append(np.column_stack([centers, spheres[:, 3]]))
    return np.concatenate(covers)


def cover_obstacle(obstacle: Obstacle, overshoot: float, where: str) -> FloatArray:
    """Return spheres (S, 4) that cover a body, in the frame in which it is placed.

    Args:
        obstacle: the body.
        overshoot: m, see `cover_link`.
        where: what it is, for errors.

    Raises:
        ValueError: it is of another shape, or too large for the overshoot.
    """
    half = np.array(obstacle.size)
    if obstacle.shape not in ("box", "cylinder", "sphere"):
        raise ValueError(f"{where} must be a box, a cylinder or a sphere, got {obstacle.shape}")
    if obstacle.shape == "sphere":
        spheres = np.array([[0.0, 0.0, 0.0, float(half[0])]])
    elif obstacle.shape == "box":
        spheres = _cover(trimesh.creation.box(2.0 * half), overshoot, where)
    else:
        spheres = _cover(*_prism(2.0 * float(half[2]), float(half[0]), overshoot), where)
    turn = Rotation.from_quat(obstacle.quaternion).as_matrix()
    return np.column_stack([spheres[:, :3] @ turn.T + obstacle.position, spheres[:, 3]])


def _cover_shape(shape: Shape, link: str, overshoot: float) -> FloatArray:
    """Return spheres (S, 4) that cover a shape, in its own frame."""
    if shape.kind == "sphere":
        return np.array([[0.0, 0.0, 0.0, float(shape.size[0])]])
    if shape.kind == "capsule":
        length, radius = shape.size.tolist()
        where = f"the capsule of link {link!r}"
        return _capsule(length, radius, overshoot, where, f" or, {_MILLIMETRES}")
    if shape.kind == "mesh":
        mesh = _mesh(shape, link)
    elif shape.kind == "box":
        mesh = trimesh.creation.box(shape.size)
    else:
        height, radius = shape.size.tolist()
        mesh, overshoot = _prism(height, radius, overshoot)
    return _cover(mesh, overshoot, f"the {shape.kind} of link {link!r}", f" or, {_MILLIMETRES}")


def _cover(mesh: Any, overshoot: float, where: str, advice: str = "") -> FloatArray:
    try:
        return tight_cover(mesh, overshoot)
    except TooLargeError as error:
        raise ValueError(
            f"{where}, {size_of(mesh.extents)}, is too large to be covered with "
            f"overshoot={overshoot:.3g} m, {error}: choose a larger overshoot{advice}"
        ) from error


def _capsule(length: float, radius: float, overshoot: float, where: str, advice: str) -> FloatArray:
    """Return spheres (S, 4) along the axis of a capsule, as few as the overshoot allows.

    Spheres of radius r + e, a step d apart, hold all that is within r of the axis between them if
    d²/4 + r² ≤ (r + e)²; with their centres on the axis they stand out by e.
    """
    outer, half = radius + overshoot, length / 2
    step = 2.0 * math.sqrt(outer**2 - radius**2)
    # The outermost spheres hold the balls that the capsule ends in.
    last = max(half - overshoot, 0.0)
    count = math.ceil(2.0 * last / step) + 1
    if count > MOST_SPHERES:
        raise ValueError(
            f"{where}, {size_of(np.array([2 * radius, 2 * radius, length + 2 * radius]))}, is too "
            f"large to be covered with overshoot={overshoot:.3g} m: choose a larger overshoot"
            f"{advice}"
        )
    spheres = np.zeros((count, 4))
    spheres[:, 2] = np.linspace(-last, last, count) if count > 1 else 0.0
    spheres[:, 3] = outer if count > 1 else radius + half
    return spheres


def _prism(height: float, radius: float, overshoot: float) -> tuple[Any, float]:
    """Return a prism around a cylinder, and what it leaves of the overshoot, m."""
    slack = _OF_PRISM * overshoot
    sides = max(math.ceil(math.pi / math.acos(radius / (radius + slack))), 8)
    outer = radius / math.cos(math.pi / sides)
    return trimesh.creation.cylinder(outer, height, sections=sides), overshoot - slack


def size_of(extent: FloatArray) -> str:
    """Return the extents (3,) of a body, m, as text."""
    return " x ".join(f"{length:.3g}" for length in extent) + " m"


def _mesh(shape: Shape, link: str) -> Any:
    """Return the mesh of a shape, scaled, m."""
    assert shape.mesh is not None
    return read_mesh(shape.mesh, shape.size, f"the mesh {shape.mesh} of link {link!r}")


def read_mesh(file: Path, scale: FloatArray, where: str) -> Any:
    """Return the `trimesh.Trimesh` that a file holds, scaled; one below 1 mm is warned of.

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
    if mesh.extents.max() < _LEAST_MESH:
        _LOGGER.warning(
            "%s is only %s large: if its lengths are metres, it must not be scaled to them",
            where,
            size_of(mesh.extents),
        )
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
