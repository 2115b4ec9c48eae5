"""Export demonstrations as data sets of Minari; needs the extra ``minari``."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.datasets.minari_export import dataset_path, export_demonstrations
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import progress_bar, run_command, tell
from smp_planner.policy.tracking import Track, gripper_event


def tracks(demonstrations: Demonstrations) -> list[Track]:
    """Return tracks that execute each demonstration as it was given, its own gripper included."""
    return [
        Track(configurations, float(duration), gripper_event(gripper[None]))
        for configurations, duration, gripper in zip(
            demonstrations.configurations,
            demonstrations.durations,
            demonstrations.gripper,
            strict=True,
        )
    ]


def main(
    task: Annotated[
        str, typer.Option(help=f"One of {', '.join(TASKS)}, or a file of demonstrations.")
    ] = TASKS[0],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Root of the data sets; default MINARI_DATASETS_PATH or ~/.minari.",
            file_okay=False,
        ),
    ] = None,
    dataset_id: Annotated[
        str | None, typer.Option(help="Default smp_gym/TASK/demonstrations-v1.")
    ] = None,
    difficulty: Annotated[
        str,
        typer.Option(
            help=f"Of the environment that the data set brings: {', '.join(DIFFICULTIES)}."
        ),
    ] = "medium",
    overwrite: Annotated[bool, typer.Option(help="Replace a data set of the same id.")] = False,
) -> None:
    """Play the demonstrations of a task and write them; refuse unless all of them succeed.

    Example: python scripts/export_minari.py --task DrawS --out results/minari
    """
    console = Console()
    if out is not None:
        os.environ["MINARI_DATASETS_PATH"] = str(out)
    try:
        demonstrations = Demonstrations.load(task)
        count = len(demonstrations)
        with progress_bar(demonstrations.task, count, console, transient=True) as (bar, playing):
            dataset = export_demonstrations(
                demonstrations,
                tracks(demonstrations),
                dataset_id,
                difficulty=difficulty,
                overwrite=overwrite,
                finished=lambda _: bar.advance(playing),
            )
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        tell(f"nothing written: {error}")
        raise typer.Exit(1) from error
    tell(
        f"wrote {dataset.id}: {dataset.total_episodes} episodes, {dataset.total_steps} steps, "
        f"in {dataset_path(dataset.id)}"
    )


if __name__ == "__main__":
    run_command(main)
