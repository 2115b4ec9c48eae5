"""Search the settings of the paper's baselines on tuning seeds, task by task.

What is tried, and what counts, is in `smp_planner.experiments.baseline_tuning`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import (
    Jobs,
    Names,
    chosen_names,
    one_of,
    pooled,
    run_command,
    tuning_seeds,
)
from smp_planner.benchmark.results_folder import write_json
from smp_planner.experiments.baseline_tuning import CANDIDATES, cells_of, trial, trials_table


def main(
    out: Annotated[Path, typer.Option(help="JSON file of all trials.")] = Path(
        "results/tuned_baselines.json"
    ),
    tasks: Names = "",
    methods: Names = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=1, help="Of each task.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 1000,
    jobs: Jobs = 1,
) -> None:
    """Try all candidates and print them, the best of each task and method first.

    Example: python scripts/tune_baselines.py --tasks Placement --methods cpromp --jobs 4
    """
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    seeds = tuning_seeds(seed, scenes)
    chosen_tasks = chosen_names(tasks, TASKS, "--tasks")
    chosen = chosen_names(methods, tuple(CANDIDATES), "--methods")
    cells, console = cells_of(chosen_tasks, chosen, difficulty, seeds), Console()
    found = pooled(trial, cells, "settings", console, jobs=jobs)
    console.print(trials_table(cells, found))
    out.parent.mkdir(parents=True, exist_ok=True)
    trials = [
        {"task": cell.task, "method": cell.method, "settings": cell.settings, **one._asdict()}
        for cell, one in zip(cells, found, strict=True)
    ]
    write_json(out, {"difficulty": difficulty, "seeds": [seeds[0], seeds[-1]], "trials": trials})


if __name__ == "__main__":
    run_command(main)
