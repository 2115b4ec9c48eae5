"""Behaviour cloning: a network that imitates a planner's policy, from what that did in episodes.

``cloning`` sees undisturbed episodes alone. ``distilled`` sees recovery data as well: bursts of
random rates push the arm off its trajectory, and what is learned is what the planner's policy does
to come back (DART: Laskey et al. 2017). Episodes that fail teach nothing and are left out. What is
learned as a decision, see `smp_planner.agents.watched_episodes`: one begins at each step of an
episode, and those are left out in which a burst pushes.

The folder that a training writes holds

- ``run.json``: agent, task, difficulties, seed and settings;
- ``episodes-000.npz`` and so on: what was observed and done, the CPU seconds, how many failed;
- ``curve.csv``: error of the actions in the episodes that are learned from and in those kept apart;
- ``checkpoint.pt``: what it takes to go on after an interruption;
- ``agent.json`` and ``agent.safetensors``: the agent with the least error in the latter.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.atomic_files import replacing
from smp_gym.observation import observation_space
from smp_gym.registration import environment_id
from smp_gym.rollout import Policy
from smp_planner.agents.actor_file import Actor, ActorCard, write_actor
from smp_planner.agents.training_folder import (
    claimed,
    named_settings,
    read_checkpoint,
    write_checkpoint,
)
from smp_planner.agents.watched_episodes import decision_actions, watched
from smp_planner.benchmark.results_folder import write_table
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.strict_settings import StrictSettings
from smp_planner.torch_threads import one_thread

__all__ = ["CLONES", "Cloning", "CloningSettings", "DisturbedPolicy", "Episode", "demonstrated"]

CLONES = ("cloning", "distilled")
"""Names of the agents."""

FIRST_SEED = 82_000
"""Tuning seed of the first scene of a training with seed 0."""

_SEEDS = 3_000
"""Seeds between the first scenes of two trainings."""

_CHUNK = 20
"""Episodes in a file."""

_ARM = 6


class CloningSettings(StrictSettings):
    """Settings of a training.

    Attributes:
        action_repeat: control steps that a decision lasts.
        episodes: scenes in which the planner's policy is watched.
        bursts: share of control steps at which a burst of random rates begins.
        burst_steps: control steps that one lasts.
        burst_rate: largest random rate of a joint, as a share of the action's range.
        layers: widths of the hidden layers.
        epochs: passes over all that is learned from.
        batch: decisions in a step of the gradient.
        learning_rate: of Adam in the beginning; it falls to zero along half a cosine.
        apart: share of the episodes, the last ones, that are not learned from.
    """

    action_repeat: int = Field(default=1, ge=1)
    episodes: int = Field(default=600, ge=2)
    bursts: float = Field(default=0.0, ge=0.0, lt=1.0)
    burst_steps: int = Field(default=4, ge=1)
    burst_rate: float = Field(default=1.0, gt=0.0, le=1.0)
    layers: tuple[int, ...] = (256, 256, 256)
    epochs: int = Field(default=40, ge=1)
    batch: int = Field(default=512, ge=1)
    learning_rate: float = Field(default=1e-3, gt=0.0, allow_inf_nan=False)
    apart: float = Field(default=0.1, gt=0.0, lt=1.0)

    @classmethod
    def from_json(cls, path: Path, agent: str) -> CloningSettings:
        """Read settings: those of ``"*"`` in a JSON file, and an agent's.

        Raises:
            OSError: there is no such file.
            ValueError: it is not JSON, or a setting is unknown or out of range.
        """
        return cls.model_validate(named_settings(path, "*", agent))


class DisturbedPolicy:
    """A policy with bursts of random rates in place of its actions, which it records.

    Args:
        policy: that is disturbed.
        settings: of the bursts.
        rng: source of all randomness.

    Attributes:
        labels: actions (7,) of the policy, one for each step.
        disturbed: whether random rates took their place, for each step.
    """

    def __init__(self, policy: Policy, settings: CloningSettings, rng: np.random.Generator) -> None:
        self._policy, self._settings, self._rng = policy, settings, rng
        self._left, self._rates = 0, np.zeros(_ARM, np.float32)
        self.labels: list[NDArray[np.float32]] = []
        self.disturbed: list[bool] = []

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Return the action, disturbed or not, and the state of the policy."""
        action, state = self._policy.predict(observation, state, deterministic=True)
        self.labels.append(np.array(action, np.float32))
        settings = self._settings
        if self._left == 0 and self._rng.random() < settings.bursts:
            self._left = settings.burst_steps
            most = settings.burst_rate
            self._rates = self._rng.uniform(-most, most, _ARM).astype(np.float32)
        self.disturbed.append(self._left > 0)
        if self._left:
            self._left -= 1
            action = np.array(action, np.float32)
            action[:_ARM] = self._rates
        return action, state


@dataclass(frozen=True)
class Episode:
    """Observations of an episode, and the policy's action at each.

    Attributes:
        observations: (steps, F) by entry.
        actions: (steps, 7).
        disturbed: (steps,) bool, whether random rates took its place.
    """

    observations: dict[str, NDArray[np.float32]]
    actions: NDArray[np.float32]
    disturbed: NDArray[np.bool_]

    def decisions(self, repeat: int) -> Episode:
        """Return the undisturbed decisions, one beginning at each step, as steps of an episode.

        Args:
            repeat: control steps that a decision lasts.
        """
        pushed = [self.disturbed[at : at + repeat].any() for at in range(len(self.disturbed))]
        rows = np.flatnonzero(np.logical_not(pushed))
        return Episode(
            {key: seen[rows] for key, seen in self.observations.items()},
            decision_actions(self.actions, repeat)[rows],
            self.disturbed[rows],
        )


class _Steps(NamedTuple):
    """Observations (N, F) before decisions by entry, and actions (N, 7)."""

    observations: dict[str, Tensor]
    actions: Tensor


def demonstrated(
    env: gymnasium.Env[Any, Any],
    policy: PlannerPolicy,
    difficulty: str,
    seed: int,
    settings: CloningSettings,
) -> Episode | None:
    """Return an episode of a planner's policy; None if it fails.

    Args:
        env: of the policy's task.
        policy: to be imitated.
        difficulty: of the scene.
        seed: of the scene, and of the bursts.
        settings: of the bursts.
    """
    disturbed = DisturbedPolicy(policy, settings, np.random.default_rng([seed, 7]))
    moments = watched(env, disturbed, policy.task, difficulty, seed)
    if moments is None:
        return None
    before = [moment.observation for moment in moments[:-1]]
    observations = {key: np.stack([seen[key] for seen in before]) for key in before[0]}
    return Episode(observations, np.stack(disturbed.labels), np.array(disturbed.disturbed))


class Cloning:
    """One training, in a folder; starting it again goes on from the last file or checkpoint.

    Nobody else can train in the folder until `close`, or until the process ends.

    Args:
        folder: to write.
        agent: one of `CLONES`.
        task: one of `smp_gym.scene.TASKS`.
        difficulties: of the scenes, in turn.
        seed: of scenes, bursts, weights and batches.
        settings: see `CloningSettings`.

    Raises:
        ValueError: the folder holds another training, or a damaged one.
        OSError: somebody else trains there (`FolderInUseError`), or it cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        *,
        agent: str,
        task: str,
        difficulties: Sequence[str],
        seed: int,
        settings: CloningSettings,
    ) -> None:
        self._folder, self._agent, self._task, self._seed = folder, agent, task, seed
        self._difficulties, self._settings = tuple(difficulties), settings
        self._description = {
            "agent": agent,
            "task": task,
            "difficulties": list(difficulties),
            "seed": seed,
            "settings": settings.model_dump(mode="json"),
        }
        self._lock = claimed(folder, self._description)
        self.epoch, self.failed = 0, 0
        self.curve: list[tuple[int, float, float]] = []
        self._watch_seconds, self._fit_seconds = 0.0, 0.0
        torch.manual_seed(seed)
        self.actor = Actor(self._card())
        self._optimiser = torch.optim.Adam(self.actor.parameters(), settings.learning_rate)
        self._restore()

    @property
    def episodes(self) -> int:
        """Number of episodes that are played."""
        return self._settings.episodes

    @property
    def epochs(self) -> int:
        """Number of epochs."""
        return self._settings.epochs

    def close(self) -> None:
        """Let others train in the folder."""
        self._lock.close()

    def watch(self, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        """Play the episodes that the folder does not hold.

        Args:
            progress: called with the number of episodes that were played and of all.
        """
        wanted = self._settings.episodes
        policy = PlannerPolicy.make("smp", self._task)
        env = gymnasium.make(environment_id(self._task))
        for first in range(0, wanted, _CHUNK):
            path = self._folder / f"episodes-{first // _CHUNK:03d}.npz"
            if not path.exists():
                begin, found = time.process_time(), []
                numbers = range(first, min(first + _CHUNK, wanted))
                for number in numbers:
                    difficulty = self._difficulties[number % len(self._difficulties)]
                    scene_seed = FIRST_SEED + _SEEDS * self._seed + number
                    episode = demonstrated(env, policy, difficulty, scene_seed, self._settings)
                    if episode is not None:
                        found.append(episode)
                    progress(number + 1, wanted)
                _write_episodes(path, found, len(numbers), time.process_time() - begin)
            progress(min(first + _CHUNK, wanted), wanted)
        env.close()

    def fit(self, progress: Callable[[int, float], None] = lambda epoch, error: None) -> None:
        """Learn from the episodes, and write the agent with the least error in those kept apart.

        Args:
            progress: called with the number of epochs and the error, see ``curve.csv``.

        Raises:
            ValueError: too few episodes succeeded to learn from some and to keep one apart.
        """
        learned, apart = self._episodes()
        generator = torch.Generator()
        settings = self._settings
        with one_thread():
            while self.epoch < settings.epochs:
                begin = time.process_time()
                generator.manual_seed(1000 * self._seed + self.epoch)
                error = self._pass(learned, generator)
                self.epoch += 1
                held = self._error(apart)
                self.curve.append((self.epoch, error, held))
                self._fit_seconds += time.process_time() - begin
                self._keep()
                progress(self.epoch, held)

    def _pass(self, data: _Steps, generator: torch.Generator) -> float:
        """Take one epoch, and return the mean squared error met on the way."""
        observations, actions = data
        settings = self._settings
        order = torch.randperm(len(actions), generator=generator)
        batches = order.split(settings.batch)
        total = 0.0
        for number, rows in enumerate(batches):
            share = (self.epoch + number / len(batches)) / settings.epochs
            for group in self._optimiser.param_groups:
                group["lr"] = settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * share))
            found = self.actor({key: value[rows] for key, value in observations.items()})
            loss = (found - actions[rows]).square().mean()
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            total += float(loss.detach()) * len(rows)
        return total / len(actions)

    def _error(self, data: _Steps) -> float:
        observations, actions = data
        with torch.no_grad():
            return float((self.actor(observations) - actions).square().mean())

    def _episodes(self) -> tuple[_Steps, _Steps]:
        """Return observations and actions of the episodes to learn from, and of those apart."""
        found: list[Episode] = []
        self.failed, self._watch_seconds = 0, 0.0
        for path in sorted(self._folder.glob("episodes-*.npz")):
            episodes, played, seconds = _read_episodes(path)
            found += episodes
            self.failed += played - len(episodes)
            self._watch_seconds += seconds
        last = round(self._settings.apart * len(found))
        if not 0 < last < len(found):
            raise ValueError(
                f"{self._folder} holds {len(found)} episodes with success, too few to learn from "
                f"some and to keep {self._settings.apart:.0%} apart"
            )
        found = [episode.decisions(self._settings.action_repeat) for episode in found]
        return _joined(found[:-last]), _joined(found[-last:])

    def _card(self) -> ActorCard:
        spent = {
            "cpu_seconds": round(self._watch_seconds + self._fit_seconds, 1),
            "episodes_failed": self.failed,
            "epochs": self.epoch,
        }
        return ActorCard(
            agent=self._agent,
            task=self._task,
            entries=sorted(observation_space(self._task)),
            hidden=(),
            action_repeat=self._settings.action_repeat,
            layers=list(self._settings.layers),
            training={**self._description, **spent},
            scores={},
        )

    def _keep(self) -> None:
        """Write curve, checkpoint, and the agent if it is the best so far."""
        if self.curve[-1][2] <= min(held for _, _, held in self.curve):
            write_actor(self._folder / "agent.json", self.actor, self._card())
        content = {
            "actor": self.actor.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "epoch": self.epoch,
            "fit_seconds": self._fit_seconds,
            "curve": self.curve,
        }
        write_checkpoint(self._folder, content)
        write_table(self._folder / "curve.csv", ["epoch", "error", "error_apart"], self.curve)

    def _restore(self) -> None:
        content = read_checkpoint(self._folder)
        if content is None:
            return
        self.actor.load_state_dict(content["actor"])
        self._optimiser.load_state_dict(content["optimiser"])
        self.epoch, self._fit_seconds = content["epoch"], content["fit_seconds"]
        self.curve = [tuple(point) for point in content["curve"]]


def _joined(episodes: Sequence[Episode]) -> _Steps:
    keys = episodes[0].observations
    observations = {
        key: torch.from_numpy(np.concatenate([each.observations[key] for each in episodes]))
        for key in keys
    }
    return _Steps(
        observations, torch.from_numpy(np.concatenate([each.actions for each in episodes]))
    )


def _write_episodes(path: Path, episodes: Sequence[Episode], played: int, seconds: float) -> None:
    arrays: dict[str, Any] = {"played": np.array(played), "seconds": np.array(seconds)}
    arrays["steps"] = np.array([len(each.actions) for each in episodes], np.int64)
    if episodes:
        for name in ("actions", "disturbed"):
            arrays[name] = np.concatenate([getattr(each, name) for each in episodes])
        for key in episodes[0].observations:
            parts = [each.observations[key] for each in episodes]
            arrays[f"observation:{key}"] = np.concatenate(parts)
    with replacing(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _read_episodes(path: Path) -> tuple[list[Episode], int, float]:
    """Return the episodes of a file, how many were played, and the CPU seconds of that."""
    with np.load(path, allow_pickle=False) as arrays:
        steps, played = arrays["steps"], int(arrays["played"])
        seconds = float(arrays["seconds"])
        if not len(steps):
            return [], played, seconds
        cuts = np.cumsum(steps)[:-1]
        actions, disturbed = (np.split(arrays[name], cuts) for name in ("actions", "disturbed"))
        names = [name for name in arrays.files if name.startswith("observation:")]
        parts = {name.partition(":")[2]: np.split(arrays[name], cuts) for name in names}
    episodes = [
        Episode({key: part[index] for key, part in parts.items()}, actions[index], disturbed[index])
        for index in range(len(steps))
    ]
    return episodes, played, seconds
