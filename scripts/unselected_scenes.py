"""Hold particle sets of all methods against the posterior, on scenes that nobody selected."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.atomic_files import write_text
from smp_gym.datasets.frozen import load_episodes
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_gym.suites import Cell
from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.options import (
    Jobs,
    Names,
    chosen_names,
    one_of,
    run_command,
    tell,
    tuning_seeds,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.experiments.kept_results import kept_results
from smp_planner.experiments.paired_differences import differences, differences_table
from smp_planner.experiments.tables import report
from smp_planner.experiments.unselected_scenes import (
    COLUMNS,
    COMPARED,
    METHODS,
    cells_of,
    measure_scene,
)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the tables.", file_okay=False)] = Path(
        "results/unselected"
    ),
    tasks: Names = "",
    methods: Annotated[
        str,
        typer.Option(help=f"Of {'; '.join(METHODS)}, separated by semicolons. Default: all."),
    ] = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=2, help="Of each task.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 79_000,
    frozen: Annotated[
        bool,
        typer.Option(
            "--frozen", help="The first scenes of the frozen lists instead: for the last word only."
        ),
    ] = False,
    first: Annotated[
        int, typer.Option(min=0, help="Place of the first scene in the frozen lists.")
    ] = 0,
    references: Annotated[
        int | None,
        typer.Option(min=0, help="Scenes of each task that have draws of the posterior [all]."),
    ] = None,
    executed: Annotated[
        int, typer.Option(min=0, help="Particles of each set that are executed.")
    ] = 0,
    jobs: Jobs = 1,
) -> None:
    """Plan unselected scenes with each method and write tables of what the sets are worth.

    The posterior is drawn from by sequential Monte Carlo, twice for each scene: the second run
    gives the noise floor. Scenes are kept in OUT/scenes.json as they end: the same command
    continues, also with more scenes. Written are sets.csv, .json and .md, and differences.md: those
    of all methods from smp, paired over scenes, with bootstrap intervals, and tests corrected by
    Holm's method.

    Example: python scripts/unselected_scenes.py --tasks DrawS --methods "smp;cpromp" --executed 10
    """
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    names = [name.strip() for name in methods.split(";") if name.strip()] or list(METHODS)
    for name in names:
        one_of(name, tuple(METHODS), "--methods")
    chosen = chosen_names(tasks, TASKS, "--tasks")
    if frozen:
        shortest = min(len(load_episodes(Cell(task, difficulty))) for task in chosen)
        if first + scenes > shortest:
            raise typer.BadParameter(
                f"must, with --first, be at most {shortest}, the length of the frozen lists; got "
                f"{scenes} from {first} on",
                param_hint="--scenes",
            )
        numbers = range(first, first + scenes)
        where = f"the scenes {first} to {first + scenes - 1} of the frozen lists"
    elif first:
        raise typer.BadParameter(f"goes with --frozen alone; got {first}", param_hint="--first")
    else:
        numbers = tuning_seeds(seed, scenes)
        where = f"{scenes} scenes, seeds from {seed} on"
    cells = cells_of(
        chosen,
        difficulty,
        numbers,
        names,
        frozen=frozen,
        references=references,
        executed=executed,
    )
    terms = {"difficulty": difficulty, "methods": names, "frozen": frozen, "executed": executed}
    items = {f"{cell.task} {cell.number} {cell.reference}": cell for cell in cells}
    try:
        found = kept_results(
            out / "scenes.json", terms, measure_scene, items, "scenes", Console(), jobs
        )
    except ResultsError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    rows = [row for of_scene in found.values() for row in of_scene]
    note = (
        f"Mean ± standard deviation over {where}, of difficulty {difficulty}, none left out; one "
        "plan each."
    )
    report(rows, ("task", "method"), COLUMNS, out, "sets", note)
    if "smp" in names and len(names) > 1:
        table = markdown_table(differences_table(differences(rows, "smp", COMPARED)))
        write_text(out / "differences.md", table + "\n")
        tell(f"wrote differences.md to {out}")


if __name__ == "__main__":
    run_command(main)
