"""Make the frozen episode lists that ship with the package.

Half of a list is sampled around witnesses, the other half is certified by RRT-Connect: see
`smp_planner.benchmark.certification`.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.sampling import CROWDED
from smp_gym.scene import TASKS
from smp_planner.benchmark.certification import make_lists
from smp_planner.benchmark.options import Jobs, chosen_names


def main(
    out: Annotated[Path, typer.Option(help="Folder of the lists.")] = Path("envs_assets/benchmark"),
    tasks: Annotated[str, typer.Option(help="Separated by commas.")] = "Placement",
    difficulties: Annotated[str, typer.Option(help="Separated by commas.")] = "easy,medium,hard",
    episodes: Annotated[int, typer.Option(min=2, help="Episodes of a list, an even number.")] = 200,
    jobs: Jobs = 1,
) -> None:
    """Make lists and write them to OUT.

    Example: python scripts/make_benchmark.py --tasks DrawS --difficulties hard --jobs 4
    """
    cells = list(
        product(
            chosen_names(tasks, TASKS, "--tasks"),
            chosen_names(difficulties, CROWDED, "--difficulties"),
        )
    )
    if episodes % 2:
        raise typer.BadParameter(f"episodes must be even, got {episodes}")
    for path, certified, placed in make_lists(out, cells, episodes, jobs):
        Console().print(f"{path}: {certified} certified of {placed} placed")


if __name__ == "__main__":
    typer.run(main)
