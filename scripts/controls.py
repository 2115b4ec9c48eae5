"""Measure the controls: fixed detour, unadapted primitive, tree search, random actions.

One JSON file per task, family and difficulty is written; the same command continues.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.scene import DIFFICULTIES, FAMILIES, TASKS
from smp_planner.benchmark.options import (
    CommandLine,
    Jobs,
    Names,
    chosen_names,
    pooled,
    tell,
    tuning_seeds,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.experiments.controls import control_table
from smp_planner.experiments.controls.control_table import CONTROLS, ControlCell, Request

app = CommandLine(add_completion=False, no_args_is_help=True)

_Out = Annotated[Path, typer.Option(help="Folder of the results.", file_okay=False)]


@app.command()
def run(
    out: _Out = Path("results/controls"),
    tasks: Names = "",
    difficulties: Names = "easy,medium,hard",
    families: Names = FAMILIES[0],
    controls: Names = "",
    episodes: Annotated[int, typer.Option(min=1, help="Scenes of each cell.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene; below 80000.")] = 0,
    training: Annotated[int, typer.Option(min=2, help="Scenes to learn a detour on.")] = 160,
    budget: Annotated[int, typer.Option(min=1, help="Generations of each restart.")] = 40,
    restarts: Annotated[int, typer.Option(min=1, help="Of the search for a detour.")] = 3,
    physics: Annotated[bool, typer.Option(help="Execute detours and draws, too.")] = False,
    jobs: Jobs = 1,
) -> None:
    """Measure what OUT does not hold yet, and write the table.

    Example: python scripts/controls.py run --tasks Placement --difficulties hard --episodes 100
    """
    names = tuple(chosen_names(controls, CONTROLS, "--controls"))
    if tuning_seeds(seed, episodes).stop > control_table.TRAINING_SEED:
        raise typer.BadParameter(
            f"must leave all seeds below {control_table.TRAINING_SEED}, where those of the "
            f"training scenes begin; got {seed}",
            param_hint="--seed",
        )
    requests = [
        Request(
            ControlCell(task, family, difficulty),
            out,
            names,
            episodes,
            seed,
            training,
            budget,
            restarts,
            physics,
        )
        for task in chosen_names(tasks, TASKS, "--tasks")
        for family in chosen_names(families, FAMILIES, "--families")
        for difficulty in chosen_names(difficulties, DIFFICULTIES, "--difficulties")
    ]
    console = Console()
    try:
        pooled(control_table.measure, requests, "cells", console, jobs=jobs)
    except ResultsError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    table(out)


@app.command()
def table(out: _Out = Path("results/controls")) -> None:
    """Write the table of what a folder holds, finished or not, as Markdown.

    Example: python scripts/controls.py table --out results/controls
    """
    try:
        written = control_table.write_table(out)
    except ResultsError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    tell(f"wrote {written}")


if __name__ == "__main__":
    app()
