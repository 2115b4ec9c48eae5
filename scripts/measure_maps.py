"""Measure how exact the occupancy maps are and how long they take, on one thread."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import torch
import typer
from rich.console import Console

from smp_planner.benchmark.map_comparison import compare_maps, map_table
from smp_planner.benchmark.options import run_command


def main(
    scenes: Annotated[int, typer.Option(min=1, help="Random scenes to measure on.")] = 10,
    obstacles: Annotated[int, typer.Option(min=0, help="Obstacles beside table and bin.")] = 4,
    spacing: Annotated[
        list[float] | None,
        typer.Option(min=1e-3, help="Spacing of the grids, m; repeat for more than one."),
    ] = None,
    trained: Annotated[
        bool, typer.Option(help="Also train a map from points in each scene (8 s each).")
    ] = True,
    seed: Annotated[int, typer.Option(min=0, help="Of scenes and query points.")] = 0,
) -> None:
    """Print a table of every map's accuracy and time, on one thread.

    Scenes are random boxes, cylinders and spheres with half-extents of 3 to 6 cm above the table,
    beside a bin. Points are drawn around them; the table's own surface, the easiest, is left out.
    "Error" is that of the signed distance within 3 cm of a surface: 95th percentile of its absolute
    value, and 1st and 99th with sign (positive: the map sees more room than there is). A point
    counts as occupied where the distance is negative. "Time" is that of making the map of a scene;
    for the networks evaluated at the points themselves, of some 150 000 points.

    Example: python scripts/measure_maps.py --scenes 3 --spacing 0.02 --no-trained
    """
    torch.set_num_threads(1)
    records = compare_maps(scenes, obstacles, spacing or [0.02, 0.015, 0.01], trained, seed)
    title = f"{scenes} scenes of {obstacles} obstacles, table and bin"
    Console(width=110).print(map_table(records, title))


if __name__ == "__main__":
    run_command(main)
