"""Compare the settings of SVGD: success, similarity, ways, their weights, and diversity."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    track,
)

from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.options import chosen_names
from smp_planner.experiments import arm_settings
from smp_planner.experiments.svgd_settings import EXACT, VARIANTS, Ground, settings_columns
from smp_planner.experiments.tables import print_table, summarise, write_tables
from smp_planner.inference import SETTINGS
from smp_planner.inference.smc import SMCSettings

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.command()
def lasa(
    variant: Annotated[
        str, typer.Option(help=f"Scenes, of {', '.join(VARIANTS)}. Default: all.")
    ] = "",
    settings: Annotated[
        str, typer.Option(help=f"Settings, of {', '.join(SETTINGS)}. Default: all.")
    ] = "",
    particles: Annotated[int, typer.Option(min=2, help="Of each set.")] = 42,
    repetitions: Annotated[int, typer.Option(min=1, help="Of each setting.")] = 20,
    reference_particles: Annotated[int, typer.Option(min=2, help="Of each reference run.")] = 2000,
    reference_runs: Annotated[int, typer.Option(min=1, help="Of the reference.")] = 10,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("results/svgd_settings"),
) -> None:
    """Adapt the S of LASA, in scenes whose exact posterior sequential Monte Carlo draws from.

    Written is a table for each scene: CSV of all rows, JSON and Markdown of means and spreads.

    All scenes together take about ten minutes of one core.
    """
    console = Console()
    chosen = chosen_names(settings, tuple(SETTINGS), "--settings")
    for name in chosen_names(variant, tuple(VARIANTS), "--variant"):
        with console.status(f"{name}: drawing from the exact posterior"):
            ground = Ground.of(
                VARIANTS[name], reference_runs, SMCSettings(reference_particles, last_moves=100)
            )
            rows = list(ground.reference_rows())
        todo = [(setting, seed) for setting in [EXACT, *chosen] for seed in range(repetitions)]
        for setting, seed in track(todo, name, console=console):
            rows.append(ground.row(setting, particles, seed))
        summaries, columns = summarise(rows, ["setting"]), settings_columns(ground)
        print_table(console, summaries, columns, name)
        note = (
            f"{particles} particles, {repetitions} repetitions; the posterior by {reference_runs} "
            f"runs of {reference_particles} particles."
        )
        write_tables(rows, summaries, columns, out, f"lasa_{name}", note)
    console.print(f"wrote {out}")


@app.command()
def arm(
    out: Annotated[Path, typer.Option(help="Folder of the tables.")] = Path(
        "results/svgd_settings"
    ),
    tasks: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    priors: Annotated[
        str,
        typer.Option(
            help=f"Of {', '.join(arm_settings.PRIORS)}, separated by commas. Default: all."
        ),
    ] = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "hard",
    scenes: Annotated[int, typer.Option(min=2, help="Of each task.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 20_000,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
) -> None:
    """Plan in scenes of the tasks with each setting; CSV, JSON and Markdown to OUT.

    Nothing is executed: sets are judged by the planners' exact check.
    """
    chosen_names(difficulty, DIFFICULTIES, "--difficulty")
    if seed + scenes > EVALUATION_SEEDS_START:
        raise typer.BadParameter(
            f"must leave all seeds below {EVALUATION_SEEDS_START}, got {seed}", param_hint="--seed"
        )
    # Scenes stand before settings, so that a worker draws each scene once.
    cells = [
        arm_settings.Cell(task, prior, variant, difficulty, seed + number)
        for task, number, prior, variant in product(
            chosen_names(tasks, TASKS, "--tasks"),
            range(scenes),
            chosen_names(priors, tuple(arm_settings.PRIORS), "--priors"),
            arm_settings.VARIANTS,
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
        for row in pool.map(arm_settings.measure_cell, cells, chunksize=len(arm_settings.VARIANTS)):
            rows.append(row)
            progress.advance(bar)
    rows.sort(key=lambda row: (str(row["task"]), str(row["prior"])))
    summaries = summarise(rows, ("task", "prior", "variant"))
    note = (
        f"Mean ± standard deviation over {scenes} scenes of difficulty {difficulty}, seeds from "
        f"{seed} on, one plan each without another try; the reference of similarity is the "
        "primitive tied to the scene's start and goal."
    )
    write_tables(rows, summaries, arm_settings.COLUMNS, out, "arm", note)
    print_table(console, summaries, arm_settings.COLUMNS)
    console.print(f"wrote arm.csv, .json and .md to {out}", soft_wrap=True)


if __name__ == "__main__":
    app()
