"""Measure Table II of the paper: four scenes, all methods, every trajectory executed."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.scene import TASKS
from smp_planner.benchmark.options import (
    CommandLine,
    Jobs,
    Names,
    chosen_names,
    print_error,
    progress_bar,
    tell,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.runner import EpisodeFailedError, WorkerDiedError
from smp_planner.experiments.table_two import figure, repetitions, report, running, scenes

app = CommandLine(add_completion=False)

_CHOOSING = ("promp_diff", "prompt_o", "cpromp", "smp")

_Out = Annotated[Path, typer.Option(help="Folder of the results.", file_okay=False)]


@app.command()
def run(
    out: _Out = Path("results/table_two"),
    tasks: Names = "",
    methods: Names = "",
    repetitions_: Annotated[
        int, typer.Option("--repetitions", min=1, help="Of each task and method.")
    ] = 20,
    jobs: Jobs = 1,
) -> None:
    """Play what the folder does not hold yet, then write tables and figure.

    After an interruption the same command continues where it stopped.

    Example: python scripts/table_two.py run --tasks Placement --methods smp,cpromp --jobs 4
    """
    keys = running.keys_of(
        chosen_names(tasks, TASKS, "--tasks"),
        chosen_names(methods, repetitions.METHODS, "--methods"),
        repetitions_,
    )
    console = Console()
    try:
        with progress_bar("repetitions", len(keys), console) as (progress, bar):
            running.run(
                keys,
                out,
                jobs=jobs,
                on_progress=lambda done, total: progress.update(bar, completed=done, total=total),
            )
    except ResultsError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    except (WorkerDiedError, EpisodeFailedError) as error:
        print_error(str(error))
        raise typer.Exit(1) from error
    show(out)


@app.command()
def show(
    out: _Out = Path("results/table_two"),
    newer: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder whose rows take the place of those of the same tasks and methods; may be "
            "given several times.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
) -> None:
    """Write tables and figure of what a folder holds, finished or not.

    Example: python scripts/table_two.py show --out results/table_two
    """
    rows = running.read(out)
    if not rows:
        raise typer.BadParameter(f"{str(out)!r} holds no repetitions", param_hint="--out")
    for folder in newer or ():
        measured = running.read(folder)
        again = {(row.task, row.method) for row in measured}
        rows = [row for row in rows if (row.task, row.method) not in again] + measured
    summary = report.write_report(rows, out)
    figure.draw_table(summary, out / "table_two.png")
    written = ("trajectories.csv", "repetitions.csv", "summary.json", "table_two.md")
    for name in (*written, "table_two.png"):
        tell(f"wrote {out / name}")


@app.command()
def choose() -> None:
    """Choose the scenes anew by their rule, and write them into the packaged data."""
    chosen = [scenes.choose_scene(task, _CHOOSING) for task in TASKS]
    path = asset_path("experiments") / scenes.SCENES_FILE
    scenes.write_scenes(chosen, path)
    for scene in chosen:
        Console().print(f"{scene.task}: seed {scene.seed}")


if __name__ == "__main__":
    app()
