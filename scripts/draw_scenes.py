"""Draw sheets of scenes: each cell of a suite.

One PNG file for each cell (task, family and difficulty), twelve scenes on it.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from smp_gym.inspection.sheets import draw_sheet, pictures
from smp_gym.scene import EVALUATION_SEEDS_START, TASKS
from smp_gym.suites import SUITES, suite_cells
from smp_planner.benchmark.options import Names, chosen_names, run_command, split_names, tell


def main(
    out: Annotated[Path, typer.Option(help="Folder of the sheets.", file_okay=False)] = Path(
        "results/scenes"
    ),
    suite: Annotated[str, typer.Option(help=f"One of {', '.join(SUITES)}.")] = "standard",
    tasks: Names = "",
    cells: Names = "",
    scenes: Annotated[int, typer.Option(min=1, max=48, help="On each sheet.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 0,
) -> None:
    """Draw a sheet of scenes for each cell of a suite, or for some by task or name.

    Example: python scripts/draw_scenes.py --suite tight --cells Placement_cage_hard --scenes 24
    """
    seeds = range(seed, seed + scenes)
    if seeds.stop > EVALUATION_SEEDS_START > seeds.start:
        raise typer.BadParameter(
            f"seeds must not run across {EVALUATION_SEEDS_START}, where evaluation begins",
            param_hint="--seed",
        )
    try:
        chosen = suite_cells(suite, chosen_names(tasks, TASKS, "--tasks"), split_names(cells))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    for cell in track(chosen, description="sheets", console=console):
        draw_sheet(out / f"{cell.name}.png", cell.name, seeds, pictures(cell, seeds))
    tell(f"{len(chosen)} sheets in {out}")


if __name__ == "__main__":
    run_command(main)
