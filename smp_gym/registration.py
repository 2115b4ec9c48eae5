"""The table of environment ids, and their registration with Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import gymnasium
from gymnasium.envs.registration import WrapperSpec

from smp_gym.observation import MAX_EPISODE_STEPS
from smp_gym.tasks.definition import TaskDefinition
from smp_gym.tasks.registry import add_task, task_definitions

__all__ = [
    "ENVIRONMENTS",
    "Registration",
    "environment_id",
    "register_envs",
    "register_task",
    "task_of",
]

_ENTRY_POINT = "smp_gym.env:ManipulationEnv"
_EPISODE_LIMIT = WrapperSpec("EpisodeLimit", "smp_gym.limit:EpisodeLimit", {})


@dataclass(frozen=True)
class Registration:
    """One environment id.

    Attributes:
        id: what `gymnasium.make` is called with.
        task: name of the task, one of `smp_gym.tasks.task_names`.
        reward: "sparse" or "dense".
    """

    id: str
    task: str
    reward: str


_SUFFIXES = {"sparse": "", "dense": "Dense"}


def environment_id(task: str, reward: str = "sparse", version: int = 0) -> str:
    """Return the Gymnasium id of a task with the "sparse" or the "dense" reward."""
    return f"smp_gym/{task}{_SUFFIXES[reward]}-v{version}"


def task_of(id: str) -> str:
    """Return the task of an environment id.

    Raises:
        ValueError: no such id.
    """
    for entry in ENVIRONMENTS:
        if entry.id == id:
            return entry.task
    raise ValueError(f"id must be one of {', '.join(e.id for e in ENVIRONMENTS)}; got {id!r}")


def _ids(tasks: Iterable[TaskDefinition]) -> tuple[Registration, ...]:
    return tuple(
        Registration(environment_id(task.name, reward, task.version), task.name, reward)
        for task in tasks
        for reward in _SUFFIXES
    )


ENVIRONMENTS = _ids(task_definitions())
"""All ids: each task that ships with the package with a sparse and with a dense reward."""


def register_task(task: TaskDefinition) -> None:
    """Make a task that does not ship with the package known, with its ids as in `ENVIRONMENTS`.

    Raises:
        ValueError: another task has its name.
    """
    add_task(task)
    register_envs(_ids([task]))


def register_envs(environments: Iterable[Registration] = ENVIRONMENTS) -> None:
    """Make ids known to Gymnasium; ids that it knows already stay as they are."""
    for entry in environments:
        if entry.id not in gymnasium.registry:
            gymnasium.register(
                id=entry.id,
                entry_point=_ENTRY_POINT,
                kwargs={"task": entry.task, "reward": entry.reward},
                max_episode_steps=MAX_EPISODE_STEPS,
                additional_wrappers=(_EPISODE_LIMIT,),
            )
