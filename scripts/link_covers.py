"""Measure the covers of the links of public arms."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.options import chosen_names, run_command
from smp_planner.experiments.link_covers import covers_table, link_covers
from smp_planner.experiments.public_arms import PUBLIC_ARMS


def main(
    arms: Annotated[str, typer.Option(help="Names, with commas between.")] = "kuka_iiwa,panda,ur5",
    bound: Annotated[
        list[float] | None,
        typer.Option(min=1e-3, max=1.0, help="m; may be repeated. Default: 0.02."),
    ] = None,
    plan: Annotated[bool, typer.Option(help="Time a plan with each, too.")] = True,
) -> None:
    """Cover the meshes by cells and by spheres of bounded overshoot, and print a table.

    Those of panda and ur5 come with the extra `meshes`. Times are of the processor.

    Example: python scripts/link_covers.py --arms kuka_iiwa --bound 0.02 --bound 0.03 --no-plan
    """
    found = []
    for arm in chosen_names(arms, tuple(PUBLIC_ARMS), "--arms"):
        found += link_covers(arm, bound or [0.02], plan)
    Console(width=100).print(covers_table(found))


if __name__ == "__main__":
    run_command(main)
