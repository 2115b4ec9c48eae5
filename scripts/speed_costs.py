"""Measure the run time of the planner's costs, compiled and by autograd."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.cost_speed import cost_table
from smp_planner.benchmark.options import run_command


def main(
    particles: Annotated[int, typer.Option(min=1, help="Trajectories P of a set.")] = 42,
    steps: Annotated[int, typer.Option(min=2, help="Steps T that the planner uses.")] = 50,
    check_steps: Annotated[int, typer.Option(min=2, help="Steps of the exact check.")] = 200,
    obstacles: Annotated[int, typer.Option(min=0, help="Boxes besides the table.")] = 6,
    repeats: Annotated[int, typer.Option(min=1, help="Calls of which to take the median.")] = 30,
    seed: Annotated[int, typer.Option(min=0, help="Of the scene and the trajectories.")] = 0,
) -> None:
    """Time the costs of one particle set on one thread, side by side.

    Each row is one evaluation of value and gradient for all particles, as an iteration of a planner
    needs it. The last row is the exact check of a finished set.

    Example: python scripts/speed_costs.py --particles 100 --steps 50
    """
    table = cost_table(particles, steps, check_steps, obstacles, repeats, seed)
    Console().print(table)


if __name__ == "__main__":
    run_command(main)
