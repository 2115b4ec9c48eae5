"""Learn the blind detours that the samplers of the placing tasks keep blocked.

Each round learns the fixed detour that gets through most of the present scenes and adds it to
`envs_assets/sampling/blind_detours.json`; the next round's scenes block it.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from typing import Annotated

import typer
from rich.console import Console

from smp_gym.scene import DIFFICULTIES
from smp_planner.benchmark.options import one_of, run_command, tuning_seeds
from smp_planner.experiments.controls.blind_detours import BLOCKED_TASKS, add_blind_detour
from smp_planner.experiments.controls.detour import SearchSettings


def main(
    task: Annotated[str, typer.Option(help=f"One of {', '.join(BLOCKED_TASKS)}.")],
    rounds: Annotated[str, typer.Option(help="Separated by commas.")] = "hard,hard,medium,easy",
    scenes: Annotated[int, typer.Option(min=4, help="Scenes of each round.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene; below 80000.")] = 20000,
    generations: Annotated[int, typer.Option(min=1, help="Of each restart.")] = 20,
    restarts: Annotated[int, typer.Option(min=1, help="Of the search for a detour.")] = 1,
) -> None:
    """Add one detour for each of ROUNDS, a list of difficulties.

    Example: python scripts/learn_blind_detours.py --task Placement --rounds hard,hard,medium
    """
    one_of(task, BLOCKED_TASKS, "--task")
    names = [one_of(name, DIFFICULTIES, "--rounds") for name in rounds.split(",")]
    seeds = tuning_seeds(seed, scenes * len(names))
    settings = SearchSettings(generations=generations, restarts=restarts)
    for number, difficulty in enumerate(names):
        drawn = seeds[number * scenes : (number + 1) * scenes]
        learned = add_blind_detour(task, difficulty, drawn, settings)
        Console().print(
            f"round {number + 1} of {len(names)}, {difficulty}: the detour gets through "
            f"{learned.validated:.0%} of the scenes kept for validation"
        )


if __name__ == "__main__":
    run_command(main)
