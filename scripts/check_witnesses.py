"""Play the witnesses of sampled scenes in the physics: every one has to solve its scene."""

from __future__ import annotations

import functools
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from typing import Annotated, Any

import gymnasium
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.rollout import play
from smp_gym.sampling import sample_with_witness
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import chosen_names
from smp_planner.benchmark.summary import rate_interval


@functools.lru_cache(maxsize=1)
def _env(task: str) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(f"smp_gym/{task}-v0", difficulty="none")


@functools.lru_cache(maxsize=1)
def _grasp(task: str) -> int | None:
    """Return the sample of a trajectory at which the hand closes, None if it holds the object."""
    samples = Demonstrations.load(task).metadata.get("push_samples")
    return None if samples is None else int(samples[1])


def solves(cell: tuple[str, str, int]) -> bool:
    """Return whether the witness of (task, difficulty, seed) succeeds in the physics."""
    task, difficulty, seed = cell
    scene, witness = sample_with_witness(task, difficulty, seed)
    return bool(play(_env(task), scene, witness, grasp=_grasp(task))["is_success"])


def main(
    tasks: Annotated[str, typer.Option(help="Names of tasks, separated by commas.")] = ",".join(
        TASKS
    ),
    difficulties: Annotated[
        str, typer.Option(help="Names of difficulties, separated by commas.")
    ] = ",".join(DIFFICULTIES),
    episodes: Annotated[int, typer.Option(min=1, help="Scenes of a task and difficulty.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
) -> None:
    """Play witnesses; the exit status is 1 if one fails."""
    groups = [
        (task, difficulty)
        for task in chosen_names(tasks, TASKS, "--tasks")
        for difficulty in chosen_names(difficulties, DIFFICULTIES, "--difficulties")
    ]
    seeds = range(seed, seed + episodes)
    cells = [(task, difficulty, number) for task, difficulty in groups for number in seeds]
    console = Console()
    failed: list[tuple[str, str, int]] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool, Progress(console=console) as bar:
        running = bar.add_task("witnesses", total=len(cells))
        for cell, solved in zip(cells, pool.map(solves, cells, chunksize=5), strict=True):
            bar.advance(running)
            if not solved:
                failed.append(cell)
    table = Table("task", "difficulty", "successes", "95 % interval", "seeds that fail")
    for task, difficulty in groups:
        bad = [number for *group, number in failed if tuple(group) == (task, difficulty)]
        rate = rate_interval(episodes - len(bad), episodes)
        table.add_row(
            task,
            difficulty,
            f"{episodes - len(bad)} of {episodes}",
            f"{rate['low']:.1%} to {rate['high']:.1%}",
            ", ".join(map(str, bad)),
        )
    console.print(table)
    if failed:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
