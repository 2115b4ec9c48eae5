"""Comparison of the occupancy maps on random scenes: accuracy and run time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.progress import track
from rich.table import Table

from smp_gym.arrays import FloatArray
from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import SHAPES, TABLE, Goal, Obstacle, Scene, fixtures
from smp_planner.benchmark.map_accuracy import ERROR_BAND, MapAccuracy
from smp_planner.benchmark.timing import timed
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.grid import bake
from smp_planner.occupancy.neural import PointNetworkMap, sample_labelled_points, train_map
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks

__all__ = ["Record", "compare_maps", "map_table", "points_around", "random_scene"]

QUERIES = 200_000
"""Points drawn in a scene."""

AROUND = 0.10
"""m beyond the bodies, as far as these lie."""

ABOVE_TABLE = 0.04
"""m of height above the table, below which none lie."""

LABELLED, INFLATION = 100_000, 0.02
"""Points that the trained map learns from, and by how much the bodies are enlarged for it, m."""


@dataclass
class Record:
    """Measurements of one map, an entry for each scene.

    Attributes:
        seconds: that it took to make.
        found: its distance of points (N,), m.
        exact: that which is right.
    """

    seconds: list[float] = field(default_factory=list)
    found: list[FloatArray] = field(default_factory=list)
    exact: list[FloatArray] = field(default_factory=list)

    def add(self, seconds: float, found: FloatArray, exact: FloatArray) -> None:
        """Add one scene: time, and the map's and the exact distance of the same points."""
        self.seconds.append(seconds)
        self.found.append(found)
        self.exact.append(exact)


def random_scene(obstacles: int, rng: np.random.Generator) -> tuple[Obstacle, ...]:
    """Return random bodies, half of them upright, in front of the arm; then table and bin."""
    bodies = []
    for _ in range(obstacles):
        shape = SHAPES[rng.integers(len(SHAPES))]
        size = rng.uniform(0.03, 0.06, 3)
        size = REGISTRY[shape].fitted(size)
        quaternion = rng.normal(size=4)
        if rng.random() < 0.5:
            quaternion[:2] = 0.0
        quaternion /= np.linalg.norm(quaternion)
        position = rng.uniform([0.2, -0.5, 0.03], [0.7, 0.5, 0.6])
        values: dict[str, Any] = {"position": position, "quaternion": quaternion, "size": size}
        lists = {name: tuple(value.tolist()) for name, value in values.items()}
        bodies.append(Obstacle.model_validate({"shape": shape, **lists}))
    x, y = rng.uniform([0.3, -0.5], [0.6, 0.5]).tolist()
    goal = Goal(position=(x, y, 0.01))
    scene = Scene(task="Placement", start=(0.0,) * 6, goals=(goal,), obstacles=tuple(bodies))
    return (*scene.obstacles, *fixtures(scene))


def points_around(scene: tuple[Obstacle, ...], rng: np.random.Generator) -> FloatArray:
    """Return points around bodies other than the table, none of them near its top."""
    bodies = PackedObstacles.of([body for body in scene if body != TABLE])
    chosen = rng.integers(len(bodies), size=QUERIES)
    reach = bodies.half_extents[chosen] + AROUND
    points = bodies.position[chosen] + reach * rng.uniform(-1.0, 1.0, (QUERIES, 3))
    return points[signed_distance(points, [TABLE]) > ABOVE_TABLE]


def train_on(scene: tuple[Obstacle, ...], rng: np.random.Generator) -> PointNetworkMap:
    """Return the map learned from labelled points of a scene."""
    points, labels = sample_labelled_points(scene, LABELLED, rng, INFLATION)
    return PointNetworkMap.of(train_map(points, labels, inflation=INFLATION))


def compare_maps(
    scenes: int, obstacles: int, spacings: list[float], trained: bool, seed: int
) -> dict[str, Record]:
    """Return a record of each map by name.

    Args:
        scenes: how many random ones.
        obstacles: of each scene, beside table and bin.
        spacings: of the grids, m.
        trained: also train a map from points in each scene.
        seed: of scenes and query points.
    """
    rng = np.random.default_rng(seed)
    networks = default_networks()
    names = ["shape networks, at the point"]
    for spacing in spacings:
        grid = f"grid of {1e3 * spacing:g} mm"
        names += [f"shape networks, {grid}", f"exact distance, {grid}"]
    if trained:
        names.append("trained on points of the scene")
    records = {name: Record() for name in names}

    # The first call compiles the kernels or loads them.
    warm = random_scene(1, np.random.default_rng(0))
    for occupancy_map in (ShapeNetworkMap(warm, networks), AnalyticMap(warm)):
        bake(occupancy_map).query(occupancy_map.signed_distance([[0.0, 0.0, 0.0]] * 3))

    for _ in track(range(scenes), description="scenes"):
        scene = random_scene(obstacles, rng)
        points = points_around(scene, rng)
        exact = signed_distance(points, scene)
        remaining = iter(records.values())
        learned = ShapeNetworkMap(scene, networks)
        next(remaining).add(*timed(learned.signed_distance, points), exact)
        for spacing in spacings:
            for source in (learned, AnalyticMap(scene)):
                seconds, baked = timed(bake, source, spacing=spacing)
                next(remaining).add(seconds, baked.query(points), exact)
        if trained:
            seconds, from_points = timed(train_on, scene, rng)
            next(remaining).add(seconds, from_points.signed_distance(points), exact)
    return records


def map_table(records: Mapping[str, Record], title: str) -> Table:
    """Return a table of records, a row for each map."""
    table = Table(title=title)
    table.add_column("map")
    for header in (
        "error p95\n(mm)",
        "error p1 / p99\n(mm)",
        "occupied, 1 cm\ninside (%)",
        "occupied, 2-6 cm\noutside (%)",
        "time\n(ms)",
    ):
        table.add_column(header, justify="right")
    for name, record in records.items():
        found, exact = np.concatenate(record.found), np.concatenate(record.exact)
        accuracy = MapAccuracy.of(len(record.found), exact, found)
        low, high = np.percentile((found - exact)[np.abs(exact) < ERROR_BAND], [1, 99])
        table.add_row(
            name,
            f"{1e3 * accuracy.error_p95:.2f}",
            f"{1e3 * low:+.2f} / {1e3 * high:+.2f}",
            f"{100 * accuracy.inside_occupied:.2f}",
            f"{100 * accuracy.outside_occupied:.2f}",
            f"{1e3 * np.median(record.seconds):.1f}",
        )
    return table
