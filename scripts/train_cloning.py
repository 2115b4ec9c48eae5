"""Train an agent that imitates what a planner's policy does, from episodes of it."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.agents.cloning import CLONES, Cloning, CloningSettings
from smp_planner.benchmark.options import (
    AgentFolder,
    Interrupted,
    chosen_names,
    one_of,
    progress_bar,
    run_command,
    tell,
)


def main(
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "Placement",
    difficulty: Annotated[
        str, typer.Option(help="Of the scenes; of several, separated by commas, in turn.")
    ] = "none,easy",
    agent: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(CLONES)}; the latter sees how the policy recovers, too."
        ),
    ] = "distilled",
    seed: Annotated[int, typer.Option(min=0, max=5, help="Of scenes, weights, batches.")] = 0,
    out: AgentFolder = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Settings; by default the agents' in envs_assets/agents/.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
) -> None:
    """Watch smp, learn from what it does; the same command goes on after an interruption.

    An episode takes about two seconds of one core, and all is learned in a few minutes.

    Example: python scripts/train_cloning.py --task Placement --agent distilled --seed 0
    """
    one_of(task, TASKS, "--task")
    one_of(agent, CLONES, "--agent")
    names = chosen_names(difficulty, DIFFICULTIES, "--difficulty")
    folder = out or Path("results") / "agents" / f"{agent}-{task}-{'-'.join(names)}-{seed}"
    try:
        training = Cloning(
            folder,
            agent=agent,
            task=task,
            difficulties=names,
            seed=seed,
            settings=CloningSettings.from_json(
                settings or asset_path("agents", "cloning_settings.json"), agent
            ),
        )
    except (OSError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
    console = Console(highlight=False)
    try:
        with progress_bar("episodes", None, console) as (bar, row):
            training.watch(lambda done, total: bar.update(row, completed=done, total=total))
        with progress_bar("error", training.epochs, console) as (bar, row):

            def progress(done: int, error: float) -> None:
                bar.update(row, completed=done, description=f"error {error:.4f}")

            training.fit(progress)
    except Interrupted:
        console.print("interrupted; the same command goes on from what is there")
        raise
    finally:
        training.close()
    best = min(training.curve, key=lambda point: point[2])
    tell(
        f"{agent}, {task}: {training.failed} of {training.episodes} episodes failed and were left "
        f"out; mean squared error of an action {best[2]:.4f} after {best[0]} epochs; see {folder}"
    )


if __name__ == "__main__":
    run_command(main)
