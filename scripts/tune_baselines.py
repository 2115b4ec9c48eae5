"""Search the settings of the paper's baselines on tuning seeds, task by task.

What counts is what Table II counts: the share of the particles that are collision-free, executable
and end in the goal, judged by the planners' exact check. The physics takes no part. All methods of
a task have the same freedom (`smooth_std`), so that they start from one prior; it is not searched.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import gymnasium
import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.options import chosen_names
from smp_planner.benchmark.results_folder import write_json
from smp_planner.planners.judging import REACHED
from smp_planner.policy.planner_policy import PlannerPolicy

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
"""Further ones where a stroke is to be followed."""


def candidates(task: str, method: str) -> tuple[dict[str, Any], ...]:
    """Return the settings that are tried for a method on a task."""
    return CANDIDATES[method] + (STROKE_CANDIDATES if task == "DrawS" else ())


class Trial(NamedTuple):
    """What came of one setting in some scenes.

    Attributes:
        solved: scenes with a particle that succeeds.
        share: mean share of particles that succeed.
        free: mean share of particles that are collision-free.
    """

    solved: int
    share: float
    free: float


def trial(task: str, method: str, settings: dict[str, Any], difficulty: str, seeds: range) -> Trial:
    """Return what one setting of a method comes to."""
    torch.set_num_threads(1)
    env = gymnasium.make(f"smp_gym/{task}-v0", difficulty=difficulty)
    policy = PlannerPolicy.make(method, task, settings=settings)
    shares, free = [], []
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        _, (execution,) = policy.predict(observation, deterministic=True)
        plan = execution.plan
        shares.append(float((plan.good & (plan.goal_error < REACHED)).mean()))
        free.append(float(plan.collision_free.mean()))
    env.close()
    return Trial(int(np.count_nonzero(shares)), float(np.mean(shares)), float(np.mean(free)))


def _trial(cell: tuple[str, str, dict[str, Any], str, range]) -> Trial:
    return trial(*cell)


def main(
    out: Annotated[Path, typer.Option(help="JSON file of all trials.")] = Path(
        "results/tuned_baselines.json"
    ),
    tasks: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    methods: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=1, help="Of each task.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 1000,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
) -> None:
    """Try all candidates and print them, the best of each task and method first."""
    chosen_names(difficulty, DIFFICULTIES, "--difficulty")
    seeds = range(seed, seed + scenes)
    if seeds.stop > EVALUATION_SEEDS_START:
        raise typer.BadParameter(
            f"must leave all seeds below {EVALUATION_SEEDS_START}, got {seed}", param_hint="--seed"
        )
    groups = list(
        product(
            chosen_names(tasks, TASKS, "--tasks"),
            chosen_names(methods, tuple(CANDIDATES), "--methods"),
        )
    )
    cells = [
        (task, method, settings, difficulty, seeds)
        for task, method in groups
        for settings in candidates(task, method)
    ]
    console = Console()
    context = multiprocessing.get_context("spawn")
    found = []
    with ProcessPoolExecutor(jobs, mp_context=context) as pool, Progress(console=console) as bar:
        running = bar.add_task("settings", total=len(cells))
        for cell, outcome in zip(cells, pool.map(_trial, cells), strict=True):
            bar.advance(running)
            found.append((cell[:3], outcome))
    table = Table("task", "method", "settings", "solved", "particles that succeed", "free")
    for group in groups:
        of_group = [(settings, o) for (*key, settings), o in found if tuple(key) == group]
        for settings, outcome in sorted(of_group, key=lambda pair: -pair[1].share):
            said = ", ".join(f"{name} {value:g}" for name, value in settings.items()) or "as now"
            table.add_row(
                *group,
                said,
                f"{outcome.solved} of {scenes}",
                f"{outcome.share:.1%}",
                f"{outcome.free:.1%}",
            )
    console.print(table)
    out.parent.mkdir(parents=True, exist_ok=True)
    trials = [
        {"task": task, "method": method, "settings": settings, **outcome._asdict()}
        for (task, method, settings), outcome in found
    ]
    write_json(out, {"difficulty": difficulty, "seeds": [seeds[0], seeds[-1]], "trials": trials})


if __name__ == "__main__":
    typer.run(main)
