"""Enter runs of `smp-bench run` into the leaderboard that ships with the package."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.leaderboard import EPISODES, LEADERBOARD, add_results
from smp_planner.benchmark.options import run_command


def main(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Folders that `smp-bench run` wrote, finished.", file_okay=False),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder of the leaderboard; made if needed.", file_okay=False)
    ] = Path("envs_assets/results"),
) -> None:
    """Enter the results of whole runs; what an entry held before, of the same scenes, is replaced.

    Example: python scripts/leaderboard.py results/medium
    """
    lines = add_results(folders, out)
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{len(lines)} entries of {sum(line.n for line in lines)} episodes")
    for name in (LEADERBOARD, EPISODES):
        console.print(f"wrote {out / name}", markup=False)


if __name__ == "__main__":
    run_command(main)
