"""Measure how much longer motions take if their jerk is limited."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer

from smp_gym.scene import TASKS
from smp_planner.benchmark.motion_durations import durations_table, motion_durations
from smp_planner.benchmark.options import chosen_names, run_command, tell


def main(
    tasks: Annotated[str, typer.Option(help="Names, with commas between.")] = (
        "Placement,DoubleSidedPlacement,DrawS,PushLiftBox"
    ),
    paths: Annotated[int, typer.Option(min=1, max=1000, help="Of each task.")] = 3,
    acceleration: Annotated[float, typer.Option(help="Limit of all joints, rad/s².")] = 2.0,
    jerk: Annotated[
        list[float] | None,
        typer.Option(
            help="Limit of all joints, rad/s³; may be repeated. Default: 10, 20, 50, 200."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the paths.")] = 0,
) -> None:
    """Time paths drawn from the tasks' primitives, of the JACO arm, and print a table.

    Example: python scripts/motion_durations.py --tasks Placement --paths 2 --jerk 20
    """
    chosen = chosen_names(tasks, TASKS, "--tasks")
    limits = jerk or [10.0, 20.0, 50.0, 200.0]
    found = motion_durations(chosen, paths, acceleration, limits, seed)
    tell(durations_table(found))


if __name__ == "__main__":
    run_command(main)
