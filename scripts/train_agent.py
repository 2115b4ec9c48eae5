"""Train a reinforcement-learning agent of stable-baselines3 on a task: SAC with hindsight, or PPO.

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
from smp_planner.agents.hyper_parameters import LEARNERS, HyperParameters
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
    agent: Annotated[
        str,
        typer.Option(
            help="Name of its hyper-parameters: sac_her (sparse reward, hindsight), "
            "sac_demonstrations (sparse, shown a planner's episodes), sac_dense, ppo (dense), or "
            "one that the file of --settings has."
        ),
    ] = "sac_her",
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = 300_000,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, exploration, episodes.")] = 0,
    out: AgentFolder = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Hyper-parameters by name; by default envs_assets/agents/learner_settings.json.",
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
    if settings is None:
        one_of(agent, LEARNERS, "--agent")
    folder = out or Path("results") / "agents" / f"{agent}-{task}-{difficulty}-{seed}"
    torch.set_num_threads(threads)
    try:
        training = Training(
            folder,
            agent=agent,
            task=task,
            difficulty=difficulty,
            seed=seed,
            settings=HyperParameters.from_json(
                settings or asset_path("agents", "learner_settings.json"), agent, task
            ),
        )
    except (OSError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
    console = Console(highlight=False)
    if training.steps:
        console.print(f"going on from step {training.steps}")
    try:
        with progress_bar("shown", None, console) as (bar, row):
            training.show(lambda done, total: bar.update(row, completed=done, total=total))
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
            f"{agent}, {task}, {difficulty}, {which}: {result.successes} of {result.episodes} "
            f"evaluation episodes, {result.rate:.1%} ({result.low:.1%}–{result.high:.1%}), after "
            f"{result.steps} steps"
        )
    tell(f"see {folder}")


if __name__ == "__main__":
    run_command(main)
