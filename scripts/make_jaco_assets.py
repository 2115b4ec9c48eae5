"""Write `envs_assets/jaco`: the URDF, the visual meshes and the link spheres of the JACO j2s6s200.

Everything is made from `envs_assets/jaco_description`: the vendor's kinematic constants and
inertias, a few boxes and cylinders per link that cover the vendor's meshes, and the cross-sections
for the pictures.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.jaco_assets.coverage import coverage_table
from smp_gym.jaco_assets.description import write
from smp_planner.benchmark.options import run_command, tell


def main(
    out: Annotated[Path | None, typer.Option(help="Folder to write into.", file_okay=False)] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(
            help="The vendor's meshes (.dae), to measure coverage against.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
) -> None:
    """Write URDF, visuals and spheres of the arm, and measure them if meshes are given.

    The meshes are in `robots/kinova_description/meshes` of example-robot-data (extra `meshes`).

    Example: python scripts/make_jaco_assets.py --out results/jaco
    """
    folder = out or asset_path("jaco")
    write(folder)
    tell(f"wrote {folder}")
    if meshes is not None:
        Console().print(coverage_table(meshes))


if __name__ == "__main__":
    run_command(main)
