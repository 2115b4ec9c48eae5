"""Comparison of adaptations: free paths, their homotopy classes, similarity to the primitive.

A *reference* is a large draw of the unadapted primitive, which similarity is measured against.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.progress import track

from smp_gym.arrays import FloatArray
from smp_planner.benchmark.metrics import log_dimensionless_jerk, path_lengths
from smp_planner.experiments.figures import draw_side_by_side
from smp_planner.experiments.lasa_scenes import LasaScene, Method, learn
from smp_planner.experiments.paths import classes, clearances, similarity
from smp_planner.experiments.tables import Column, Row
from smp_planner.library.smp import SMP, Plan
from smp_planner.planning.modes import group

__all__ = [
    "COLUMNS",
    "NOISE_FLOOR",
    "REFERENCE_SIZE",
    "adapted",
    "common_ends",
    "compare",
    "measure",
    "noise_floor_row",
    "reference_of",
]

REFERENCE_SIZE = 1000
"""Paths in a reference."""

NOISE_FLOOR = "noise floor"
"""Method in the row of a fresh draw of the unadapted primitive."""

_REFERENCE_SEED = 2**40

COLUMNS = (
    Column("method", "Method"),
    Column("free", "Free", 1, extremes=True),
    Column("classes", "Classes", 1, extremes=True),
    Column("entropy", "Entropy, nats"),
    Column("wasserstein", "W1, mm"),
    Column("frechet", "Fréchet, mm"),
    Column("mmd", "MMD", 3),
    Column("wasserstein_free", "W1 of free, mm"),
    Column("frechet_free", "Fréchet of free, mm"),
    Column("mmd_free", "MMD of free", 3),
    Column("length", "Length, mm", 1),
    Column("smoothness", "Smoothness", 1),
)
"""Columns of the printed table of `measure`'s rows."""

_METHOD_TITLES = {
    "promp": "ProMP",
    "smp": "SMP",
    "promp_diff": "ProMPs-Diff",
    "cpromp": "CProMPs",
    "cpromp_chance": "CProMPs, chance constraints",
    "prompt_o": "ProMPT-O",
}


def compare(
    scene: LasaScene,
    methods: Mapping[str, Method],
    particles: int,
    repetitions: int,
    figure: Path,
    modes: int | None = None,
) -> list[Row]:
    """Adapt a shape by several methods, draw the first repetition and return a row for each.

    Args:
        scene: to adapt to.
        methods: by name.
        particles: P.
        repetitions: with seeds from 0.
        figure: file to write.
        modes: components of the primitive, see `lasa_scenes.learn`.

    Raises:
        ValueError: as `lasa_scenes.learn` and `SMP.adapt`.
    """
    primitive = learn(scene.shape, modes=modes)
    reference = reference_of(primitive)
    rows: list[Row] = []
    panels = {}
    for seed in track(range(repetitions), "repetitions"):
        plans = {
            name: adapted(primitive, scene, method, particles, seed)
            for name, method in methods.items()
        }
        rows.append(noise_floor_row(primitive, scene, reference, particles, seed))
        for name, plan in plans.items():
            measured = measure(plan.trajectories, primitive, scene, reference)
            rows.append({"method": name, "seed": seed, **measured})
            if seed == 0:
                panels[f"{_METHOD_TITLES[name]}: {measured['free']:.0f} of {particles} free"] = (
                    plan.trajectories
                )
    draw_side_by_side(panels, primitive.demonstrations, scene, figure)
    return rows


def adapted(primitive: SMP, scene: LasaScene, method: Method, particles: int, seed: int) -> Plan:
    """Return a scene's plan by a method.

    Args:
        primitive: of the scene's shape.
        scene: what to adapt to.
        method: how.
        particles: P.
        seed: of all randomness.
    """
    return primitive.adapt(
        scene.obstacles,
        goal=scene.goal,
        via_points=scene.via_points,
        particles=particles,
        seed=seed,
        method=method.adaptation,
        settings=method.settings,
    )


def reference_of(primitive: SMP) -> FloatArray:
    """Return `REFERENCE_SIZE` draws (R, T, 2) of the unadapted primitive, always the same."""
    return _drawn(primitive, REFERENCE_SIZE, _REFERENCE_SEED)


def measure(
    paths: FloatArray, primitive: SMP, scene: LasaScene, reference: FloatArray
) -> dict[str, float | None]:
    """Return the measures of a set of paths: a row without its method and repetition.

    Homotopy classes are told apart by the winding numbers of the free paths, and counted; `entropy`
    is that of their shares. Measures of free paths are None where none is free.

    Args:
        paths: (P, T, 2) mm.
        primitive: unadapted.
        scene: that they were adapted to.
        reference: of `reference_of`.
    """
    free = paths[clearances(paths, scene.obstacles) > 0.0]
    modes = group(classes(free, scene.obstacles, common_ends(primitive))) if len(free) else None
    of_all = similarity(paths, reference)
    of_free = of_all if len(free) == len(paths) else similarity(free, reference)
    return {
        "free": float(len(free)),
        "classes": float(modes.count) if modes else 0.0,
        "entropy": modes.entropy if modes else None,
        **of_all,
        **{f"{name}_free": value for name, value in of_free.items()},
        "length": float(path_lengths(paths).mean()),
        "smoothness": float(log_dimensionless_jerk(paths).mean()),
    }


def noise_floor_row(
    primitive: SMP, scene: LasaScene, reference: FloatArray, particles: int, seed: int
) -> dict[str, str | float | None]:
    """Return the row of a fresh draw of the unadapted primitive, the best similarity there is."""
    paths = _drawn(primitive, particles, seed)
    return {"method": NOISE_FLOOR, "seed": seed, **measure(paths, primitive, scene, reference)}


def _drawn(primitive: SMP, count: int, seed: int) -> FloatArray:
    return primitive.adapt(particles=count, seed=seed, method="promp").trajectories


def common_ends(primitive: SMP) -> FloatArray:
    """Return the mean start and end (2, 2) of the demonstrations."""
    ends = [[demo[0], demo[-1]] for demo in primitive.demonstrations]
    return np.asarray(np.mean(ends, axis=0))
