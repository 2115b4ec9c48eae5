"""The making of frozen episode lists, half of them around witnesses, half certified.

The certified half is placed without a witness: scenes are drawn from seed after seed, and those
stay that RRT-Connect solves, its plan executed with success in the physics.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import FrozenEpisode, write_episodes
from smp_gym.registration import environment_id
from smp_gym.rollout import rollout
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.scene import EVALUATION_SEEDS_START, Scene
from smp_planner.benchmark.worker_pool import workers
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = ["certified_half", "make_lists", "solves"]

METHOD = "rrt_connect"
ATTEMPTS = 3
"""Plans that are made for a scene, each with randomness of its own, before it is given up."""

MOST_PLACED = 10
"""Scenes that are placed at most for each that is required."""

_PACKAGES = ("gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")


def solves(scene: Scene) -> bool:
    """Return whether RRT-Connect solves a scene, judged by the physics."""
    env = gymnasium.make(environment_id(scene.task))
    try:
        for attempt in range(ATTEMPTS):
            policy = PlannerPolicy.make(METHOD, scene.task, seed=attempt)
            if _plays(env, policy, scene):
                return True
    finally:
        env.close()
    return False


def _plays(env: gymnasium.Env[Any, Any], policy: PlannerPolicy, scene: Scene) -> bool:
    observation, _ = env.reset(options={"scene": scene})
    plan = policy.plan(observation)
    return (
        bool(plan.good.any()) and rollout(env, policy.track(plan, plan.chosen), scene=scene).success
    )


def certified_half(
    task: str, difficulty: str, count: int, pool: ProcessPoolExecutor, jobs: int
) -> tuple[list[FrozenEpisode], int]:
    """Return so many certified episodes, and how many scenes were placed to get them.

    Args:
        task: its name.
        difficulty: one of `CROWDED`.
        count: of episodes.
        pool: of worker processes.
        jobs: how many those are.

    Raises:
        RuntimeError: of `MOST_PLACED` times as many scenes, too few were solved.
    """
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


def make_lists(
    out: Path, cells: list[tuple[str, str]], episodes: int, jobs: int
) -> Iterator[tuple[Path, int, int]]:
    """Make and write lists, one after another.

    Args:
        out: folder of the lists, made if there is none.
        cells: task and difficulty of each list; the latter one of `CROWDED`.
        episodes: of each list, an even number.
        jobs: worker processes.

    Yields:
        The file of a list, how many scenes in it are certified, and how many were placed for that.

    Raises:
        ValueError: the number of episodes is odd.
        RuntimeError: as `certified_half`.
    """
    if episodes % 2:
        raise ValueError(f"episodes must be even, got {episodes}")
    out.mkdir(parents=True, exist_ok=True)
    half = episodes // 2
    first = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + half)
    versions = {name: metadata.version(name) for name in _PACKAGES}
    with workers(jobs) as pool:
        for task, difficulty in cells:
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
            yield path, half, placed
