"""Features of an observation for the networks of goal-conditioned agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from smp_gym.observation import MAX_SUPPORTS, observation_space, state_places
from smp_gym.tasks.registry import make_task

__all__ = ["GOAL_CONDITIONED", "GoalView"]

GOAL_CONDITIONED = ("observation", "achieved_goal", "desired_goal")
"""Entries of an observation that are always seen."""

_PER_METRE = 5.0
_LARGEST = 10.0
"""Scale of offsets, and bound of all features: a falling object turns at up to 200 rad/s."""


class GoalView:
    """The entries of an observation side by side, and offsets from where things are to their goals.

    The offsets are those of the desired goal from the achieved one, and of the supports from the
    object. Fields of the desired goal can be hidden: goals that hindsight puts in place of the
    desired one demand less of them (the object at a place, but in the hand), and what is learned of
    these carries over only if the networks cannot tell the two kinds apart.

    Args:
        task: whose observations they are.
        entries: of the observations that are seen, `GOAL_CONDITIONED` among them.
        hidden: fields of the desired goal that are not seen.

    Attributes:
        width: F, number of features.

    Raises:
        ValueError: the observations have no such entry, or the goals of the task no such field.
    """

    def __init__(self, task: str, entries: Sequence[str], hidden: Sequence[str] = ()) -> None:
        codec = make_task(task).goals
        sizes = {key: box.shape[0] for key, box in observation_space(task).items()}  # type: ignore[index]
        if not set(GOAL_CONDITIONED) <= set(entries) <= set(sizes):
            raise ValueError(
                f"entries must be of {', '.join(sizes)}, with {', '.join(GOAL_CONDITIONED)} among "
                f"them; got {sorted(entries)}"
            )
        fields = [field.name for field in codec.layout]
        unknown = sorted(set(hidden) - set(fields))
        if unknown:
            raise ValueError(
                f"hidden must name goal fields of {task}, {', '.join(fields)}; got {unknown[0]!r}"
            )
        self._entries = sorted(entries)
        self._shown = torch.ones(sizes["desired_goal"])
        for name in hidden:
            self._shown[codec.columns(name)] = 0.0
        self._object, self._supports = state_places("object_position"), state_places("supports")
        self.width = sum(sizes[key] for key in entries) + sizes["desired_goal"] + 3 * MAX_SUPPORTS

    def __call__(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the features (B, F) of observations (B, ...)."""
        entries = {key: observations[key].float() for key in self._entries}
        entries["desired_goal"] = entries["desired_goal"] * self._shown
        to_goal = entries["desired_goal"] - entries["achieved_goal"] * self._shown
        state = entries["observation"]
        object_position = state[:, self._object].repeat(1, MAX_SUPPORTS)
        to_supports = state[:, self._supports] - object_position
        offsets = _PER_METRE * torch.cat([to_goal, to_supports], dim=1)
        return torch.cat([*entries.values(), offsets], dim=1).clamp(-_LARGEST, _LARGEST)
