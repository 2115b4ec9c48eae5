"""Training of stable-baselines3's agents: SAC, as a rule with hindsight experience replay, and PPO.

The folder that a training writes holds

- ``run.json``: agent, task, difficulty, seed and hyper-parameters;
- ``evaluations.csv``: success on the same tuning episodes again and again, with Wilson intervals;
- ``learning_curve.png``: that as a figure;
- ``agent.zip``: the agent that did best on the tuning episodes, for its class's ``load``, or as a
  method of the benchmark; its attribute ``action_repeat`` says how many environment steps a
  decision lasts;
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

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.wrappers import FilterObservation
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.atomic_files import replacing, write_text
from smp_gym.folder_lock import FolderLock
from smp_gym.registration import environment_id
from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.agents.checkpoints import load_checkpoint, save_checkpoint
from smp_planner.agents.decisions import CPU_SECONDS, ActionRepeat
from smp_planner.agents.demonstrated_sac import DemonstratedSAC
from smp_planner.agents.evaluations import (
    Evaluation,
    draw_curve,
    evaluate,
    read_evaluations,
    write_evaluations,
)
from smp_planner.agents.hyper_parameters import HyperParameters
from smp_planner.agents.learners import class_of, make_model
from smp_planner.agents.shown_decisions import ShownReplayBuffer, shown_episodes

__all__ = ["Training"]

_UNNEEDED = ["replay_buffer_class", "replay_buffer_kwargs", "action_noise"]
"""Of an agent that only acts; to load a replay buffer takes an environment."""


class _Periodically(BaseCallback):
    """Callback that calls a function with the agent at intervals, and another after each step."""

    def __init__(
        self, period: int, function: Callable[[BaseAlgorithm], None], each: Callable[[int], None]
    ) -> None:
        super().__init__()
        self._period, self._function, self._each = period, function, each

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._period + 1) * self._period

    def _on_rollout_start(self) -> None:
        # Here all steps have been stored and learned from, as they have not been in `_on_step`.
        if self.num_timesteps >= self._next:
            self._next = (self.num_timesteps // self._period + 1) * self._period
            self._function(self.model)

    def _on_step(self) -> bool:
        self._each(self.num_timesteps)
        return True


class Training:
    """One training run, in a folder; starting it again goes on exactly from the last checkpoint.

    Nobody else can train in the folder until `close`, or until the process ends.

    Args:
        folder: to write.
        agent: name of it, for its description.
        task: one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
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
        agent: str,
        task: str,
        difficulty: str,
        seed: int,
        settings: HyperParameters,
    ) -> None:
        self._folder, self._settings = folder, settings
        self._task, self._difficulty, self._seed = task, difficulty, seed
        self._id = environment_id(task, settings.reward)
        self._title = f"{agent}, {self._id}, difficulty {difficulty}"
        description = {
            "agent": agent,
            "environment": self._id,
            "difficulty": difficulty,
            "seed": seed,
            "settings": settings.model_dump(mode="json"),
        }
        # Before anything is read there: whoever trains replaces what is.
        lock = FolderLock(folder) if folder.is_dir() else None
        begun = folder / "run.json"
        if begun.exists() and begun.read_text() != _text(description):
            raise ValueError(f"{folder} holds another training, or a damaged one, see {begun}")
        self._repeat, self._counted = settings.action_repeat, time.process_time()
        seen = partial(_seen, observations=settings.seen(difficulty))
        self._test_env = seen(gymnasium.make(self._id, difficulty=difficulty), 1)
        env = make_vec_env(
            self._id,
            n_envs=settings.environments,
            env_kwargs={"difficulty": difficulty},
            wrapper_class=partial(seen, action_repeat=settings.action_repeat),
        )
        there = load_checkpoint(folder, env, class_of(settings))
        self.model = there or make_model(env, task, settings, seed)
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

    def show(self, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        """Show an agent that has not begun to learn what its settings ask for.

        Args:
            progress: called with the number of episodes that were shown and of all.
        """
        wanted = self._settings.demonstrations
        if wanted is None:
            return
        assert isinstance(self.model, DemonstratedSAC)
        assert isinstance(self.model.replay_buffer, ShownReplayBuffer)
        if self.model.replay_buffer.shown is not None:
            return
        repeat = self._settings.action_repeat
        with gymnasium.make(self._id, difficulty=self._difficulty) as env:
            unending = shown_episodes(
                env, self._task, self._difficulty, self._seed, repeat, wanted.stride
            )
            episodes = []
            for episode in islice(unending, wanted.episodes):
                episodes.append(episode)
                progress(len(episodes), wanted.episodes)
        self.model.replay_buffer.show(episodes)
        self.model.clone()

    def run(
        self, steps: int, *, every: int, episodes: int, progress: Callable[[int, float], None]
    ) -> None:
        """Train up to a number of environment steps in all.

        Args:
            steps: environment steps, those before an interruption included.
            every: steps from one evaluation to the next; at the end of a rollout, of PPO.
            episodes: how many each evaluation plays: the tuning seeds from 0 on.
            progress: called with the steps so far and the last rate of success.
        """

        def measure(model: BaseAlgorithm) -> None:
            evaluation = evaluate(model, self._test_env, range(episodes))
            now = time.process_time()
            setattr(model, CPU_SECONDS, getattr(model, CPU_SECONDS) + now - self._counted)
            self._counted = now
            self.evaluations.append(evaluation)
            if evaluation.rate >= max(e.rate for e in self.evaluations):
                with replacing(self._folder / "agent.zip") as aside:
                    model.save(aside, exclude=_UNNEEDED)
            write_evaluations(self._folder / "evaluations.csv", self.evaluations)
            draw_curve(self._folder / "learning_curve.png", self.evaluations, self._title)
            if model._last_obs is not None:
                # Before the first episode there is nothing to go on from.
                save_checkpoint(model, self._folder)

        def report(decisions: int) -> None:
            progress(
                decisions * self._repeat, self.evaluations[-1].rate if self.evaluations else 0.0
            )

        self.show()
        if self._settings.demonstrations is not None and not self.evaluations:
            # What the clone can do, before it learns.
            measure(self.model)
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
        best_model = type(self.model).load(self._folder / "agent.zip", device="cpu")
        seeds = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + episodes)
        final, best = (evaluate(model, self._test_env, seeds) for model in (self.model, best_model))
        scores = {"final": asdict(final), "best": asdict(best)}
        write_text(self._folder / "result.json", _text(scores))
        return final, best


def _text(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=2) + "\n"


def _seen(
    env: gymnasium.Env[Any, Any], action_repeat: int, observations: tuple[str, ...]
) -> gymnasium.Env[Any, Any]:
    """Return an environment as an agent sees it."""
    env = ActionRepeat(env, action_repeat) if action_repeat > 1 else env
    return FilterObservation(env, observations)
