"""Play the witnesses of sampled scenes in the physics: every one has to solve its scene."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from smp_gym.inspection.witness_check import witness_solves
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import Jobs, Names, chosen_names, pooled, run_command
from smp_planner.benchmark.statistics import rate_interval


def main(
    tasks: Names = "",
    difficulties: Names = "",
    episodes: Annotated[int, typer.Option(min=1, help="Scenes of a task and difficulty.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    jobs: Jobs = 1,
) -> None:
    """Play witnesses; the exit status is 1 if one fails.

    Example: python scripts/check_witnesses.py --tasks DrawS --difficulties hard --jobs 4
    """
    groups = [
        (task, difficulty)
        for task in chosen_names(tasks, TASKS, "--tasks")
        for difficulty in chosen_names(difficulties, DIFFICULTIES, "--difficulties")
    ]
    seeds = range(seed, seed + episodes)
    cells = [(task, difficulty, number) for task, difficulty in groups for number in seeds]
    console = Console()
    solved = pooled(witness_solves, cells, "witnesses", console, jobs=jobs, chunk=5)
    failed = [cell for cell, succeeds in zip(cells, solved, strict=True) if not succeeds]
    table = Table("task", "difficulty", "successes", "95 % interval", "seeds that fail")
    for task, difficulty in groups:
        bad = [number for *group, number in failed if tuple(group) == (task, difficulty)]
        rate = rate_interval(episodes - len(bad), episodes)
        table.add_row(
            task,
            difficulty,
            f"{episodes - len(bad)} of {episodes}",
            f"{rate['low']:.1%} to {rate['high']:.1%}",
            ", ".join(map(str, bad)),
        )
    console.print(table)
    if failed:
        raise typer.Exit(1)


if __name__ == "__main__":
    run_command(main)
