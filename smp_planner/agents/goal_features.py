"""`GoalView` as the features extractor of stable-baselines3's policies."""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.goal_features")

from collections.abc import Mapping, Sequence

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from smp_planner.agents.goal_view import GoalView

__all__ = ["GoalFeatures"]


class GoalFeatures(BaseFeaturesExtractor):
    """The features of a `GoalView` of all entries of an observation.

    Args:
        observation_space: a `Dict` of entries that an environment's observations have.
        task: whose observations they are.
        hidden: fields of the desired goal that are not seen.

    Raises:
        ValueError: the environment has no such entry, or the goals of the task no such field.
    """

    def __init__(
        self, observation_space: spaces.Dict, task: str, hidden: Sequence[str] = ()
    ) -> None:
        view = GoalView(task, list(observation_space), hidden)
        super().__init__(observation_space, view.width)
        self._view = view

    def forward(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the features (B, F) of observations (B, ...)."""
        return self._view(observations)
