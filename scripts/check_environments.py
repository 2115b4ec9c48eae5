"""Check every environment at length: bounds of observations, equal episodes, memory."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

import smp_gym
from smp_gym.inspection.checking import (
    WARM_UP,
    check_bounds,
    check_interfaces,
    check_repeats,
    digests_elsewhere,
    make,
    memory_along_resets,
)
from smp_planner.benchmark.options import Names, chosen_names, run_command


def main(
    ids: Names = "",
    steps: Annotated[int, typer.Option(min=1, help="Random steps of an id.")] = 5000,
    resets: Annotated[int, typer.Option(min=2 * WARM_UP, help="Resets of an id.")] = 10_000,
) -> None:
    """Check environments and print a table; a check that fails ends the script with its error.

    Example: python scripts/check_environments.py --ids smp_gym/Placement-v0 --steps 500
    """
    console = Console()
    chosen = chosen_names(ids, [entry.id for entry in smp_gym.ENVIRONMENTS], "--ids")
    table = Table(title=f"{steps} random steps, {resets} resets", title_justify="left")
    table.add_column("id", no_wrap=True)
    for name in (
        "collisions",
        "greatest velocity,\n% of its bound",
        f"memory, MB,\nafter {WARM_UP} resets",
        f"after {resets}",
    ):
        table.add_column(name, justify="right")
    for id in track(chosen, console=console, transient=True):
        check_interfaces(id)
        bounds = check_bounds(id, steps)
        seed, digest = check_repeats(id)
        if digests_elsewhere({id: seed}) != [digest]:
            raise AssertionError(f"{id}, seed {seed}, differs in another process")
        env = make(id, difficulty="hard")
        memory = memory_along_resets(env, resets, resets // WARM_UP + 1)
        env.close()
        table.add_row(
            id,
            str(bounds.collisions),
            f"{100.0 * bounds.velocity:.0f}",
            f"{memory[1]:.0f}",
            f"{memory[-1]:.0f}",
        )
    console.print(table)


if __name__ == "__main__":
    run_command(main)
