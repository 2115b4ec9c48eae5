"""Checkpoints of trainings of stable-baselines3's agents: all that it takes to go on exactly.

stable-baselines3 pickles: load only what you trust.
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.checkpoints")

import copy
import logging
import random
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import TimeLimit
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from smp_gym.atomic_files import replacing
from smp_gym.env import ManipulationEnv

__all__ = ["load_checkpoint", "save_checkpoint"]

_LOGGER = logging.getLogger(__name__)

_CHECKPOINT = "checkpoint"
_MODEL, _REPLAY_BUFFER = "model.zip", "replay_buffer.pkl"
_MOMENT = "moment_of_checkpoint"


def save_checkpoint(model: BaseAlgorithm, folder: Path) -> None:
    """Write all that a training is; after a kill at any moment, the last checkpoint or this one.

    Args:
        model: between two rollouts, so that nothing is under way but episodes.
        folder: of the training.
    """
    older = _checkpoints(folder)
    setattr(model, _MOMENT, _moment(model))
    try:
        with replacing(folder / f"{_CHECKPOINT}-{max(older, default=0) + 1}") as new:
            new.mkdir()
            model.save(new / _MODEL)
            if isinstance(model, OffPolicyAlgorithm):
                model.save_replay_buffer(new / _REPLAY_BUFFER)
    finally:
        delattr(model, _MOMENT)
    # What a killed process was writing, too.
    for path in (*older.values(), *folder.glob(f".{_CHECKPOINT}-*")):
        shutil.rmtree(path)


def load_checkpoint(
    folder: Path, env: VecEnv, algorithm: type[BaseAlgorithm]
) -> BaseAlgorithm | None:
    """Return the agent of the newest checkpoint, or None if there is none.

    Its episodes, replay buffer and random generators, also those of the process, are as they were.

    Args:
        folder: of the training.
        env: like that in which it was trained.
        algorithm: class of the agent.

    Raises:
        ValueError: the checkpoint is of an older version of the package.
    """
    if (folder / _CHECKPOINT).exists():
        raise ValueError(f"{folder / _CHECKPOINT} is of an older version: train in another folder")
    checkpoints = _checkpoints(folder)
    if not checkpoints:
        return None
    checkpoint = checkpoints[max(checkpoints)]
    model = algorithm.load(checkpoint / _MODEL, env=env, device="cpu", force_reset=False)
    if isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(checkpoint / _REPLAY_BUFFER, truncate_last_traj=False)
    moment = vars(model).pop(_MOMENT)
    env.reset()
    try:
        _restore(moment, _environments(env))
    except RuntimeError as error:
        _LOGGER.warning(f"the training goes on with new episodes: {error}")
        model._last_obs = None
        # Other episodes than those that came first.
        env.seed((model.seed or 0) + model.num_timesteps)
        buffer = getattr(model, "replay_buffer", None)
        if isinstance(buffer, HerReplayBuffer):
            with warnings.catch_warnings():
                # The unfinished episodes are cut: what they lacked is never known.
                warnings.filterwarnings("ignore", message=".*trajectory")
                buffer.truncate_last_trajectory()
    model.action_space.np_random.bit_generator.state = moment["actions"]
    random.setstate(moment["random"])
    np.random.set_state(moment["numpy"])  # noqa: NPY002  (replay buffers draw from it)
    torch.set_rng_state(moment["torch"])
    return model


def _checkpoints(folder: Path) -> dict[int, Path]:
    """Return the checkpoints by their number, the highest being the newest."""
    paths = {path.name.removeprefix(f"{_CHECKPOINT}-"): path for path in folder.glob("*-*")}
    return {int(number): path for number, path in paths.items() if number.isdecimal()}


def _environments(env: VecEnv | None) -> list[gymnasium.Env[Any, Any]]:
    if not isinstance(env, DummyVecEnv):
        raise TypeError(f"env must be a DummyVecEnv, got {type(env).__name__}")
    return env.envs


def _moment(model: BaseAlgorithm) -> dict[str, Any]:
    """Return what an agent's file does not hold: episodes under way and random generators."""
    environments = _environments(model.get_env())
    monitors = [next(x for x in _layers(env) if isinstance(x, Monitor)) for env in environments]
    return {
        "episodes": [_inner(env).save_state() for env in environments],
        "rewards": [list(monitor.rewards) for monitor in monitors],
        "actions": copy.deepcopy(model.action_space.np_random.bit_generator.state),
        "random": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002  (replay buffers draw from it)
        "torch": torch.get_rng_state(),
    }


def _restore(moment: dict[str, Any], environments: list[gymnasium.Env[Any, Any]]) -> None:
    """Bring environments to where they were.

    Raises:
        RuntimeError: the physics leads elsewhere.
    """
    for env, state, rewards in zip(
        environments, moment["episodes"], moment["rewards"], strict=True
    ):
        _inner(env).restore_state(state)
        for layer in _layers(env):
            if isinstance(layer, Monitor):
                layer.rewards = list(rewards)
            elif isinstance(layer, TimeLimit):
                vars(layer)["_elapsed_steps"] = len(state.actions)


def _layers(env: gymnasium.Env[Any, Any]) -> Iterator[gymnasium.Env[Any, Any]]:
    """Yield an environment's wrappers, from the outermost."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env


def _inner(env: gymnasium.Env[Any, Any]) -> ManipulationEnv:
    inner = env.unwrapped
    assert isinstance(inner, ManipulationEnv)
    return inner
