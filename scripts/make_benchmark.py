"""Make the frozen episode lists that ship with the package.

Half of a list is sampled around witnesses. The other half is placed without one and certified: the
scenes are drawn from seed after seed, and those stay that RRT-Connect solves, its plan executed
with success in the physics.
"""

from __future__ import annotations

import multiprocessing
import platform
from concurrent.futures import ProcessPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import torch
import typer
from rich.console import Console

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import FrozenEpisode, write_episodes
from smp_gym.sampling import SPECIFICATIONS, place_without_witness, sample_scene
from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS, Scene
from smp_planner.benchmark.options import chosen_names
from smp_planner.policy.planner_policy import PlannerPolicy

CROWDED = tuple(name for name in DIFFICULTIES if SPECIFICATIONS[name].obstacles)
"""Difficulties with obstacles: without, there is nothing to place."""

METHOD = "rrt_connect"
ATTEMPTS = 3
"""Plans that are made for a scene, each with randomness of its own, before it is given up."""

MOST_PLACED = 10
"""Scenes that are placed at most for each that is wanted."""

_PACKAGES = ("gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")


def solves(scene: Scene) -> bool:
    """Return whether RRT-Connect solves a scene, judged by the physics."""
    torch.set_num_threads(1)
    env = gymnasium.make(f"smp_gym/{scene.task}-v0")
    try:
        for attempt in range(ATTEMPTS):
            policy = PlannerPolicy.make(METHOD, scene.task, seed=attempt)
            if _plays(env, policy, scene):
                return True
    finally:
        env.close()
    return False


def _plays(env: gymnasium.Env[Any, Any], policy: PlannerPolicy, scene: Scene) -> bool:
    observation, info = env.reset(options={"scene": scene})
    state, over = None, False
    while not over:
        action, state = policy.predict(observation, state, deterministic=True)
        if not state[0].plan.good.any():
            return False
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    return bool(info["is_success"])


def certified_half(
    task: str, difficulty: str, count: int, pool: ProcessPoolExecutor, jobs: int
) -> tuple[list[FrozenEpisode], int]:
    """Return so many certified episodes, and how many scenes were placed to get them."""
    episodes: list[FrozenEpisode] = []
    seed = EVALUATION_SEEDS_START
    while len(episodes) < count:
        if seed >= EVALUATION_SEEDS_START + MOST_PLACED * count:
            raise RuntimeError(
                f"{task}, {difficulty}: only {len(episodes)} of {seed - EVALUATION_SEEDS_START} "
                "scenes were certified"
            )
        batch = range(seed, seed + 4 * jobs)
        scenes = [place_without_witness(task, difficulty, number) for number in batch]
        for number, scene, solved in zip(batch, scenes, pool.map(solves, scenes), strict=True):
            if len(episodes) < count:
                seed = number + 1
                if solved:
                    episodes.append(FrozenEpisode("certified", number, scene))
    return episodes, seed - EVALUATION_SEEDS_START


def main(
    out: Annotated[Path, typer.Option(help="Folder of the lists.")] = Path("envs_assets/benchmark"),
    tasks: Annotated[str, typer.Option(help="Names of tasks, separated by commas.")] = "Placement",
    difficulties: Annotated[
        str, typer.Option(help="Names of difficulties, separated by commas.")
    ] = "easy,medium,hard",
    episodes: Annotated[int, typer.Option(min=2, help="Episodes of a list, an even number.")] = 200,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 1,
) -> None:
    """Make lists and write them to OUT."""
    console = Console()
    chosen_tasks = chosen_names(tasks, TASKS, "--tasks")
    chosen = chosen_names(difficulties, CROWDED, "--difficulties")
    if episodes % 2:
        raise typer.BadParameter(f"episodes must be even, got {episodes}")
    out.mkdir(parents=True, exist_ok=True)
    half = episodes // 2
    versions = {name: metadata.version(name) for name in _PACKAGES}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        for task in chosen_tasks:
            for difficulty in chosen:
                first = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + half)
                witness = [
                    FrozenEpisode("witness", seed, sample_scene(task, difficulty, seed))
                    for seed in first
                ]
                certified, placed = certified_half(task, difficulty, half, pool, jobs)
                header = {
                    "task": task,
                    "difficulty": difficulty,
                    "made": {
                        "witness": f"sample_scene, seeds {first[0]} to {first[-1]}",
                        "certified": f"place_without_witness, seeds from {first[0]} on, solved by "
                        f"{METHOD} in the physics within {ATTEMPTS} plans: {half} of {placed}",
                    },
                    "versions": {"python": platform.python_version(), **versions},
                }
                path = out / f"{task}_{difficulty}.jsonl.gz"
                pairs = zip(witness, certified, strict=True)
                write_episodes(path, header, [episode for pair in pairs for episode in pair])
                console.print(f"{path}: {half} certified of {placed} placed")


if __name__ == "__main__":
    typer.run(main)
