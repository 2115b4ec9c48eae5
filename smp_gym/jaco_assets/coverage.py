"""Coverage of the vendor's meshes of the JACO by its collision shapes and spheres.

The meshes are those of example-robot-data (`robots/kinova_description/meshes`), which the `meshes`
extra installs together with what reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from rich.table import Table
from scipy.spatial import cKDTree

from smp_gym.arrays import FloatArray
from smp_gym.jaco_assets.description import description, link_spheres
from smp_gym.jaco_assets.solids import Shape

__all__ = ["Coverage", "coverage_table", "measure", "mesh_points"]

_SURFACE_POINTS = 40_000
"""Points on a surface: on a link they are less than 2 mm apart."""


@dataclass(frozen=True)
class Coverage:
    """The coverage of one link; lengths in m.

    Attributes:
        outside: share of the mesh's surface that no shape contains.
        gap: greatest distance of the mesh out of the shapes.
        shape_overshoot: mean and greatest distance of the shapes' surface to the mesh.
        sphere_overshoot: the same of the spheres.
    """

    outside: float
    gap: float
    shape_overshoot: tuple[float, float]
    sphere_overshoot: tuple[float, float]


def mesh_points(directory: Path, names: Sequence[str]) -> FloatArray:
    """Return the vertices and random points of the surface of meshes, (N, 3) m."""
    points = []
    for name in names:
        mesh = trimesh.load_mesh(directory / f"{name}.dae")
        points += [mesh.vertices, trimesh.sample.sample_surface(mesh, _SURFACE_POINTS, seed=0)[0]]
    return np.concatenate(points)


def measure(points: FloatArray, shapes: Sequence[Shape], spheres: FloatArray) -> Coverage:
    """Return the coverage of a link's surface points (N, 3) by shapes and by spheres (S, 4)."""
    depth = np.min([shape.signed_distance(points) for shape in shapes], axis=0)
    tree = cKDTree(points)
    rng = np.random.default_rng(0)

    corners = np.concatenate([shape.hull() for shape in shapes])
    around = rng.uniform(corners.min(axis=0), corners.max(axis=0), (20 * _SURFACE_POINTS, 3))
    distance = np.min([shape.signed_distance(around) for shape in shapes], axis=0)
    shell = around[np.abs(distance) < 5e-4]

    index = rng.integers(len(spheres), size=_SURFACE_POINTS)
    direction = rng.normal(size=(_SURFACE_POINTS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    surface = spheres[index, :3] + direction * spheres[index, 3:]
    reach = np.linalg.norm(surface[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
    surface = surface[reach.min(axis=1) > -1e-9]

    overshoot = [tree.query(points)[0] for points in (shell, surface)]
    return Coverage(
        outside=float((depth > 0).mean()),
        gap=float(max(depth.max(), 0.0)),
        shape_overshoot=(float(overshoot[0].mean()), float(overshoot[0].max())),
        sphere_overshoot=(float(overshoot[1].mean()), float(overshoot[1].max())),
    )


def coverage_table(meshes: Path) -> Table:
    """Return the coverage of the vendor's meshes by each link's shapes and spheres.

    Args:
        meshes: folder of the vendor's meshes.
    """
    table = Table(title="Coverage of the vendor's meshes: mean / greatest distance, mm")
    for column in ("link", "surface outside", "shapes", "overshoot", "spheres", "overshoot "):
        table.add_column(column, justify="left" if column == "link" else "right", no_wrap=True)
    for link in description().links:
        if not link.shapes:
            continue
        spheres = np.array(link_spheres(link))
        found = measure(mesh_points(meshes, link.meshes), link.shapes, spheres)
        mean, greatest = (1e3 * value for value in found.shape_overshoot)
        sphere_mean, sphere_greatest = (1e3 * value for value in found.sphere_overshoot)
        table.add_row(
            link.name,
            f"{found.outside:.2%}, {1e3 * found.gap:.2f} mm",
            str(len(link.shapes)),
            f"{mean:.1f} / {greatest:.1f}",
            str(len(spheres)),
            f"{sphere_mean:.1f} / {sphere_greatest:.1f}",
        )
    return table
