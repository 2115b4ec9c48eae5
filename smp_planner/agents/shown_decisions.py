"""A planner's episodes as decisions, and a replay buffer that draws on them in every batch.

The half of each batch that is drawn from demonstrations is that of Ball et al. 2023, "Efficient
Online Reinforcement Learning with Offline Data". Decisions are those of
`smp_planner.agents.watched_episodes`.
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.shown_decisions")

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, count
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from smp_gym.rollout import Moment
from smp_planner.agents.watched_episodes import decision_actions, watched
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = ["Decision", "ShownReplayBuffer", "shown_episodes"]

FIRST_SEED = 90_000
"""Tuning seed of the first scene that is shown to a training with seed 0."""

_SEEDS = 1_000
"""Seeds between the first scenes of two trainings."""


class Decision(NamedTuple):
    """One decision of an episode, as a replay buffer has it.

    Attributes:
        before: observation (F,) by entry, in which it was taken.
        after: observation when it ended.
        action: (7,) mean of the actions in its steps.
        reward: their sum.
        terminated: whether the episode ended with it.
    """

    before: Mapping[str, NDArray[np.float32]]
    after: Mapping[str, NDArray[np.float32]]
    action: NDArray[np.float32]
    reward: float
    terminated: bool


def shown_episodes(
    env: gymnasium.Env[Any, Any],
    task: str,
    difficulty: str,
    seed: int,
    repeat: int,
    stride: int | None = None,
) -> Iterator[list[Decision]]:
    """Yield episodes of `smp` that succeed, in unselected scenes, as decisions, without an end.

    Args:
        env: of the task, in which an action lasts one step.
        task: its name.
        difficulty: of the scenes.
        seed: of the training.
        repeat: steps that a decision lasts.
        stride: steps from the beginning of one decision to that of the next; None for `repeat`.
    """
    policy = PlannerPolicy.make("smp", task)
    for number in count(FIRST_SEED + _SEEDS * seed):
        moments = watched(env, policy, task, difficulty, number)
        if moments is not None:
            yield _decisions(moments, repeat, stride or repeat)


def _decisions(moments: Sequence[Moment], repeat: int, stride: int) -> list[Decision]:
    actions = decision_actions(np.stack([moment.action for moment in moments[1:]]), repeat)
    found = []
    for first in range(0, len(actions), stride):
        steps = moments[first + 1 : first + 1 + repeat]
        reward = sum(step.reward for step in steps)
        before, last = moments[first].observation, steps[-1]
        found.append(Decision(before, last.observation, actions[first], reward, last.terminated))
    return found


class ShownReplayBuffer(DictReplayBuffer):
    """A replay buffer that draws a share of each batch from episodes that were shown.

    Args:
        arguments: of `DictReplayBuffer`, in its order.
        share: of each batch.
        named: arguments of `DictReplayBuffer`, by name.
    """

    def __init__(self, *arguments: Any, share: float, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._share = share
        self.shown: DictReplayBuffer | None = None

    def show(self, episodes: Sequence[Sequence[Decision]]) -> None:
        """Keep episodes to draw from."""
        total = sum(map(len, episodes))
        self.shown = DictReplayBuffer(total, self.observation_space, self.action_space)
        for decision in chain.from_iterable(episodes):
            self.shown.add(
                {key: decision.before[key][None] for key in self.observations},
                {key: decision.after[key][None] for key in self.observations},
                decision.action[None],
                np.array([decision.reward]),
                np.array([decision.terminated]),
                [{}],
            )

    def shown_batch(self, count: int) -> DictReplayBufferSamples:
        """Return so many decisions that were shown.

        Raises:
            ValueError: nothing was shown.
        """
        if self.shown is None:
            raise ValueError("the buffer must hold episodes that were shown, got none")
        return self.shown.sample(count)

    def sample(  # type: ignore[override]
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Return a batch, the share of it from what was shown first."""
        count = round(self._share * batch_size)
        shown, own = self.shown_batch(count), super().sample(batch_size - count, env)
        return DictReplayBufferSamples(
            observations=_joined(shown.observations, own.observations),
            actions=torch.cat([shown.actions, own.actions]),
            next_observations=_joined(shown.next_observations, own.next_observations),
            dones=torch.cat([shown.dones, own.dones]),
            rewards=torch.cat([shown.rewards, own.rewards]),
        )


def _joined(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {key: torch.cat([one[key], other[key]]) for key in one}
