"""Checks of an environment at length: bounds of observations, equal episodes, memory.

A check that fails raises AssertionError with what it found.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env as gymnasium_check_env
from numpy.typing import NDArray

import smp_gym
from smp_gym.env import ManipulationEnv
from smp_gym.observation import STATE_LAYOUT
from smp_gym.optional_packages import require
from smp_gym.sampling import sample_scene
from smp_gym.scene import Scene

__all__ = [
    "OTHER_EPISODES",
    "WARM_UP",
    "Bounds",
    "check_bounds",
    "check_interfaces",
    "check_repeats",
    "digests_elsewhere",
    "make",
    "memory_along_resets",
    "play_digest",
]

ROLLOUT_STEPS = 60
"""Steps of an episode that is compared; it goes on past its first collision."""

EPISODE_STEPS = 150
"""Steps of an episode while bounds are checked."""

OTHER_EPISODES = 20
"""Episodes that are played before one that shall come out the same."""

OTHER_SCENES = 2
"""Scenes that these are played in, by turns."""

DIFFICULTY = "hard"
"""Difficulty of all scenes that are played twice: of the hardest, most obstacles are met, and those
of DoubleSidedPlacement are drawn soonest."""

NEW_SCENE_EVERY = 10
"""Resets per newly drawn scene; the others repeat scenes."""

WARM_UP = 1000
"""Resets before memory counts: two worlds are built in them."""


@dataclass(frozen=True)
class Bounds:
    """Extremes that were reached under random actions.

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


def check_interfaces(id: str, difficulty: str = "medium") -> None:
    """Let Gymnasium and stable-baselines3 check an environment; a warning is an error."""
    require("rl", "the check by stable-baselines3")
    from stable_baselines3.common.env_checker import check_env as stable_baselines3_check_env

    env = make(id, difficulty=difficulty)
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
        "import sys\n"
        "from smp_gym.inspection.checking import DIFFICULTY, make, play_digest, sample_scene\n"
        "for id, seed in zip(sys.argv[1::2], sys.argv[2::2]):\n"
        "    env = make(id)\n"
        "    scene = sample_scene(env.task.name, DIFFICULTY, int(seed))\n"
        "    print('digest', play_digest(env, scene)[0])"
    )
    pairs = [argument for id, seed in seeds.items() for argument in (id, str(seed))]
    run = subprocess.run(
        [sys.executable, "-c", code, *pairs],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(smp_gym.__file__).parents[1],
    )
    return [line.split()[1] for line in run.stdout.splitlines() if line.startswith("digest")]


def memory_along_resets(
    env: ManipulationEnv, resets: int, samples: int, new_scene_every: int = NEW_SCENE_EVERY
) -> list[float]:
    """Return the process's memory, MB, at `samples` equal steps of so many resets.

    The first sample is taken after the first reset.

    Args:
        env: the environment that is reset.
        resets: how many.
        samples: of memory.
        new_scene_every: of so many resets, one draws a scene that was not seen before.
    """
    import psutil

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
