"""Measure how exact the occupancy maps are and how long they take, on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, ParamSpec, TypeVar

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import SHAPES, TABLE, Goal, Obstacle, Scene, fixtures
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.grid import bake
from smp_planner.occupancy.neural import PointNetworkMap, sample_labelled_points, train_map
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks

QUERIES = 200_000
NEAR = 0.03
AROUND = 0.10
ABOVE_TABLE = 0.04
LABELLED = 100_000
INFLATION = 0.02

FloatArray = NDArray[np.float64]
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


@dataclass
class Record:
    """What was measured of one map, over all scenes.

    Attributes:
        seconds: one entry per scene.
        error: m, of the signed distance near the surfaces.
        inside: (hits, points) of those at least 1 cm inside a body.
        outside: (hits, points) of those 2 to 6 cm outside.
    """

    seconds: list[float] = field(default_factory=list)
    error: list[FloatArray] = field(default_factory=list)
    inside: FloatArray = field(default_factory=lambda: np.zeros(2))
    outside: FloatArray = field(default_factory=lambda: np.zeros(2))

    def add(self, seconds: float, found: FloatArray, exact: FloatArray) -> None:
        """Add one scene: time, and the map's and the exact distance of the same points."""
        self.seconds.append(seconds)
        self.error.append((found - exact)[np.abs(exact) < NEAR])
        for counts, where in (
            (self.inside, exact <= -0.01),
            (self.outside, (exact >= 0.02) & (exact <= 0.06)),
        ):
            counts += np.count_nonzero(found[where] < 0.0), np.count_nonzero(where)


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


def timed(
    function: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
) -> tuple[float, Result]:
    """Return the seconds that a call took, and its result."""
    start = time.perf_counter()
    result = function(*args, **kwargs)
    return time.perf_counter() - start, result


def train_on(scene: tuple[Obstacle, ...], rng: np.random.Generator) -> PointNetworkMap:
    """Return the map learned from labelled points of a scene."""
    points, labels = sample_labelled_points(scene, LABELLED, rng, INFLATION)
    return PointNetworkMap.of(train_map(points, labels, inflation=INFLATION))


def measure(
    scenes: int, obstacles: int, spacings: list[float], trained: bool, seed: int
) -> dict[str, Record]:
    """Return a record of each map by name."""
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


def main(
    scenes: Annotated[int, typer.Option(min=1, help="Random scenes to measure on.")] = 10,
    obstacles: Annotated[int, typer.Option(min=0, help="Obstacles beside table and bin.")] = 4,
    spacing: Annotated[
        list[float] | None,
        typer.Option(min=1e-3, help="Spacing of the grids, m; repeat for more than one."),
    ] = None,
    trained: Annotated[
        bool, typer.Option(help="Also train a map from points in each scene (8 s each).")
    ] = True,
    seed: Annotated[int, typer.Option(help="Of scenes and query points.")] = 0,
) -> None:
    """Print a table of every map's accuracy and time, on one thread.

    Scenes are random boxes, cylinders and spheres with half-extents of 3 to 6 cm above the table,
    beside a bin. Points are drawn around them; the table's own surface, the easiest, is left out.
    "Error" is that of the signed distance within 3 cm of a surface: 95th percentile of its absolute
    value, and 1st and 99th with sign (positive: the map sees more room than there is). A point
    counts as occupied where the distance is negative. "Time" is that of making the map of a scene;
    for the networks asked at the points themselves, of some 150 000 points.

    Example: python scripts/measure_maps.py --scenes 3 --spacing 0.02 --no-trained
    """
    torch.set_num_threads(1)
    records = measure(scenes, obstacles, spacing or [0.02, 0.015, 0.01], trained, seed)
    table = Table(title=f"{scenes} scenes of {obstacles} obstacles, table and bin")
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
        error = 1e3 * np.concatenate(record.error)
        low, high = np.percentile(error, [1, 99])
        table.add_row(
            name,
            f"{np.percentile(np.abs(error), 95):.2f}",
            f"{low:+.2f} / {high:+.2f}",
            f"{100 * record.inside[0] / record.inside[1]:.2f}",
            f"{100 * record.outside[0] / record.outside[1]:.2f}",
            f"{1e3 * np.median(record.seconds):.1f}",
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    typer.run(main)
