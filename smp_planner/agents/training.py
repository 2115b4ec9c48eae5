"""Training of stable-baselines3's SAC, as a rule with hindsight experience replay (HER).

The folder that a training writes holds

- ``run.json``: task, difficulty, seed and hyper-parameters;
- ``evaluations.csv``: success on the same tuning episodes again and again, with Wilson intervals;
- ``learning_curve.png``: that as a figure;
- ``agent.zip``: the agent that did best on the tuning episodes, for `SAC.load`, or as a method of
  the benchmark; its attribute ``action_repeat`` says how many environment steps a decision lasts;
- ``final.zip``: the agent at the end;
- ``result.json``: how both do on episodes that neither training nor the choice has seen;
- ``checkpoint-1/`` and so on: what it takes to go on after an interruption, or with more steps;
  large, the newest alone is kept. stable-baselines3 pickles: go on only in folders of your own.

A training that goes on from a checkpoint does what it would have done without the interruption, to
the last bit, on the same machine with the same packages and number of threads: the checkpoint holds
the episodes that are under way and the state of all random generators. Only the records of returns
and the times in the logs of stable-baselines3 start anew. Where the physics does not come to the
same states again, as may be on another machine, the training goes on with new episodes, and a
warning says so. A learning rate that changes does so over the steps that are asked for.
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.training")

import copy
import json
import logging
import random
import shutil
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import FilterObservation, TimeLimit
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import VectorizedActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.atomic_files import replacing, write_text
from smp_gym.env import ManipulationEnv
from smp_gym.folder_lock import FolderLock
from smp_gym.registration import environment_id
from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.agents.decisions import ACTION_REPEAT, CPU_SECONDS, ActionRepeat
from smp_planner.agents.evaluations import (
    Evaluation,
    draw_curve,
    evaluate,
    read_evaluations,
    write_evaluations,
)
from smp_planner.agents.exploration import GripperOpenings
from smp_planner.agents.goal_features import GoalFeatures
from smp_planner.agents.hyper_parameters import HyperParameters

__all__ = ["Training", "load_checkpoint", "make_model", "save_checkpoint"]

_LOGGER = logging.getLogger(__name__)

_CHECKPOINT = "checkpoint"
_MODEL, _REPLAY_BUFFER = "model.zip", "replay_buffer.pkl"
_MOMENT = "moment_of_checkpoint"
_UNNEEDED = ["replay_buffer_class", "replay_buffer_kwargs", "action_noise"]


def make_model(env: VecEnv, task: str, settings: HyperParameters, seed: int) -> SAC:
    """Return an untrained agent.

    Args:
        env: to train in; its actions last as long as the settings say.
        task: of the environment.
        settings: its hyper-parameters.
        seed: of weights and exploration.

    Raises:
        ValueError: SAC has no argument of such a name, or the goals no such field.
    """
    policy = {
        "features_extractor_class": GoalFeatures,
        "features_extractor_kwargs": {"task": task, "hidden": settings.hidden},
        **settings.sac.get("policy_kwargs", {}),
    }
    arguments: dict[str, Any] = {**settings.sac, "policy_kwargs": policy}
    rate = settings.sac.get("learning_rate")
    if isinstance(rate, dict):
        arguments["learning_rate"] = LinearSchedule(rate["start"], rate["end"], 1.0)
    if settings.gripper_openings is not None:
        openings = GripperOpenings(seed=seed, **settings.gripper_openings)
        if settings.environments > 1:
            arguments["action_noise"] = VectorizedActionNoise(openings, settings.environments)
        else:
            arguments["action_noise"] = openings
    if settings.her is not None:
        arguments["replay_buffer_class"] = HerReplayBuffer
        arguments["replay_buffer_kwargs"] = settings.her
    try:
        model = SAC("MultiInputPolicy", env, seed=seed, device="cpu", **arguments)
    except TypeError as error:
        raise ValueError(f"the hyper-parameters do not fit: {error}") from None
    # What stable-baselines3 saves of an agent are its attributes.
    setattr(model, ACTION_REPEAT, settings.action_repeat)
    setattr(model, CPU_SECONDS, 0.0)
    return model


def save_checkpoint(model: SAC, folder: Path) -> None:
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
            model.save_replay_buffer(new / _REPLAY_BUFFER)
    finally:
        delattr(model, _MOMENT)
    # What a killed process was writing, too.
    for path in (*older.values(), *folder.glob(f".{_CHECKPOINT}-*")):
        shutil.rmtree(path)


def load_checkpoint(folder: Path, env: VecEnv) -> SAC | None:
    """Return the agent of the newest checkpoint, or None if there is none.

    Its episodes, replay buffer and random generators, also those of the process, are as they were.

    Args:
        folder: of the training.
        env: like that in which it was trained.

    Raises:
        ValueError: the checkpoint is of an older version of the package.
    """
    if (folder / _CHECKPOINT).exists():
        raise ValueError(f"{folder / _CHECKPOINT} is of an older version: train in another folder")
    checkpoints = _checkpoints(folder)
    if not checkpoints:
        return None
    checkpoint = checkpoints[max(checkpoints)]
    model = SAC.load(checkpoint / _MODEL, env=env, device="cpu", force_reset=False)
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
        if isinstance(model.replay_buffer, HerReplayBuffer):
            with warnings.catch_warnings():
                # The unfinished episodes are cut: what they lacked is never known.
                warnings.filterwarnings("ignore", message=".*trajectory")
                model.replay_buffer.truncate_last_trajectory()
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


def _moment(model: SAC) -> dict[str, Any]:
    """Return what SAC does not save of where it is: episodes under way and random generators."""
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


class _Periodically(BaseCallback):
    """Callback that calls a function with the agent at intervals, and another after each step."""

    def __init__(
        self, period: int, function: Callable[[SAC], None], each: Callable[[int], None]
    ) -> None:
        super().__init__()
        self._period, self._function, self._each = period, function, each

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._period + 1) * self._period

    def _on_rollout_start(self) -> None:
        # Here all steps have been stored and learned from, as they have not been in `_on_step`.
        if self.num_timesteps >= self._next:
            self._next = (self.num_timesteps // self._period + 1) * self._period
            assert isinstance(self.model, SAC)
            self._function(self.model)

    def _on_step(self) -> bool:
        self._each(self.num_timesteps)
        return True


class Training:
    """One training run, in a folder; starting it again goes on exactly from the last checkpoint.

    Nobody else can train in the folder until `close`, or until the process ends.

    Args:
        folder: to write.
        task: one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        dense: train on the dense reward.
        seed: of weights, exploration and training episodes.
        settings: hyper-parameters.

    Raises:
        ValueError: the folder holds another training, or the hyper-parameters do not fit.
        OSError: somebody else trains there (`FolderInUseError`), or it cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        *,
        task: str,
        difficulty: str,
        dense: bool,
        seed: int,
        settings: HyperParameters,
    ) -> None:
        self._folder = folder
        self._id = environment_id(task, "dense" if dense else "sparse")
        self._title = f"{self._id}, difficulty {difficulty}"
        description = {
            "environment": self._id,
            "difficulty": difficulty,
            "seed": seed,
            "settings": asdict(settings),
        }
        # Before anything is read there: whoever trains replaces what is.
        lock = FolderLock(folder) if folder.is_dir() else None
        begun = folder / "run.json"
        if begun.exists() and begun.read_text() != _text(description):
            raise ValueError(f"{folder} holds another training, or a damaged one, see {begun}")
        self._repeat, self._counted = settings.action_repeat, time.process_time()
        seen = partial(_seen, observations=settings.observations)
        self._test_env = seen(gymnasium.make(self._id, difficulty=difficulty), 1)
        env = make_vec_env(
            self._id,
            n_envs=settings.environments,
            env_kwargs={"difficulty": difficulty},
            wrapper_class=partial(seen, action_repeat=settings.action_repeat),
        )
        self.model = load_checkpoint(folder, env) or make_model(env, task, settings, seed)
        # Only now are the settings known to be good: those that are refused claim no folder.
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = lock or FolderLock(folder)
        write_text(begun, _text(description))
        self.evaluations = [
            evaluation
            for evaluation in read_evaluations(folder / "evaluations.csv")
            if evaluation.steps <= self.steps
        ]

    @property
    def steps(self) -> int:
        """Environment steps so far, as many for each decision as it lasts at most."""
        return int(self.model.num_timesteps) * self._repeat

    def run(
        self, steps: int, *, every: int, episodes: int, progress: Callable[[int, float], None]
    ) -> None:
        """Train up to a number of environment steps in all.

        Args:
            steps: environment steps, those before an interruption included.
            every: steps from one evaluation to the next.
            episodes: how many each evaluation plays: the tuning seeds from 0 on.
            progress: called with the steps so far and the last rate of success.
        """

        def measure(model: SAC) -> None:
            evaluation = evaluate(model, self._test_env, range(episodes))
            now = time.process_time()
            setattr(model, CPU_SECONDS, getattr(model, CPU_SECONDS) + now - self._counted)
            self._counted = now
            self.evaluations.append(evaluation)
            if evaluation.rate >= max(e.rate for e in self.evaluations):
                # An agent that only acts needs neither noise nor replay buffer, which to load takes
                # an environment.
                with replacing(self._folder / "agent.zip") as aside:
                    model.save(aside, exclude=_UNNEEDED)
            write_evaluations(self._folder / "evaluations.csv", self.evaluations)
            draw_curve(self._folder / "learning_curve.png", self.evaluations, self._title)
            save_checkpoint(model, self._folder)

        def report(decisions: int) -> None:
            progress(
                decisions * self._repeat, self.evaluations[-1].rate if self.evaluations else 0.0
            )

        remaining = -(-(steps - self.steps) // self._repeat)
        if remaining > 0:
            callback = _Periodically(-(-every // self._repeat), measure, report)
            self.model.learn(remaining, callback=callback, reset_num_timesteps=False)
            if not (self.evaluations and self.evaluations[-1].steps == self.steps):
                measure(self.model)

    def close(self) -> None:
        """Let others train in the folder."""
        self._lock.close()

    def finish(self, episodes: int) -> tuple[Evaluation, Evaluation]:
        """Measure the agent at the end and the best one on evaluation seeds, and return how."""
        with replacing(self._folder / "final.zip") as aside:
            self.model.save(aside, exclude=_UNNEEDED)
        best_model = SAC.load(self._folder / "agent.zip", device="cpu")
        seeds = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + episodes)
        final, best = (evaluate(model, self._test_env, seeds) for model in (self.model, best_model))
        scores = {"final": asdict(final), "best": asdict(best)}
        write_text(self._folder / "result.json", _text(scores))
        return final, best


def _text(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=2) + "\n"


def _seen(
    env: gymnasium.Env[Any, Any], action_repeat: int, observations: list[str] | None
) -> gymnasium.Env[Any, Any]:
    """Return an environment as an agent sees it."""
    env = ActionRepeat(env, action_repeat) if action_repeat > 1 else env
    return FilterObservation(env, observations) if observations else env
