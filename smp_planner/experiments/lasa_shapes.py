"""All shapes of LASA among large obstacles, adapted by every method."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from rich.progress import track

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import adaptation
from smp_planner.experiments.comparison import (
    adapted,
    measure,
    noise_floor_row,
    reference_of,
)
from smp_planner.experiments.lasa_scenes import LASA_METHODS, LasaScene, Method, learn
from smp_planner.experiments.tables import Column, Row
from smp_planner.library.smp import SMP, AdaptSettings, Circle

__all__ = ["COLUMNS", "METHODS", "RADII", "crowded_scene", "shapes_rows"]

RADII = 5.0, 8.0
"""mm, least and greatest radius of an obstacle: a tenth to a sixth of a shape."""

_OBSTACLES = 2

_PHASES = 0.25, 0.75
"""Between which an obstacle lies beside a demonstration."""

_APART = 5.0
"""mm between an obstacle and every demonstrated start and end, at least."""

_TRIES = 10_000

_LIBRARY = AdaptSettings(samples=1000, retries=0)
"""Default settings of `SMP.adapt`, with one try and finer paths, as in the other experiments."""

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "smp": Method(adaptation("smp"), _LIBRARY),
        "SVGD": Method(adaptation("smp", inference="svgd", iterations=100), _LIBRARY),
        **{
            name: Method(adaptation(name), _LIBRARY)
            for name in ("cpromp", "prompt_o", "promp_diff", "promp")
        },
        **{
            f"{name}_tuned": LASA_METHODS[name]
            for name in ("smp", "cpromp", "prompt_o", "promp_diff")
        },
    }
)
"""Rows by name: with the library's settings, and with those that did best on the S."""

COLUMNS = (
    Column("method", "Method"),
    Column("solved", "Scenes with a free path, %", 1),
    Column("free", "Free", 1, extremes=True),
    Column("classes", "Classes", 2),
    Column("entropy", "Entropy, nats"),
    Column("wasserstein", "W1, mm"),
    Column("frechet", "Fréchet, mm"),
    Column("length", "Length, mm", 1),
    Column("seconds", "Processor time, s", 3),
)
"""Columns of the printed table of `shapes_rows`."""


def crowded_scene(primitive: SMP, shape: str, seed: int) -> LasaScene:
    """Return a scene of a shape with two circles of `RADII` beside its demonstrations.

    Args:
        primitive: of the shape.
        shape: of `lasa.demonstrations`.
        seed: of the circles.

    Raises:
        ValueError: the demonstrations' starts and ends leave no room for a circle.
    """
    rng = np.random.default_rng([zlib.crc32(shape.encode()), seed])
    demonstrations = np.stack(primitive.demonstrations)
    ends = demonstrations[:, [0, -1]].reshape(-1, 2)
    circles: list[Circle] = []
    for _ in range(_TRIES):
        radius = rng.uniform(*RADII)
        # Of one demonstration: the mean of several patterns is near none of them.
        demonstration = demonstrations[rng.integers(len(demonstrations))]
        place = demonstration[int(rng.uniform(*_PHASES) * (len(demonstration) - 1))]
        center = place + rng.normal(0.0, 0.5 * radius, 2)
        room = np.linalg.norm(ends - center, axis=1).min() > radius + _APART
        # What touches no demonstration is in nobody's way.
        if room and np.linalg.norm(demonstrations - center, axis=-1).min() < radius:
            circles.append(Circle((float(center[0]), float(center[1])), float(radius)))
        if len(circles) == _OBSTACLES:
            end = demonstrations[:, -1].mean(axis=0)
            return LasaScene(shape, tuple(circles), goal=(float(end[0]), float(end[1])))
    raise ValueError(f"shape must leave room for circles beside its starts and ends: {shape}")


def shapes_rows(
    shapes: Sequence[str], methods: Mapping[str, Method], scenes: int, particles: int
) -> list[Row]:
    """Return a row for each shape, scene and method, and for a fresh draw of each primitive.

    Args:
        shapes: of `lasa.shape_names`.
        methods: by name.
        scenes: of each shape, with seeds from 0.
        particles: P.
    """
    rows: list[Row] = []
    for shape in track(shapes, "shapes"):
        primitive = learn(shape)
        reference = reference_of(primitive)
        for seed in range(scenes):
            scene = crowded_scene(primitive, shape, seed)
            floor = noise_floor_row(primitive, scene, reference, particles, seed)
            rows.append(_of_shape(shape, floor, None))
            for name, method in methods.items():
                rows.append(_row(primitive, scene, reference, name, method, particles, seed))
    return rows


def _row(
    primitive: SMP,
    scene: LasaScene,
    reference: FloatArray,
    name: str,
    method: Method,
    particles: int,
    seed: int,
) -> Row:
    begin = time.process_time()
    plan = adapted(primitive, scene, method, particles, seed)
    seconds = time.process_time() - begin
    measured = measure(plan.trajectories, primitive, scene, reference)
    return _of_shape(scene.shape, {"method": name, "seed": seed, **measured}, seconds)


def _of_shape(shape: str, row: Row, seconds: float | None) -> Row:
    """Return a row of `comparison` with the shape, whether a path is free, and the time."""
    return {
        "shape": shape,
        "method": row["method"],
        "seed": row["seed"],
        "solved": 100.0 * float(bool(row["free"])),
        **row,
        "seconds": seconds,
    }
