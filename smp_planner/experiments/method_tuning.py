"""Search of the methods' settings on tuning seeds, with one budget for all of them.

For each task, every method has as many candidates: its settings as they are, and others that are
drawn at random from a space of its own. All are tried in the same scenes, one plan each. What
counts is how many scenes have a good particle, and among equals the share of particles that are
good, by the planners' exact check; the physics takes no part. All methods of a task have the same
`smooth_std` and as many tries, so that they start from one prior; neither is searched.

A second search goes on from what the first one found: every combination of two settings of each
method, on scenes of which every second one is placed without a reference trajectory.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from rich.table import Table

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.sampling import place_without_witness
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "GRIDS",
    "SPACES",
    "Cell",
    "candidate",
    "cells_of",
    "ranked",
    "trial",
    "trials_csv",
    "trials_table",
]

_COSTS: dict[str, tuple[Any, ...]] = {
    "obstacle_weight": (1.0, 3.0, 10.0, 20.0, 30.0, 100.0),
    "margin": (0.0, 0.01, 0.02, 0.03, 0.05),
    "edge_width": ((0.05, 0.01), (0.1, 0.01), (0.03, 0.01)),
    "widths": ((1.0,), (1.0, 2.0)),
    "basis": (
        {"smooth_length_scale": 0.2, "basis_functions": 15},
        {"smooth_length_scale": 0.14, "basis_functions": 20},
        {"smooth_length_scale": 0.1, "basis_functions": 25},
    ),
}
"""Settings that all methods which descend costs have; a basis is as fine as its length scale asks.
"""

SPACES: dict[str, dict[str, tuple[Any, ...]]] = {
    "smp": _COSTS | {"iterations": (30, 50, 80), "step_size": (0.1, 0.2, 0.4)},
    "cpromp": _COSTS | {"iterations": (100, 200, 400), "step_size": (0.05, 0.1, 0.2)},
    # It asks for clearances, of which no edge is wide.
    "cpromp_chance": {name: values for name, values in _COSTS.items() if name != "edge_width"}
    | {"risk": (0.001, 0.01, 0.05), "rounds": (10, 20, 40), "iterations": (10, 20, 40)},
    "prompt_o": _COSTS | {"rounds": (4, 8, 16), "iterations": (10, 20), "step_size": (0.1, 0.2)},
    "promp_diff": _COSTS
    | {"iterations": (50, 100, 200), "flow_time": (0.05, 0.1, 0.2), "fit_std": (0.05, 0.1, 0.2)},
    "rrt_connect": {
        "margin": (0.001, 0.005, 0.01, 0.02),
        "postures": (32, 64, 128),
        "posture_spread": (0.1, 0.2, 0.4),
        "branches": (4, 8, 16),
        "step": (0.25, 0.5, 1.0),
        "shortcuts": (30, 100, 300),
    },
}
"""Values of each setting, or of several together, that candidates are drawn from, by method."""

_STROKE: dict[str, tuple[Any, ...]] = {"via_share": (0.0, 0.25, 0.5)}
"""Further settings of methods that descend costs, on tasks with a stroke to follow."""


_PRIOR_GRID: dict[str, tuple[Any, ...]] = {"margin": (0.0, 0.01), "widths": ((1.0,), (1.0, 2.0))}

GRIDS: dict[str, dict[str, tuple[Any, ...]]] = {
    "smp": _PRIOR_GRID,
    "cpromp": _PRIOR_GRID,
    "prompt_o": _PRIOR_GRID,
    "promp_diff": _PRIOR_GRID,
    "rrt_connect": {"margin": (0.001, 0.01), "posture_spread": (0.2, 0.4)},
}
"""Values of the settings that are combined in a second search, by method: how near to obstacles and
how far from the demonstrations a method may be."""


class Cell(NamedTuple):
    """One candidate of a method, to be tried in some scenes.

    Attributes:
        task: its name.
        method: one of `SPACES`.
        number: of the candidate; 0 are the method's settings as they are.
        difficulty: of the scenes.
        seeds: of the scenes.
        second: whether it is of a second search, see `GRIDS`.
    """

    task: str
    method: str
    number: int
    difficulty: str
    seeds: range
    second: bool = False

    @property
    def name(self) -> str:
        """Name of the cell, in one search."""
        return f"{self.task} {self.method} {self.number}"


def candidate(task: str, method: str, number: int, *, second: bool = False) -> dict[str, Any]:
    """Return the settings of a method that a candidate has in place of the method's own.

    A candidate is a function of the arguments, so that more of them leave the first as they are.
    """
    if number == 0:
        return {}
    if second:
        return _combinations(method)[number - 1]
    space = SPACES[method]
    if task == "DrawS" and method != "rrt_connect":
        space = space | _STROKE
    rng = np.random.default_rng([number, *f"{task} {method}".encode()])
    drawn = {name: values[rng.integers(len(values))] for name, values in space.items()}
    return drawn | drawn.pop("basis", {})


def _combinations(method: str) -> list[dict[str, Any]]:
    """Return all settings of a method's grid."""
    grid = GRIDS[method]
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def cells_of(
    tasks: Iterable[str],
    methods: Iterable[str],
    candidates: int | None,
    difficulty: str,
    seeds: range,
) -> list[Cell]:
    """Return the cells of so many candidates of methods on tasks; with None, of a second search."""
    return [
        Cell(task, method, number, difficulty, seeds, second=candidates is None)
        for task, method in product(tasks, methods)
        for number in range(candidates or 1 + len(_combinations(method)))
    ]


def trial(cell: Cell) -> dict[str, Any]:
    """Return what a candidate comes to, as JSON holds it.

    Returns:
        ``settings`` of the candidate; by scene ``good`` and ``free``, the shares of particles that
        are good and collision-free, and ``seconds`` of planning.
    """
    torch.set_num_threads(1)
    settings = candidate(cell.task, cell.method, cell.number, second=cell.second)
    env = gymnasium.make(environment_id(cell.task), difficulty=cell.difficulty)
    policy = PlannerPolicy.make(cell.method, cell.task, settings=settings)
    good, free, seconds = [], [], []
    for place, seed in enumerate(cell.seeds):
        options = {}
        if cell.second and place % 2:
            options = {"scene": place_without_witness(cell.task, cell.difficulty, seed)}
        observation, _ = env.reset(seed=seed, options=options)
        _, (execution,) = policy.predict(observation, deterministic=True)
        plan = execution.plan
        good.append(float(plan.good.mean()) if len(plan.good) else 0.0)
        free.append(float(plan.collision_free.mean()) if len(plan.good) else 0.0)
        seconds.append(round(plan.planning_time, 3))
    env.close()
    return {"settings": settings, "good": good, "free": free, "seconds": seconds}


def _merit(found: Mapping[str, Any]) -> tuple[int, float]:
    return int(np.count_nonzero(found["good"])), float(np.mean(found["good"]))


def ranked(
    cells: Sequence[Cell], trials: Sequence[Mapping[str, Any]]
) -> dict[tuple[str, str], list[tuple[Cell, Mapping[str, Any]]]]:
    """Return cells and their trials by task and method, the best first."""
    groups: dict[tuple[str, str], list[tuple[Cell, Mapping[str, Any]]]] = {}
    for cell, found in zip(cells, trials, strict=True):
        groups.setdefault((cell.task, cell.method), []).append((cell, found))
    for members in groups.values():
        members.sort(key=lambda member: _merit(member[1]), reverse=True)
    return groups


def trials_csv(cells: Sequence[Cell], trials: Sequence[Mapping[str, Any]]) -> str:
    """Return CSV text of trials, a row each.

    Columns are the ``task``, ``method`` and number of the ``candidate``; how many ``scenes`` there
    were and how many of them were ``solved``; the mean shares ``good`` and ``free`` of particles;
    ``seconds`` a plan in the mean; and, as JSON, the ``settings`` in place of the method's own.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = "task method candidate scenes solved good free seconds settings"
    writer.writerow(columns.split())
    for cell, found in zip(cells, trials, strict=True):
        solved, share = _merit(found)
        means = (share, np.mean(found["free"]), np.mean(found["seconds"]))
        counts = (cell.task, cell.method, cell.number, len(cell.seeds), solved)
        writer.writerow(
            [*counts, *(f"{mean:.4f}" for mean in means), json.dumps(found["settings"])]
        )
    return text.getvalue()


def trials_table(
    cells: Sequence[Cell], trials: Sequence[Mapping[str, Any]], best: int = 3
) -> Table:
    """Return a table of the best trials of a task and method, and of the settings as they are."""
    table = Table("task", "method", "rank", "settings", "solved", "good", "free", "s a plan")
    for (task, method), members in ranked(cells, trials).items():
        for rank, (cell, found) in enumerate(members, start=1):
            if rank > best and cell.number:
                continue
            said = ", ".join(f"{name} {value}" for name, value in found["settings"].items())
            solved, share = _merit(found)
            table.add_row(
                task,
                method,
                f"{rank} of {len(members)}",
                said or "as now",
                f"{solved} of {len(cell.seeds)}",
                f"{share:.1%}",
                f"{np.mean(found['free']):.1%}",
                f"{np.mean(found['seconds']):.2f}",
            )
    return table
