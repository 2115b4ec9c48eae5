"""Check every environment at length: bounds of observations, equal episodes, memory.

The tests call the same checks with fewer steps, episodes and resets, to stay quick.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import psutil
import typer
from gymnasium.utils.env_checker import check_env as gymnasium_check_env
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from stable_baselines3.common.env_checker import check_env as stable_baselines3_check_env

import smp_gym
from smp_gym.env import ManipulationEnv
from smp_gym.observation import STATE_LAYOUT
from smp_gym.sampling import sample_scene
from smp_gym.scene import Scene
from smp_planner.benchmark.options import chosen_names

ROLLOUT_STEPS = 60
"""Steps of an episode that is compared; it goes on past its first collision."""

EPISODE_STEPS = 150
"""Steps of an episode while bounds are checked."""

OTHER_EPISODES = 20
"""Episodes that are played before one that shall come out the same."""

OTHER_SCENES = 2
"""Scenes that these are played in, by turns."""

DIFFICULTY = "easy"
"""Of all of them."""

NEW_SCENE_EVERY = 10
"""Of so many resets, one draws a scene that was not seen before."""

WARM_UP = 1000
"""Resets before memory counts: two worlds are built in them."""


@dataclass(frozen=True)
class Bounds:
    """What came of random steps.

    Attributes:
        collisions: episodes that collided.
        velocity: greatest share of its bound that a velocity reached.
    """

    collisions: int
    velocity: float


def make(id: str, **arguments: Any) -> ManipulationEnv:
    """Return an environment by its id, without wrappers."""
    env = gymnasium.make(id, **arguments).unwrapped
    assert isinstance(env, ManipulationEnv)
    return env


def check_interfaces(id: str) -> None:
    """Let Gymnasium and stable-baselines3 check an environment; a warning is an error."""
    env = make(id)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The checker makes the environment again in every render mode but "human".
        gymnasium_check_env(env, skip_render_check=True)
        stable_baselines3_check_env(env)
    env.close()


def _velocity_share(observation: dict[str, NDArray[np.float32]]) -> float:
    shares, start = [0.0], 0
    for field in STATE_LAYOUT:
        values = observation["observation"][start : start + field.size]
        start += field.size
        if field.name.endswith("velocity"):
            shares.append(float(np.abs(values).max()) / field.high)
    return max(shares)


def check_bounds(id: str, steps: int, difficulty: str = "hard") -> Bounds:
    """Play random actions and assert that every observation lies in its space.

    Actions are kept for ten steps, every other time extreme ones, so that the arm gets somewhere.
    Episodes go on past their collisions: there velocities are greatest.
    """
    env = make(id, difficulty=difficulty)
    rng = np.random.default_rng(0)
    collisions, velocity = 0, 0.0
    for step in range(steps):
        if step % EPISODE_STEPS == 0:
            observation, info = env.reset(seed=step // EPISODE_STEPS)
        else:
            if step % 10 == 1:
                action = rng.uniform(-1.0, 1.0, 7).astype(np.float32)
                action = np.sign(action) if step % 20 == 1 else action
            collided = info["collided"]
            observation, reward, terminated, truncated, info = env.step(action)
            collisions += info["collided"] and not collided
            assert type(reward) is float, reward
            assert np.isfinite(reward), reward
            assert type(terminated) is bool, terminated
            assert truncated is False
            assert type(info["is_success"]) is bool, info
        for key, vector in observation.items():
            space = env.observation_space[key]  # type: ignore[index]
            assert vector.dtype == space.dtype, (key, vector.dtype)
            assert space.contains(vector), (key, vector)
        velocity = max(velocity, _velocity_share(observation))
    env.close()
    assert velocity < 1.0, f"velocities of {id} reach their bounds: they may have been cut"
    return Bounds(collisions, velocity)


def play_digest(env: ManipulationEnv, scene: Scene, steps: int = ROLLOUT_STEPS) -> tuple[str, bool]:
    """Play a scene so that the arm moves, drops the object and runs into things.

    Returns:
        A digest of all bits that it gave, and whether it collided.
    """
    rng = np.random.default_rng(scene.seed)
    observation, info = env.reset(options={"scene": scene})
    digest = hashlib.sha256()
    for step in range(steps):
        if step % 20 == 0:
            action = rng.uniform(-0.9, 0.9, 7).astype(np.float32)
            action[6] = 1.0 if step < steps / 2 else -1.0
        for key in sorted(observation):
            digest.update(observation[key].tobytes())
        # On past collisions: what they leave behind must not reach the next episode.
        observation, reward, _, _, info = env.step(action)
        digest.update(np.array([reward, info["clearance"]]).tobytes())
    return digest.hexdigest(), bool(info["collided"])


def check_repeats(
    id: str, others: int = OTHER_EPISODES, other_steps: int = EPISODE_STEPS
) -> tuple[int, str]:
    """Assert that an episode with contacts is the same, bit for bit, whatever was played before.

    Returns:
        The episode's seed, the first that makes contacts, and its digest.
    """
    seed = -1
    collided = False
    while not collided:
        seed += 1
        fresh = make(id)
        scene = sample_scene(fresh.task.name, DIFFICULTY, seed)
        digest, collided = play_digest(fresh, scene)
        fresh.close()
    count = min(others, OTHER_SCENES)
    scenes = [sample_scene(scene.task, DIFFICULTY, seed + k + 1) for k in range(count)]
    used = make(id)
    for other in range(others):
        play_digest(used, scenes[other % count], other_steps)
    again, _ = play_digest(used, scene)
    used.close()
    assert again == digest, f"{id}, seed {seed}, differs after {others} other episodes"
    return seed, digest


def digests_elsewhere(seeds: Mapping[str, int]) -> list[str]:
    """Return the digests of an episode of each id, played in another process."""
    code = (
        "import runpy, sys\n"
        "script = runpy.run_path(sys.argv[1])\n"
        "for id, seed in zip(sys.argv[2::2], sys.argv[3::2]):\n"
        "    env = script['make'](id)\n"
        "    scene = script['sample_scene'](env.task.name, script['DIFFICULTY'], int(seed))\n"
        "    print('digest', script['play_digest'](env, scene)[0])"
    )
    pairs = [argument for id, seed in seeds.items() for argument in (id, str(seed))]
    run = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).resolve()), *pairs],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[1],
    )
    return [line.split()[1] for line in run.stdout.splitlines() if line.startswith("digest")]


def memory_along_resets(
    env: ManipulationEnv, resets: int, samples: int, new_scene_every: int = NEW_SCENE_EVERY
) -> list[float]:
    """Return the process's memory, MB, at `samples` equal steps of so many resets.

    The first sample is taken after the first reset.
    """
    process = psutil.Process()
    scenes: list[Scene] = []
    memory: list[float] = []
    at = set(np.linspace(0, resets, samples, dtype=int).tolist())
    for number in range(resets + 1):
        if number % new_scene_every == 0:
            env.reset(seed=number)
            scenes = [*scenes[-9:], env.scene]
        else:
            env.reset(options={"scene": scenes[number % len(scenes)]})
        if number in at:
            memory.append(process.memory_info().rss / 1e6)
    return memory


def main(
    ids: Annotated[str, typer.Option(help="Ids, separated by commas. Default: all.")] = "",
    steps: Annotated[int, typer.Option(min=1, help="Random steps of an id.")] = 5000,
    resets: Annotated[int, typer.Option(min=2 * WARM_UP, help="Resets of an id.")] = 10_000,
) -> None:
    """Check environments and print a table; a check that fails ends the script with its error."""
    console = Console()
    chosen = chosen_names(ids, [entry.id for entry in smp_gym.ENVIRONMENTS], "--ids")
    table = Table(title=f"{steps} random steps, {resets} resets", title_justify="left")
    table.add_column("id", no_wrap=True)
    for name in (
        "collisions",
        "greatest velocity,\n% of its bound",
        f"memory, MB,\nafter {WARM_UP} resets",
        f"after {resets}",
    ):
        table.add_column(name, justify="right")
    for id in track(chosen, console=console, transient=True):
        check_interfaces(id)
        bounds = check_bounds(id, steps)
        seed, digest = check_repeats(id)
        assert digests_elsewhere({id: seed}) == [digest], f"{id} differs in another process"
        env = make(id, difficulty="hard")
        memory = memory_along_resets(env, resets, resets // WARM_UP + 1)
        env.close()
        table.add_row(
            id,
            str(bounds.collisions),
            f"{100.0 * bounds.velocity:.0f}",
            f"{memory[1]:.0f}",
            f"{memory[-1]:.0f}",
        )
    console.print(table)


if __name__ == "__main__":
    typer.run(main)
