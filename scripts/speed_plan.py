"""Measure what whole plans take: stages and total, side by side with other planners."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer

from smp_gym.atomic_files import write_text
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.options import chosen_names, one_of, run_command, tell, whole_numbers
from smp_planner.benchmark.plan_speed import (
    Measurement,
    Variant,
    compared,
    growth,
    measure,
    replans,
    stages_table,
)
from smp_planner.planners.ompl_search import ompl_is_installed

_AUTOGRAD = "autograd=smp_planner.benchmark.autograd_planner:AutogradPlanner"
_OMPL = "ompl=smp_planner.planners.ompl_search:OMPLPlanner"


def main(
    tasks: Annotated[str, typer.Option(help="Names, with commas between.")] = (
        "Placement,DoubleSidedPlacement,DrawS,PushLiftBox"
    ),
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=1, help="Scenes of each task.")] = 50,
    first_seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 71_000,
    beside: Annotated[
        Path | None,
        typer.Option(
            help="Folder of another version of the packages to time, too.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
    threads: Annotated[str, typer.Option(help="Numbers of threads, with commas.")] = "1,2",
    busy: Annotated[bool, typer.Option(help="Once more beside a process that computes.")] = True,
    autograd: Annotated[int, typer.Option(min=0, help="Scenes planned by autograd, too.")] = 2,
    ompl: Annotated[int, typer.Option(min=0, help="Scenes planned by OMPL, too.")] = 2,
    anew: Annotated[
        int, typer.Option(min=0, help="Scenes of each task whose rest is planned anew, too.")
    ] = 20,
    grow: Annotated[bool, typer.Option(help="How the time grows with the problem.")] = True,
    out: Annotated[
        Path | None, typer.Option(help="Markdown file for the tables.", dir_okay=False)
    ] = None,
) -> None:
    """Time plans of the same scenes, in turns, and print tables.

    Each version plans in a process of its own, and all take turns scene by scene, so ratios hold on
    a busy machine too. Only seeds below 100000 are for such trials.

    Example: git worktree add ../before COMMIT; python scripts/speed_plan.py --beside ../before
    """
    chosen = chosen_names(tasks, TASKS, "--tasks")
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    counts = whole_numbers(threads, "--threads")
    variants = [Variant(f"{count} threads", count) for count in counts]
    if busy:
        variants.append(Variant(f"{counts[-1]} threads, busy", counts[-1], busy=1))
    reference = variants[0].name
    if beside is not None:
        reference = beside.name
        variants.insert(0, Variant(reference, path=beside))
    slow = []
    if autograd:
        slow.append((autograd, Variant("autograd", settings={"method": _AUTOGRAD})))
    if ompl and ompl_is_installed():
        settings = {"method": _OMPL, "algorithm": "RRTConnect", "particles": 42, "seconds": 5.0}
        slow.append((ompl, Variant("OMPL RRT-Connect", settings=settings)))
    found: list[Measurement] = []
    for task in chosen:
        found += measure(task, difficulty, range(first_seed, first_seed + scenes), variants)
        for count, variant in slow:
            found += measure(task, difficulty, range(first_seed, first_seed + count), [variant])
    tables = [compared(found, reference), stages_table(found)]
    if anew:
        # One more, since the first is left out.
        tables.append(replans(chosen, difficulty, range(first_seed, first_seed + anew + 1)))
    if grow:
        tables.append(growth())
    text = "\n\n".join(markdown_table(table) for table in tables) + "\n"
    tell(text)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, text)


if __name__ == "__main__":
    run_command(main)
