"""Covers of the links of public arms: how many spheres, how far they stand out, what they cost."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table
from scipy.spatial import cKDTree

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle
from smp_planner.experiments.public_arms import PUBLIC_ARMS, swings
from smp_planner.library.covering import cover_mesh, read_mesh
from smp_planner.library.smp import SMP
from smp_planner.library.tight_cover import GriddedBody, closed_mesh, tight_cover
from smp_planner.library.urdf_reading import read_description

__all__ = ["LinkCovers", "covers_table", "link_covers", "standing_out"]

_CELL = 0.06
"""m, of covers of the surface by cells, beside which the others stand."""

_ON_SPHERE = 300
"""Points of a sphere at which it is measured how far it stands out."""

_ON_SURFACE = 40_000
"""Points of a body's surface."""

_FINE = 0.01
"""m, bound of whose grid the inside of a body is told."""


@dataclass(frozen=True)
class LinkCovers:
    """Covers of all meshes of an arm.

    Attributes:
        arm: its name.
        kind: "cells" or "bound".
        size: m, of the cells, or the bound.
        spheres: of each mesh.
        overshoot: m, largest distance that was found of a sphere's points from its mesh.
        making: s of processor time, of all covers.
        planning: s of processor time, of a plan of 42 particles; NaN for cells, with which robots
            are no longer made.
    """

    arm: str
    kind: str
    size: float
    spheres: tuple[int, ...]
    overshoot: float
    making: float
    planning: float


def standing_out(mesh: Any, covers: Sequence[FloatArray]) -> list[float]:
    """Return the largest distance, m, of points of the spheres of covers from a body.

    Up to the distance of neighbours among `_ON_SURFACE` points of the surface.

    Args:
        mesh: `trimesh.Trimesh` of the body.
        covers: (S, 4) m each.
    """
    solid = closed_mesh(mesh)
    points = np.asarray(solid.sample(_ON_SURFACE, seed=0))
    tree = cKDTree(np.concatenate([points, GriddedBody(solid, _FINE).inside]), balanced_tree=False)
    directions = np.random.default_rng(0).normal(size=(_ON_SPHERE, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = []
    for cover in covers:
        on_spheres = (cover[:, None, :3] + directions * cover[:, None, 3:]).reshape(-1, 3)
        found.append(float(tree.query(on_spheres)[0].max()))
    return found


def link_covers(arm: str, bounds: Sequence[float], planned: bool) -> list[LinkCovers]:
    """Return what covers of the meshes of an arm are like, by cells and by bounds.

    Args:
        arm: one of `PUBLIC_ARMS`.
        bounds: m.
        planned: whether plans are timed, too.
    """
    description = read_description(PUBLIC_ARMS[arm].path(), None)
    kinds = [("cells", _CELL), *(("bound", bound) for bound in bounds)]
    counts: list[list[int]] = [[] for _ in kinds]
    out, making = np.zeros(len(kinds)), np.zeros(len(kinds))
    for link in description.links.values():
        for shape in link.shapes:
            if shape.mesh is None:
                continue
            mesh = read_mesh(shape.mesh, shape.size, str(shape.mesh))
            covers = []
            for number, (kind, size) in enumerate(kinds):
                begin = time.process_time()
                covers.append(
                    cover_mesh(mesh, size) if kind == "cells" else tight_cover(mesh, size)
                )
                making[number] += time.process_time() - begin
                counts[number].append(len(covers[-1]))
            out = np.maximum(out, standing_out(mesh, covers))
    return [
        LinkCovers(
            arm,
            kind,
            size,
            tuple(counts[number]),
            float(out[number]),
            float(making[number]),
            _planning(arm, size) if planned and kind == "bound" else np.nan,
        )
        for number, (kind, size) in enumerate(kinds)
    ]


def _planning(arm: str, overshoot: float) -> float:
    """Return the processor time, s, of the second of two plans around a ball."""
    robot = PUBLIC_ARMS[arm].robot(overshoot)
    aside = 0.8 * np.eye(robot.dimension)[0]
    ready = np.array(PUBLIC_ARMS[arm].ready)
    demonstrations = swings(ready - aside, ready + aside, np.random.default_rng(0))
    primitive = SMP.fit(demonstrations, robot=robot)
    x, y, z = robot.tool_positions(demonstrations[0])[50].tolist()
    ball = Obstacle(shape="sphere", position=(x, y, z), size=(0.06, 0.06, 0.06))
    for _ in range(2):
        begin = time.process_time()
        primitive.adapt([ball], start=demonstrations[0, 0], goal=demonstrations[0, -1])
        taken = time.process_time() - begin
    return taken


def covers_table(found: Sequence[LinkCovers]) -> Table:
    """Return a row for each kind of cover of each arm."""
    table = Table(title="Covers of the meshes of public arms")
    for column in ("arm", "cover", "spheres", "a mesh", "stands out, mm", "made, s", "plan, s"):
        table.add_column(column, justify="left" if column in ("arm", "cover") else "right")
    for each in found:
        table.add_row(
            each.arm,
            f"{each.kind} {1e3 * each.size:g} mm",
            str(sum(each.spheres)),
            f"{min(each.spheres)} to {max(each.spheres)}" if each.spheres else "-",
            f"{1e3 * each.overshoot:.1f}",
            f"{each.making:.1f}",
            "-" if np.isnan(each.planning) else f"{each.planning:.1f}",
        )
    return table
