"""Make the frozen episode lists of the suites that ship with the package.

Scenes are drawn seed after seed and kept if any of several solvers solves them in the physics; see
`smp_planner.benchmark.certification`.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from smp_gym.scene import EVALUATION_RANGE_START
from smp_gym.suites import SUITES, Cell
from smp_gym.tasks.registry import task_names
from smp_planner.benchmark.certification import make_lists, solvers
from smp_planner.benchmark.options import (
    Interrupted,
    Jobs,
    Names,
    chosen_names,
    progress_bar,
    run_command,
)


def _line(cell: Cell, header: dict[str, Any]) -> str:
    """Return what was drawn, kept and left unknown, and who has solved what, in one line."""
    halves = "; ".join(
        f"{half}: {counts['drawn']} drawn, {counts['kept']} kept, {counts['unknown']} unknown"
        for half, counts in header["halves"].items()
    )
    solved = ", ".join(f"{name} {number}" for name, number in header["solvers"].items() if number)
    return f"{cell.name}: {halves}; solved by {solved}"


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def main(
    out: Annotated[Path, typer.Option(help="Folder of the lists.", file_okay=False)] = Path(
        "envs_assets/benchmark"
    ),
    suites: Names = "",
    tasks: Names = "",
    cells: Names = "",
    episodes: Annotated[int, typer.Option(min=2, help="Episodes of a list, an even number.")] = 100,
    seed: Annotated[
        int, typer.Option(min=0, help="From which on scenes are drawn, in each half.")
    ] = EVALUATION_RANGE_START,
    jobs: Jobs = 1,
) -> None:
    """Make lists and write them to OUT/SUITE/CELL.jsonl.gz.

    Lists that are there are left as they are, so that the same command continues. After each list
    an estimate of the time that the rest takes is printed.

    Example: python scripts/make_benchmark.py --suites tight --tasks Placement --jobs 4
    """
    console = Console(highlight=False, soft_wrap=True)
    try:
        named = chosen_names(tasks, task_names(), "--tasks")
        all_lists = dict.fromkeys(
            cell.unsensed
            for suite in chosen_names(suites, tuple(SUITES), "--suites")
            for cell in SUITES[suite]
            if cell.task in named
        )
        wanted = chosen_names(cells, [cell.name for cell in all_lists], "--cells")
        lists = [cell for cell in all_lists if cell.name in wanted]
        console.print(f"{len(lists)} lists; solvers: reference, {', '.join(solvers())}")
        total = len(lists) * episodes
        with progress_bar("episodes", total, Console(stderr=True)) as (progress, bar):
            made, began = 0, time.monotonic()
            making = make_lists(
                out,
                lists,
                episodes,
                jobs,
                seed=seed,
                on_kept=lambda kept: progress.advance(bar, kept),
            )
            left = len(lists)
            for cell, header, now in making:
                left -= 1
                line = _line(cell, header) if now else f"{cell.name}: is there"
                if now:
                    made += 1
                    each = (time.monotonic() - began) / made
                    line += f"; about {_duration(each * left)} for {left} more lists"
                console.print(line)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    except Interrupted:
        console.print("interrupted; finished lists are kept: the same command continues")
        raise


if __name__ == "__main__":
    run_command(main)
