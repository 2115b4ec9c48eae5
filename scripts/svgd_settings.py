"""Compare the settings of SVGD: success, similarity, homotopy classes, their weights, diversity."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import (
    CommandLine,
    Jobs,
    Names,
    chosen_names,
    one_of,
    pooled,
    tuning_seeds,
)
from smp_planner.experiments import arm_settings
from smp_planner.experiments.svgd_settings import VARIANTS, Ground, settings_columns, settings_rows
from smp_planner.experiments.tables import report
from smp_planner.inference import SETTINGS
from smp_planner.inference.smc import SMCSettings

app = CommandLine(add_completion=False, no_args_is_help=True)

_Out = Annotated[Path, typer.Option(help="Folder of the tables.", file_okay=False)]
_Difficulty = Annotated[str, typer.Option(help="Of the scenes.")]
_Scenes = Annotated[int, typer.Option(min=2, help="Of each task.")]
_Seed = Annotated[int, typer.Option(min=0, help="Of the first scene.")]


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
    out: Annotated[Path, typer.Option(help="Folder to write.", file_okay=False)] = Path(
        "results/svgd_settings"
    ),
) -> None:
    """Adapt the S of LASA, in scenes whose exact posterior sequential Monte Carlo draws from.

    Written is a table for each scene: CSV of all rows, JSON and Markdown of means and spreads.

    All scenes together take about ten minutes of one core.

    Example: python scripts/svgd_settings.py lasa --variant fig1 --settings default,paper
    """
    chosen = chosen_names(settings, tuple(SETTINGS), "--settings")
    for name in chosen_names(variant, tuple(VARIANTS), "--variant"):
        with Console().status(f"{name}: drawing from the exact posterior"):
            ground = Ground.of(
                VARIANTS[name], reference_runs, SMCSettings(reference_particles, last_moves=100)
            )
        rows = settings_rows(ground, chosen, particles, repetitions, name)
        note = (
            f"{particles} particles, {repetitions} repetitions; the posterior by {reference_runs} "
            f"runs of {reference_particles} particles."
        )
        report(rows, ["setting"], settings_columns(ground), out, f"lasa_{name}", note, name)


@app.command()
def arm(
    out: _Out = Path("results/svgd_settings"),
    tasks: Names = "",
    priors: Annotated[
        str,
        typer.Option(
            help=f"Of {', '.join(arm_settings.PRIOR_WIDTHS)}, separated by commas. Default: all."
        ),
    ] = "",
    difficulty: _Difficulty = "hard",
    scenes: _Scenes = 20,
    seed: _Seed = 20_000,
    jobs: Jobs = 1,
) -> None:
    """Plan in scenes of the tasks with each setting; CSV, JSON and Markdown to OUT.

    Nothing is executed: sets are assessed by the planners' exact check.

    Example: python scripts/svgd_settings.py arm --tasks Placement --scenes 5 --jobs 4
    """
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    cells = arm_settings.cells_of(
        chosen_names(tasks, TASKS, "--tasks"),
        chosen_names(priors, tuple(arm_settings.PRIOR_WIDTHS), "--priors"),
        difficulty,
        tuning_seeds(seed, scenes),
    )
    together = len(arm_settings.COMPARED_SETTINGS)
    rows = pooled(arm_settings.measure_cell, cells, "plans", Console(), jobs=jobs, chunk=together)
    rows.sort(key=lambda row: (str(row["task"]), str(row["prior"])))
    note = (
        f"Mean ± standard deviation over {scenes} scenes of difficulty {difficulty}, seeds from "
        f"{seed} on, one plan each without another try; the reference of similarity is the "
        "primitive conditioned on the scene's start and goal."
    )
    report(rows, ("task", "prior", "variant"), arm_settings.COLUMNS, out, "arm", note)


if __name__ == "__main__":
    app()
