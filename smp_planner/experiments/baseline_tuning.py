"""Search of the settings of the paper's baselines on tuning seeds, task by task.

What counts is what Table II counts: the share of the particles that are collision-free, executable
and end in the goal, by the planners' exact check. The physics takes no part. All methods of a task
have the same `smooth_std`, so that they start from one prior; it is not searched.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from rich.table import Table

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = ["CANDIDATES", "Cell", "Trial", "candidates", "cells_of", "trial", "trials_table"]

CANDIDATES: dict[str, tuple[dict[str, Any], ...]] = {
    "cpromp": (
        {},
        {"obstacle_weight": 10.0},
        {"obstacle_weight": 30.0},
        {"obstacle_weight": 30.0, "margin": 0.02},
        {"obstacle_weight": 100.0, "margin": 0.02},
        {"obstacle_weight": 30.0, "margin": 0.02, "iterations": 400},
    ),
    "prompt_o": (
        {},
        {"obstacle_weight": 3.0},
        {"obstacle_weight": 30.0},
        {"obstacle_weight": 30.0, "margin": 0.03},
        {"obstacle_weight": 30.0, "margin": 0.03, "rounds": 16},
        {"obstacle_weight": 100.0, "margin": 0.05},
    ),
    "promp_diff": (
        {},
        {"fit_std": 0.05},
        {"fit_std": 0.2},
        {"margin": 0.05},
        {"margin": 0.05, "fit_std": 0.05},
        {"margin": 0.05, "fit_std": 0.2},
    ),
}
"""Settings that are tried for each method, in place of its defaults."""

STROKE_CANDIDATES: tuple[dict[str, Any], ...] = (
    {"via_share": 0.25},
    {"via_share": 0.0},
    {"via_share": 0.0, "obstacle_weight": 30.0},
)
"""Further candidates on tasks with a stroke to follow."""


def candidates(task: str, method: str) -> tuple[dict[str, Any], ...]:
    """Return the settings that are tried for a method on a task."""
    return CANDIDATES[method] + (STROKE_CANDIDATES if task == "DrawS" else ())


class Trial(NamedTuple):
    """Results of one setting in some scenes.

    Attributes:
        solved: scenes with a particle that succeeds.
        share: mean share of particles that succeed.
        free: mean share of particles that are collision-free.
    """

    solved: int
    share: float
    free: float


class Cell(NamedTuple):
    """One setting of a method, to be tried in some scenes.

    Attributes:
        task: its name.
        method: one of `CANDIDATES`.
        settings: in place of the method's own.
        difficulty: of the scenes.
        seeds: of the scenes.
    """

    task: str
    method: str
    settings: dict[str, Any]
    difficulty: str
    seeds: range


def cells_of(
    tasks: Iterable[str], methods: Iterable[str], difficulty: str, seeds: range
) -> list[Cell]:
    """Return all candidates of some methods on some tasks."""
    return [
        Cell(task, method, settings, difficulty, seeds)
        for task, method in product(tasks, methods)
        for settings in candidates(task, method)
    ]


def trial(cell: Cell) -> Trial:
    """Return the results of one setting of a method."""
    task, method, settings, difficulty, seeds = cell
    torch.set_num_threads(1)
    env = gymnasium.make(environment_id(task), difficulty=difficulty)
    policy = PlannerPolicy.make(method, task, settings=settings)
    shares, free = [], []
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        _, (execution,) = policy.predict(observation, deterministic=True)
        plan = execution.plan
        shares.append(float(plan.good.mean()))
        free.append(float(plan.collision_free.mean()))
    env.close()
    return Trial(int(np.count_nonzero(shares)), float(np.mean(shares)), float(np.mean(free)))


def trials_table(cells: Sequence[Cell], trials: Sequence[Trial]) -> Table:
    """Return a table of trials, the best of each task and method first."""
    table = Table("task", "method", "settings", "solved", "particles that succeed", "free")
    groups: dict[tuple[str, str], list[tuple[Cell, Trial]]] = {}
    for cell, found in zip(cells, trials, strict=True):
        groups.setdefault((cell.task, cell.method), []).append((cell, found))
    for group, members in groups.items():
        for cell, found in sorted(members, key=lambda member: -member[1].share):
            said = ", ".join(f"{name} {value:g}" for name, value in cell.settings.items())
            table.add_row(
                *group,
                said or "as now",
                f"{found.solved} of {len(cell.seeds)}",
                f"{found.share:.1%}",
                f"{found.free:.1%}",
            )
    return table
