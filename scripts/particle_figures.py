"""Draw Figures 3 to 6 of the paper: particles, two modes executed, and new starts and ends."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer

from smp_planner.benchmark.options import chosen_names, run_command, tell
from smp_planner.experiments.particle_figures import (
    draw_before_and_after,
    draw_two_modes,
    draw_two_sides,
    find_two_modes,
)
from smp_planner.experiments.table_two.scenes import load_scenes

_FIGURES = ("particles", "sides", "modes")
_TWO_MODES = ("Placement", "PushLiftBox")


def main(
    out: Annotated[Path, typer.Option(help="Folder of the files.", file_okay=False)] = Path(
        "results/figures"
    ),
    figures: Annotated[
        str,
        typer.Option(help="Of particles (Fig. 3), sides (4) and modes (5, 6). Default: all."),
    ] = "",
    seeds: Annotated[
        int, typer.Option(min=1, help="Tuning scenes in which two modes are sought.")
    ] = 40,
) -> None:
    """Draw figures, and film what is executed.

    Example: python scripts/particle_figures.py --figures particles,sides
    """
    out.mkdir(parents=True, exist_ok=True)
    chosen = chosen_names(figures, _FIGURES, "--figures")
    if "particles" in chosen:
        draw_before_and_after(tuple(load_scenes().values()), out / "particles.png")
        tell(f"wrote {out / 'particles.png'}")
    if "sides" in chosen:
        names = [out / f"sides_{side}.mp4" for side in ("left", "right")]
        left, right = draw_two_sides(out / "sides.png", (names[0], names[1]))
        tell(f"wrote {out / 'sides.png'}: left {_said(left)}, right {_said(right)}")
    for task in _TWO_MODES if "modes" in chosen else ():
        pair = find_two_modes(task, range(seeds))
        names = [out / f"modes_{task}_{side}.mp4" for side in ("over", "beside")]
        over, beside = draw_two_modes(pair, out / f"modes_{task}.png", (names[0], names[1]))
        tell(
            f"wrote {out / f'modes_{task}.png'}: seed {pair.scene.seed}, the paths "
            f"{pair.distance:.3f} m apart; over {_said(over)}, beside {_said(beside)}"
        )


def _said(success: bool) -> str:
    return "executed with success" if success else "failed"


if __name__ == "__main__":
    run_command(main)
