"""Draw sheets of scenes: each task at each difficulty.

One PNG file per task and difficulty, twelve scenes on it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from smp_gym.inspection.sheets import draw_sheet, pictures
from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.options import Names, chosen_names


def main(
    out: Annotated[Path, typer.Option(help="Folder of the sheets.")] = Path("results/scenes"),
    tasks: Names = "",
    difficulties: Names = "",
    scenes: Annotated[int, typer.Option(min=1, max=48, help="On each sheet.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 0,
) -> None:
    """Draw a sheet of scenes for each task and difficulty.

    Example: python scripts/draw_scenes.py --tasks DrawS --difficulties hard --scenes 24
    """
    seeds = range(seed, seed + scenes)
    if seeds.stop > EVALUATION_SEEDS_START > seeds.start:
        raise typer.BadParameter(
            f"seeds must not run across {EVALUATION_SEEDS_START}, where evaluation begins",
            param_hint="--seed",
        )
    cells = [
        (task, difficulty)
        for task in chosen_names(tasks, TASKS, "--tasks")
        for difficulty in chosen_names(difficulties, DIFFICULTIES, "--difficulties")
    ]
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    for task, difficulty in track(cells, description="sheets", console=console):
        sheet = out / f"{task}_{difficulty}.png"
        draw_sheet(sheet, f"{task}, {difficulty}", seeds, pictures(task, difficulty, seeds))
    console.print(f"{len(cells)} sheets in {out}")


if __name__ == "__main__":
    typer.run(main)
