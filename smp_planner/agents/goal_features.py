"""What an agent's networks see of an observation, with hindsight in mind."""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.goal_features")

from collections.abc import Mapping, Sequence

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from smp_gym.observation import MAX_SUPPORTS, state_places
from smp_gym.tasks.registry import make_task

__all__ = ["GoalFeatures"]

_PER_METRE = 5.0
_LARGEST = 10.0
"""Scale of offsets, and bound of all features: a falling object turns at up to 200 rad/s."""


class GoalFeatures(BaseFeaturesExtractor):
    """The entries of an observation side by side, and offsets from where things are to their goals.

    The offsets are those of the desired goal from the achieved one, and of the supports from the
    object. Fields of the desired goal can be hidden: goals that hindsight puts in place of the
    desired one demand less of them (the object at a place, but in the hand), and what is learned of
    these carries over only if the networks cannot tell the two kinds apart.

    Args:
        observation_space: a `Dict` with ``observation``, ``achieved_goal`` and ``desired_goal``.
        task: whose observations they are.
        hidden: fields of the desired goal that are not seen.

    Raises:
        ValueError: the goals of the task have no such field.
    """

    _shown: torch.Tensor

    def __init__(
        self, observation_space: spaces.Dict, task: str, hidden: Sequence[str] = ()
    ) -> None:
        codec = make_task(task).goals
        fields = [field.name for field in codec.layout]
        unknown = sorted(set(hidden) - set(fields))
        if unknown:
            raise ValueError(
                f"hidden must name goal fields of {task}, {', '.join(fields)}; got {unknown[0]!r}"
            )
        goal = sum(field.size for field in codec.layout)
        super().__init__(
            observation_space, spaces.flatdim(observation_space) + goal + 3 * MAX_SUPPORTS
        )
        shown = torch.ones(goal)
        for name in hidden:
            shown[codec.columns(name)] = 0.0
        self.register_buffer("_shown", shown)
        self._keys = sorted(observation_space)
        self._object, self._supports = state_places("object_position"), state_places("supports")

    def forward(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the features (B, F) of observations (B, ...)."""
        entries = {key: observations[key].float() for key in self._keys}
        desired = entries["desired_goal"] * self._shown
        entries["desired_goal"] = desired
        to_goal = desired - entries["achieved_goal"] * self._shown
        state = entries["observation"]
        object_position = state[:, self._object].repeat(1, MAX_SUPPORTS)
        to_supports = state[:, self._supports] - object_position
        offsets = _PER_METRE * torch.cat([to_goal, to_supports], dim=1)
        return torch.cat([*entries.values(), offsets], dim=1).clamp(-_LARGEST, _LARGEST)
