"""Record the demonstrations that ship with the package: a scripted demonstrator in the physics.

What the demonstrator of each task does stands in `smp_gym.tasks`. It is executed in the
environment, and recorded from what the arm does there. Nothing is written unless every
demonstration ends in success.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.tasks import task_definition, task_names
from smp_planner.benchmark.options import run_command, tell


def main(
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write; default envs_assets/demonstrations/TASK.npz.", dir_okay=False
        ),
    ] = None,
    task: Annotated[str, typer.Option(help=f"One of {', '.join(task_names())}.")] = "Placement",
) -> None:
    """Record the demonstrations of a task; refuse to write unless all of them succeed."""
    console = Console()
    out = out or Path(f"envs_assets/demonstrations/{task}.npz")
    try:
        demonstrations = task_definition(task).demonstrate(console.print)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    except RuntimeError as error:
        tell(f"nothing written: {error}")
        raise typer.Exit(1) from error
    out.parent.mkdir(parents=True, exist_ok=True)
    demonstrations.save(out)
    tell(f"wrote {out}")


if __name__ == "__main__":
    run_command(main)
