"""Train a reinforcement-learning agent on a task: stable-baselines3's SAC, as a rule with HER.

`smp_planner.agents.training` says what the folder holds that is written.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script("rl")

from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.agents.hyper_parameters import HyperParameters
from smp_planner.agents.training import Training
from smp_planner.benchmark.options import (
    AgentFolder,
    Interrupted,
    one_of,
    progress_bar,
    run_command,
    tell,
)


def main(
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "Placement",
    difficulty: Annotated[str, typer.Option(help=f"One of {', '.join(DIFFICULTIES)}.")] = "none",
    dense: Annotated[bool, typer.Option(help="Train on the dense reward.")] = False,
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = 300_000,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, exploration, episodes.")] = 0,
    out: AgentFolder = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Hyper-parameters; by default the task's in envs_assets/agents/.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Steps between evaluations.")] = 10_000,
    episodes: Annotated[int, typer.Option(min=1, help="Of each evaluation.")] = 50,
    final_episodes: Annotated[int, typer.Option(min=1, help="Of the last one.")] = 200,
    threads: Annotated[int, typer.Option(min=1, max=2, help="Of PyTorch.")] = 1,
) -> None:
    """Train an agent; the same command goes on after an interruption.

    Example: python scripts/train_agent.py --task Placement --difficulty none --steps 150000
    """
    one_of(task, TASKS, "--task")
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    name = f"{task}{'Dense' if dense else ''}"
    folder = out or Path("results") / "agents" / f"{name}-{difficulty}-{seed}"
    torch.set_num_threads(threads)
    try:
        training = Training(
            folder,
            task=task,
            difficulty=difficulty,
            dense=dense,
            seed=seed,
            settings=HyperParameters.from_json(settings or asset_path("agents", f"{name}.json")),
        )
    except (OSError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
    console = Console(highlight=False)
    if training.steps:
        console.print(f"going on from step {training.steps}")
    try:
        with progress_bar("success", steps, console) as (bar, row):

            def progress(done: int, rate: float) -> None:
                bar.update(row, completed=done, description=f"success {rate:4.0%}")

            training.run(steps, every=every, episodes=episodes, progress=progress)
        final, best = training.finish(final_episodes)
    except Interrupted:
        console.print("interrupted; the same command goes on from the last checkpoint")
        raise
    finally:
        training.close()
    for which, result in (("at the end", final), ("best", best)):
        console.print(
            f"{name}, {difficulty}, {which}: {result.successes} of {result.episodes} evaluation "
            f"episodes, {result.rate:.1%} ({result.low:.1%}–{result.high:.1%}), after "
            f"{result.steps} steps"
        )
    tell(f"see {folder}")


if __name__ == "__main__":
    run_command(main)
