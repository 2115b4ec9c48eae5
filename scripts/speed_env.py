"""Measure the speed of the environments: steps and resets a second, in one and in more processes.

Beside them stands `PandaPickAndPlace-v3` of panda-gym, if that is installed (``pip install
smp-gym[panda]``). Actions are random; steps a second leave out the resets in between.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import os
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from smp_gym.inspection.speed import known_ids, together
from smp_planner.benchmark.options import Names, chosen_names, run_command, whole_numbers


def main(
    ids: Names = "",
    processes: Annotated[str, typer.Option(help="Numbers of processes.")] = "1,2,4",
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of each measurement.")] = 3.0,
) -> None:
    """Measure and print a table.

    Example: python scripts/speed_env.py --ids smp_gym/Placement-v0 --processes 1,2
    """
    console = Console()
    chosen = chosen_names(ids, known_ids(), "--ids")
    numbers = whole_numbers(processes, "--processes")
    title = f"all processes together, on {os.cpu_count()} cores"
    result = Table(title=title, title_justify="left")
    result.add_column("id", no_wrap=True)
    for name in ("processes", "steps/s", "resets/s,\nscene given", "resets/s,\nscene drawn"):
        result.add_column(name, justify="right")
    for id in chosen:
        for number in numbers:
            with console.status(f"{id}, {number} processes"):
                speed = together(id, number, seconds)
            cells = [f"{rate:.0f}" for rate in (speed.steps, speed.replays, speed.draws)]
            result.add_row(id, str(number), *cells)
        result.add_section()
    console.print(result)


if __name__ == "__main__":
    run_command(main)
