"""Tuning of each method: the settings with the most free paths on scenes of their own.

Of the settings whose count of free paths is within `COUNT_TOLERANCE` of the highest, those are
taken whose paths are nearest to the unadapted primitive, by the Wasserstein distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from rich.progress import track

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import adaptation
from smp_planner.benchmark.metrics import resample, wasserstein
from smp_planner.experiments.comparison import adapted, reference_of
from smp_planner.experiments.lasa_scenes import (
    TUNING_SCENES,
    LasaScene,
    Method,
    learn,
    settings,
)
from smp_planner.experiments.paths import clearances
from smp_planner.experiments.tables import Column, Row, Spread
from smp_planner.library.smp import SMP

__all__ = [
    "CANDIDATES",
    "COLUMNS",
    "COUNT_TOLERANCE",
    "FIRST_TUNING_SEED",
    "best",
    "tuning_row",
    "tuning_rows",
]

COUNT_TOLERANCE = 0.5
"""Free paths, out of those of a plan, by which means are taken for equal."""

FIRST_TUNING_SEED = 1000
"""First seed of tuning; evaluations take seeds from 0."""

COLUMNS = (
    Column("method", "Method"),
    Column("candidate", "Settings, lengths in extents"),
    Column("free", "Free", 1, extremes=True),
    Column("wasserstein", "W1, mm"),
)
"""Columns of the printed table of `tuning_row`s."""

_EDGES = ((0.05, 0.01), (0.1, 0.01))

CANDIDATES: Mapping[str, tuple[Method, ...]] = {
    "smp": tuple(
        Method(adaptation("smp", iterations=iterations), settings(weight, margin))
        for weight, margin, iterations in product((3.0, 10.0, 30.0, 100.0), (0.01, 0.02), (50, 100))
    ),
    "promp_diff": tuple(
        Method(
            adaptation(
                "promp_diff",
                iterations=iterations,
                flow_time=0.002,
                longest_move=0.004,
                fit_std=fit_std,
            ),
            settings(margin=margin, edge_width=edge_width),
        )
        for margin, edge_width, iterations, fit_std in product(
            (0.02, 0.06, 0.12, 0.18), _EDGES, (300, 1000), (0.0025, 0.005, 0.02)
        )
    ),
    "cpromp": tuple(
        Method(adaptation("cpromp", iterations=iterations), settings(weight, margin))
        for weight, margin, iterations in product(
            (3.0, 10.0, 30.0, 100.0), (0.01, 0.04), (200, 400)
        )
    ),
    "prompt_o": tuple(
        Method(adaptation("prompt_o", iterations=iterations), settings(weight, margin))
        for weight, margin, iterations in product(
            (10.0, 100.0), (0.01, 0.06, 0.12, 0.18, 0.24), (10, 30)
        )
    ),
}
"""Candidate settings, by method."""


def tuning_rows(name: str, particles: int, repetitions: int) -> list[Row]:
    """Return the results of each of a method's `CANDIDATES` on the tuning scenes.

    Args:
        name: of the method.
        particles: P.
        repetitions: in each scene, with seeds from `FIRST_TUNING_SEED`.
    """
    primitive = learn(TUNING_SCENES[0].shape)
    reference = reference_of(primitive)
    return [
        tuning_row(name, index, primitive, scene, reference, particles, seed)
        for index in track(range(len(CANDIDATES[name])), name)
        for scene in TUNING_SCENES
        for seed in range(FIRST_TUNING_SEED, FIRST_TUNING_SEED + repetitions)
    ]


def tuning_row(
    name: str,
    index: int,
    primitive: SMP,
    scene: LasaScene,
    reference: FloatArray,
    particles: int,
    seed: int,
) -> dict[str, str | float | None]:
    """Return the result of one of the `CANDIDATES` in a scene.

    Args:
        name: of the method.
        index: of the candidate.
        primitive: of the scene's shape.
        scene: to adapt to.
        reference: draws of the unadapted primitive.
        particles: P.
        seed: of the plan.
    """
    method = CANDIDATES[name][index]
    paths = adapted(primitive, scene, method, particles, seed).trajectories
    return {
        "method": name,
        "candidate": _described(method),
        "seed": seed,
        "free": float((clearances(paths, scene.obstacles) > 0.0).sum()),
        "wasserstein": wasserstein(resample(paths), resample(reference)),
    }


def _described(method: Method) -> str:
    given, own = method.settings, method.adaptation.settings.model_dump()
    first, last = given.edge_width
    text = f"{own['iterations']} iterations, margin {given.margin:g}"
    if "fit_std" in own:
        return f"{text}, edge {first:g} to {last:g}, fit within {own['fit_std']:g}"
    return f"{text}, λ {given.obstacle_weight:g}"


def best(summaries: Sequence[Mapping[str, str | Spread]]) -> int:
    """Return the index of the settings to take, of those of one method.

    Args:
        summaries: of `tuning_row`s, at least one, in the order of the candidates.
    """
    free = np.array([_mean(summary["free"]) for summary in summaries])
    distance = np.array([_mean(summary["wasserstein"]) for summary in summaries])
    distance[free < free.max() - COUNT_TOLERANCE] = np.inf
    return int(distance.argmin())


def _mean(value: str | Spread) -> float:
    assert isinstance(value, Spread)
    assert value.mean is not None
    return value.mean
