"""The table of environment ids, and their registration with Gymnasium."""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium

from smp_gym.observation import MAX_EPISODE_STEPS
from smp_gym.scene import TASKS

__all__ = ["ENVIRONMENTS", "Registration", "environment_id", "register_envs"]

_ENTRY_POINT = "smp_gym.env:ManipulationEnv"


@dataclass(frozen=True)
class Registration:
    """One environment id.

    Attributes:
        id: what `gymnasium.make` is called with.
        task: name of the task, one of `smp_gym.scene.TASKS`.
        reward: "sparse" or "dense".
    """

    id: str
    task: str
    reward: str


_SUFFIXES = {"sparse": "", "dense": "Dense"}


def environment_id(task: str, reward: str = "sparse") -> str:
    """Return the Gymnasium id of a task with the "sparse" or the "dense" reward."""
    return f"smp_gym/{task}{_SUFFIXES[reward]}-v0"


ENVIRONMENTS = tuple(
    Registration(id=environment_id(task, reward), task=task, reward=reward)
    for task in TASKS
    for reward in _SUFFIXES
)
"""All ids: each task with a sparse and with a dense reward."""


def register_envs() -> None:
    """Make all ids known to Gymnasium; ids that it knows already stay as they are."""
    for entry in ENVIRONMENTS:
        if entry.id not in gymnasium.registry:
            gymnasium.register(
                id=entry.id,
                entry_point=_ENTRY_POINT,
                kwargs={"task": entry.task, "reward": entry.reward},
                max_episode_steps=MAX_EPISODE_STEPS,
            )
