"""Compare settings of Stein variational gradient descent on scenes of the tasks."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.options import chosen_names
from smp_planner.benchmark.svgd_settings import COLUMNS, PRIORS, VARIANTS, Cell, measure_cell
from smp_planner.experiments.tables import rich_table, summarise, write_tables


def main(
    out: Annotated[Path, typer.Option(help="Folder of the tables.")] = Path(
        "results/svgd_settings"
    ),
    tasks: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    priors: Annotated[
        str, typer.Option(help=f"Of {', '.join(PRIORS)}, separated by commas. Default: all.")
    ] = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "hard",
    scenes: Annotated[int, typer.Option(min=2, help="Of each task.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 20_000,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
) -> None:
    """Plan in the same scenes with each setting and write CSV, JSON and Markdown to OUT."""
    chosen_names(difficulty, DIFFICULTIES, "--difficulty")
    if seed + scenes > EVALUATION_SEEDS_START:
        raise typer.BadParameter(
            f"must leave all seeds below {EVALUATION_SEEDS_START}, got {seed}", param_hint="--seed"
        )
    # Scenes stand before settings, so that a worker draws each scene once.
    cells = [
        Cell(task, prior, variant, difficulty, seed + number)
        for task, number, prior, variant in product(
            chosen_names(tasks, TASKS, "--tasks"),
            range(scenes),
            chosen_names(priors, tuple(PRIORS), "--priors"),
            VARIANTS,
        )
    ]
    console = Console()
    columns = (TextColumn("plans"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    rows = []
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(jobs, mp_context=context) as pool,
        Progress(*columns, console=console) as progress,
    ):
        bar = progress.add_task("plans", total=len(cells))
        for row in pool.map(measure_cell, cells, chunksize=len(VARIANTS)):
            rows.append(row)
            progress.advance(bar)
    rows.sort(key=lambda row: (str(row["task"]), str(row["prior"])))
    summaries = summarise(rows, ("task", "prior", "variant"))
    note = (
        f"Mean ± standard deviation over {scenes} scenes of difficulty {difficulty}, seeds from "
        f"{seed} on, one plan each without another try; the reference of similarity is the "
        "primitive tied to the scene's start and goal."
    )
    write_tables(rows, summaries, COLUMNS, out, "svgd_settings", note)
    console.print(rich_table(summaries, COLUMNS))
    console.print(f"wrote svgd_settings.csv, .json and .md to {out}", soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
