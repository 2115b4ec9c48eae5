"""New ends and via-points, Fig. 2: numbers of paths that reach them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.progress import track

from smp_gym.arrays import BoolArray, FloatArray
from smp_planner.adaptation import adaptation
from smp_planner.experiments.comparison import adapted
from smp_planner.experiments.figures import draw_side_by_side
from smp_planner.experiments.lasa_scenes import LASA_METHODS, LasaScene, Method, learn
from smp_planner.experiments.paths import clearances
from smp_planner.experiments.tables import Column, Row
from smp_planner.library.smp import AnyOf, Plan, ViaPoint

__all__ = [
    "COLUMNS",
    "POINT_TOLERANCE",
    "end_errors",
    "modulate",
    "modulation_row",
    "passed_via_points",
]

POINT_TOLERANCE = 1.0
"""mm, within which a via-point counts as passed and an end as reached."""

COLUMNS = (
    Column("scene", "Scene"),
    Column("method", "Method"),
    Column("free", "Free", 1, extremes=True),
    Column("passed", "Via-points passed", 1, extremes=True),
    Column("reached", "End reached", 1, extremes=True),
    Column("good", "All of it", 1, extremes=True),
    Column("end_error", "Mean end error, mm"),
    Column("worst_end_error", "Greatest end error, mm"),
)
"""Columns of the printed table of `modulation_row`s."""


def modulate(
    scenes: Mapping[str, LasaScene],
    particles: int,
    repetitions: int,
    figure: Path,
    modes: int | None = None,
) -> list[Row]:
    """Adapt shapes by SMP, draw the first repetition and return a row for each.

    Ends and via-points are conditioned on ("exact"), or left to their costs as in the paper
    ("soft"), which takes twice the iterations.

    Args:
        scenes: by name.
        particles: P.
        repetitions: with seeds from 0.
        figure: file to write.
        modes: components of the primitives, see `lasa_scenes.learn`.

    Raises:
        ValueError: as `lasa_scenes.learn` and `SMP.adapt`.
    """
    exact = LASA_METHODS["smp"]
    soft = exact.settings.model_copy(update={"modulation": "likelihood"})
    methods = {"exact": exact, "soft": Method(adaptation("smp", iterations=200), soft)}
    rows: list[Row] = []
    panels, drawn = {}, []
    for name, scene in scenes.items():
        primitive = learn(scene.shape, modes=modes)
        for seed in track(range(repetitions), name):
            for kind, method in methods.items():
                plan = adapted(primitive, scene, method, particles, seed)
                rows.append(modulation_row(name, kind, scene, plan, seed))
                if seed == 0 and kind == "exact":
                    panels[f"({name})"] = plan.trajectories
                    drawn.append(scene)
    draw_side_by_side(panels, primitive.demonstrations, drawn, figure)
    return rows


def modulation_row(
    name: str, method: str, scene: LasaScene, plan: Plan, seed: int
) -> dict[str, str | float | None]:
    """Return the numbers of a plan's paths that meet each of the constraints.

    Args:
        name: of the scene.
        method: its name.
        scene: with or without via-points, goal and obstacles.
        plan: by that method.
        seed: of the plan.
    """
    paths = plan.trajectories
    free = clearances(paths, scene.obstacles) > 0.0
    passed = passed_via_points(paths, scene)
    error = end_errors(paths, scene)
    reached = error <= POINT_TOLERANCE
    return {
        "scene": name,
        "method": method,
        "seed": seed,
        "free": float(free.sum()),
        "passed": float(passed.sum()),
        "reached": float(reached.sum()),
        "good": float((free & passed & reached).sum()),
        "end_error": float(error.mean()),
        "worst_end_error": float(error.max()),
    }


def passed_via_points(paths: FloatArray, scene: LasaScene) -> BoolArray:
    """Return whether (P,) paths (P, T, 2) pass all via-points, within `POINT_TOLERANCE`, in time.

    Of several to choose from, one is enough.
    """
    passed = np.ones(len(paths), np.bool_)
    at = np.linspace(0.0, 1.0, paths.shape[1])
    for via in scene.via_points:
        options = via.options if isinstance(via, AnyOf) else (via,)
        distances = []
        for option in options:
            assert isinstance(option, ViaPoint)
            points = [[np.interp(option.phase, at, x) for x in path.T] for path in paths]
            distances.append(np.linalg.norm(np.array(points) - option.position, axis=-1))
        passed &= np.min(distances, axis=0) <= POINT_TOLERANCE
    return passed


def end_errors(paths: FloatArray, scene: LasaScene) -> FloatArray:
    """Return (P,) mm from the ends of paths (P, T, 2) to the scene's goal; 0 without one."""
    if scene.goal is None:
        return np.zeros(len(paths))
    return np.asarray(np.linalg.norm(paths[:, -1] - np.asarray(scene.goal), axis=-1))
