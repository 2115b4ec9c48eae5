"""Training of stable-baselines3's SAC, as a rule with hindsight experience replay (HER).

The folder that a training writes holds

- ``run.json``: task, difficulty, seed and hyper-parameters;
- ``evaluations.csv``: success on the same tuning episodes again and again, with Wilson intervals;
- ``learning_curve.png``: that as a figure;
- ``agent.zip``: the agent that did best on the tuning episodes, for `SAC.load`;
- ``result.json``: how it does on episodes that neither training nor the choice of it has seen;
- ``checkpoint/``: what it takes to go on after an interruption, or with more steps; large.
  stable-baselines3 pickles: go on only in folders of your own.
"""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.wrappers import FilterObservation
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.agents.evaluations import (
    Evaluation,
    draw_curve,
    evaluate,
    read_evaluations,
    write_evaluations,
)
from smp_planner.agents.hyper_parameters import HyperParameters

__all__ = ["Training", "load_checkpoint", "make_model", "save_checkpoint"]

_CHECKPOINT, _CHECKPOINT_NEW = "checkpoint", "checkpoint.new"
_MODEL, _REPLAY_BUFFER = "model.zip", "replay_buffer.pkl"
_REPLAY_ARGUMENTS = ["replay_buffer_class", "replay_buffer_kwargs"]


def make_model(env: VecEnv, settings: HyperParameters, seed: int) -> SAC:
    """Return an untrained agent.

    Args:
        env: to train in.
        settings: its hyper-parameters.
        seed: of weights and exploration.

    Raises:
        ValueError: SAC has no argument of such a name.
    """
    arguments: dict[str, Any] = dict(settings.sac)
    if settings.her is not None:
        arguments["replay_buffer_class"] = HerReplayBuffer
        arguments["replay_buffer_kwargs"] = settings.her
    try:
        return SAC("MultiInputPolicy", env, seed=seed, device="cpu", **arguments)
    except TypeError as error:
        raise ValueError(f"the hyper-parameters do not fit: {error}") from None


def save_checkpoint(model: SAC, folder: Path) -> None:
    """Write agent and replay buffer, so that an interruption leaves the last ones or these."""
    new, old = folder / _CHECKPOINT_NEW, folder / _CHECKPOINT
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    model.save(new / _MODEL)
    model.save_replay_buffer(new / _REPLAY_BUFFER)
    shutil.rmtree(old, ignore_errors=True)
    new.rename(old)


def load_checkpoint(folder: Path, env: VecEnv) -> SAC | None:
    """Return the agent of the checkpoint with its replay buffer, or None if there is none."""
    checkpoint = folder / _CHECKPOINT
    if not checkpoint.exists():
        return None
    model = SAC.load(checkpoint / _MODEL, env=env, device="cpu")
    with warnings.catch_warnings():
        # The unfinished episodes are cut: what they lacked is never known.
        warnings.filterwarnings("ignore", message=".*trajectory")
        model.load_replay_buffer(checkpoint / _REPLAY_BUFFER, truncate_last_traj=True)
    return model


class _Periodically(BaseCallback):
    """Callback that calls a function with the agent at intervals, and another after each step."""

    def __init__(
        self, period: int, function: Callable[[SAC], None], each: Callable[[int], None]
    ) -> None:
        super().__init__()
        self._period, self._function, self._each = period, function, each

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._period + 1) * self._period

    def _on_step(self) -> bool:
        self._each(self.num_timesteps)
        if self.num_timesteps >= self._next:
            self._next += self._period
            assert isinstance(self.model, SAC)
            self._function(self.model)
        return True


class Training:
    """One training run, in a folder; starting it again goes on from the last checkpoint.

    Args:
        folder: to write.
        task: one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        dense: train on the dense reward.
        seed: of weights, exploration and training episodes.
        settings: hyper-parameters.

    Raises:
        ValueError: the folder holds another training, or the hyper-parameters do not fit.
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
        self._claim_folder(
            {
                "environment": self._id,
                "difficulty": difficulty,
                "seed": seed,
                "settings": asdict(settings),
            }
        )
        view = partial(_only, observations=settings.observations)
        self._test_env = view(gymnasium.make(self._id, difficulty=difficulty))
        env = make_vec_env(
            self._id,
            n_envs=settings.environments,
            env_kwargs={"difficulty": difficulty},
            wrapper_class=view,
        )
        self.model = load_checkpoint(folder, env) or make_model(env, settings, seed)
        # After a restart other episodes than those that came first.
        env.seed(seed + self.model.num_timesteps)
        self.evaluations = [
            evaluation
            for evaluation in read_evaluations(folder / "evaluations.csv")
            if evaluation.steps <= self.model.num_timesteps
        ]

    def _claim_folder(self, run: dict[str, Any]) -> None:
        path = self._folder / "run.json"
        if path.exists():
            if json.loads(path.read_text()) != run:
                raise ValueError(f"{self._folder} holds another training, see {path}")
        else:
            self._folder.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(run, indent=2) + "\n")

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
            self.evaluations.append(evaluation)
            if evaluation.rate >= max(e.rate for e in self.evaluations):
                # An agent that only acts needs no replay buffer, nor an environment to load it.
                model.save(self._folder / "agent.zip", exclude=_REPLAY_ARGUMENTS)
            write_evaluations(self._folder / "evaluations.csv", self.evaluations)
            draw_curve(self._folder / "learning_curve.png", self.evaluations, self._title)
            save_checkpoint(model, self._folder)

        def report(done: int) -> None:
            progress(done, self.evaluations[-1].rate if self.evaluations else 0.0)

        remaining = steps - self.model.num_timesteps
        if remaining > 0:
            callback = _Periodically(every, measure, report)
            self.model.learn(remaining, callback=callback, reset_num_timesteps=False)
            if self.evaluations[-1:] and self.evaluations[-1].steps == self.model.num_timesteps:
                return
            measure(self.model)

    def finish(self, episodes: int) -> Evaluation:
        """Measure the best agent on evaluation seeds."""
        model = SAC.load(self._folder / "agent.zip", device="cpu")
        seeds = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + episodes)
        result = evaluate(model, self._test_env, seeds)
        (self._folder / "result.json").write_text(json.dumps(asdict(result), indent=2) + "\n")
        return result


def _only(env: gymnasium.Env[Any, Any], observations: list[str] | None) -> gymnasium.Env[Any, Any]:
    return FilterObservation(env, observations) if observations else env
