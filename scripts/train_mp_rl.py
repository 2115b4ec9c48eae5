"""Train `mp_rl`, `mp_rl_physics` or the control `detour`: policy search over a movement primitive.

`smp_planner.agents.bump_training` says how, and what the folder holds that is written.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import dataclasses
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.assets import asset_path
from smp_gym.sampling import CROWDED
from smp_gym.scene import TASKS
from smp_planner.agents.bump_training import BumpSettings, BumpTraining
from smp_planner.benchmark.options import (
    AgentFolder,
    Interrupted,
    chosen_names,
    one_of,
    progress_bar,
    run_command,
    tell,
)
from smp_planner.planners.bump_planner import LEARNED

_ITERATIONS = 600
"""Batches of a training whose learning rate stays as it is, if nothing else is said."""

_REPORTED = {"check": (20, "clear"), "physics": (5, "successful")}
"""By reward: iterations from one checkpoint to the next, and what good trajectories are called. An
iteration takes a third of a second with the check, and ten seconds or more with the physics."""


def main(
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "Placement",
    difficulty: Annotated[
        str, typer.Option(help="Of the training scenes; of several, separated by commas, in turn.")
    ] = "medium",
    agent: Annotated[str, typer.Option(help=f"One of {', '.join(LEARNED)}.")] = "mp_rl",
    seed: Annotated[int, typer.Option(min=0, max=5, help="Of scenes, weights, actions.")] = 0,
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Batches in all; by default those in which the learning rate falls, or 600.",
        ),
    ] = None,
    out: AgentFolder = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Settings; by default the agent's in envs_assets/agents/.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
) -> None:
    """Train an agent; the same command goes on after an interruption.

    Example: python scripts/train_mp_rl.py --task Placement --difficulty medium --seed 0
    """
    one_of(task, TASKS, "--task")
    one_of(agent, LEARNED, "--agent")
    names = chosen_names(difficulty, CROWDED, "--difficulty")
    folder = out or Path("results") / "agents" / f"{agent}-{task}-{'-'.join(names)}-{seed}"
    try:
        chosen = BumpSettings.from_json(
            settings or asset_path("agents", "bump_settings.json"), agent, task
        )
        training = BumpTraining(
            folder,
            agent=agent,
            task=task,
            difficulties=names,
            seed=seed,
            settings=chosen,
        )
    except (OSError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
    console = Console(highlight=False)
    if training.iteration:
        console.print(f"going on from iteration {training.iteration}")
    wanted = iterations or chosen.annealing or _ITERATIONS
    try:
        with progress_bar("scenes", None, console) as (bar, row):
            training.prepare(lambda done, total: bar.update(row, completed=done, total=total))
        every, good = _REPORTED[chosen.reward]
        with progress_bar(good, wanted, console) as (bar, row):

            def progress(done: int, share: float) -> None:
                bar.update(row, completed=done, description=f"{good} {share:4.0%}")

            training.run(wanted, every=every, progress=progress)
    except Interrupted:
        console.print("interrupted; the same command goes on from the last checkpoint")
        raise
    last = dataclasses.asdict(training.curve[-1])
    tell(
        f"{agent}, {task}: {last['clear']:.1%} of the last trajectories, in "
        f"{last['scenes_solved']:.1%} of their scenes, are {good} after {training.trajectories} "
        f"trajectories and {training.cpu_seconds:.0f} CPU seconds; see {folder}"
    )


if __name__ == "__main__":
    run_command(main)
