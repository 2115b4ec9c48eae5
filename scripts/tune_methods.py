"""Search the settings of the planning methods on tuning seeds, each with the same budget."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.atomic_files import write_text
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import (
    Jobs,
    Names,
    chosen_names,
    one_of,
    run_command,
    tuning_seeds,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.experiments.kept_results import kept_results
from smp_planner.experiments.method_tuning import (
    GRIDS,
    SPACES,
    cells_of,
    trial,
    trials_csv,
    trials_table,
)


def main(
    out: Annotated[
        Path,
        typer.Option(
            help="JSON file of all trials; the command resumes. Their means go into a CSV beside.",
            dir_okay=False,
        ),
    ] = Path("results/tuning/trials.json"),
    tasks: Names = "",
    methods: Names = "",
    candidates: Annotated[
        int | None, typer.Option(min=1, help="Of each method, on each task [30].")
    ] = None,
    second: Annotated[
        bool,
        typer.Option(
            "--second",
            help="Combine margins and widths of the settings as they are, on scenes of which every "
            "second one is placed without a reference trajectory.",
        ),
    ] = False,
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=1, help="Of each task.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 30_000,
    jobs: Jobs = 1,
) -> None:
    """Try all candidates and print the best of each task and method.

    Each trial is kept as it ends: the same command continues, also with more candidates or methods.

    Example: python scripts/tune_methods.py --tasks Placement --methods smp,cpromp --jobs 4
    """
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    seeds = tuning_seeds(seed, scenes)
    chosen_tasks = chosen_names(tasks, TASKS, "--tasks")
    chosen = chosen_names(methods, tuple(GRIDS if second else SPACES), "--methods")
    if second and candidates is not None:
        raise typer.BadParameter(
            f"goes without --second, whose candidates are given; got {candidates}",
            param_hint="--candidates",
        )
    count = None if second else candidates or 30
    cells, console = cells_of(chosen_tasks, chosen, count, difficulty, seeds), Console()
    terms = {"difficulty": difficulty, "seeds": [seeds[0], seeds[-1]], "second": second}
    by_name = {cell.name: cell for cell in cells}
    try:
        found = kept_results(out, terms, trial, by_name, "candidates", console, jobs)
    except ResultsError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    trials = list(found.values())
    write_text(out.with_suffix(".csv"), trials_csv(cells, trials))
    console.print(trials_table(cells, trials))


if __name__ == "__main__":
    run_command(main)
