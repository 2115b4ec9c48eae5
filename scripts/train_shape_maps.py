"""Train the shape networks of the default occupancy map and put them where the package finds them.

They are trained once for all scenes, so this needs to run again only if the shapes, the form of the
networks or the truncation distance change.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_planner.benchmark.options import run_command, tell
from smp_planner.occupancy.shape_training import train_shape_networks


def main(
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write (.npz without pickle); by default the packaged one.", dir_okay=False
        ),
    ] = None,
    hidden: Annotated[int, typer.Option(min=1, help="Units in each of the two layers.")] = 16,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of L-BFGS, each on new points.")] = 8,
    samples: Annotated[int, typer.Option(min=1, help="Points in each round.")] = 20_000,
    seed: Annotated[int, typer.Option(min=0, help="Of initial weights and points.")] = 0,
) -> None:
    """Train one network per obstacle shape (box, cylinder, sphere): about two minutes on one core.

    Measure the result with scripts/measure_maps.py.

    Example: python scripts/train_shape_maps.py --hidden 8 --out results/small.npz
    """
    console = Console()

    def report(shape: str, done: int, error: float) -> None:
        console.print(f"{shape:>8}  round {done}/{rounds}  RMS error {1e3 * error:.3f} mm")

    networks = train_shape_networks(hidden, rounds, samples=samples, seed=seed, report=report)
    path = out or asset_path("occupancy", "shape_networks.npz")
    path.parent.mkdir(parents=True, exist_ok=True)
    networks.save(path)
    tell(f"wrote {path}")


if __name__ == "__main__":
    run_command(main)
