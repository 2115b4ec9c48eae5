"""The registry of tasks, by name.

Nothing is imported here but the light definitions, and these only when they are asked for: scenes
and observations look up their task here, and the tasks are made of scenes.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module

from smp_gym.arrays import shown
from smp_gym.tasks.definition import Task, TaskDefinition

__all__ = [
    "add_task",
    "make_task",
    "task_definition",
    "task_definitions",
    "task_families",
    "task_names",
]

_FOLDERS = (
    "placement",
    "double_sided_placement",
    "draw_s",
    "push_lift_box",
)
"""Folders of the tasks that ship with the package."""


@cache
def _known() -> dict[str, TaskDefinition]:
    shipped = (import_module(f"smp_gym.tasks.{folder}").TASK for folder in _FOLDERS)
    return {task.name: task for task in shipped}


def task_definitions() -> tuple[TaskDefinition, ...]:
    """Return the definitions of all tasks."""
    return tuple(_known().values())


def task_names() -> tuple[str, ...]:
    """Return the names of all tasks, as they stand in the environment ids."""
    return tuple(_known())


def task_definition(name: str) -> TaskDefinition:
    """Return the definition of a task.

    Raises:
        ValueError: no such task.
    """
    known = _known()
    if name not in known:
        raise ValueError(f"task must be one of {', '.join(known)}; got {shown(name)}")
    return known[name]


def task_families(name: str) -> tuple[str, ...]:
    """Return the families of scenes that there are of a task; see `smp_gym.scene.FAMILIES`.

    Raises:
        ValueError: no such task.
    """
    return task_definition(name).sampler.names


def make_task(name: str) -> Task:
    """Return the rules of a task.

    Raises:
        ValueError: no such task.
    """
    return task_definition(name).rules


def add_task(task: TaskDefinition) -> None:
    """Make a task known that does not ship with the package; see `smp_gym.register_task`.

    Raises:
        ValueError: another task has its name.
    """
    known = _known()
    if known.get(task.name, task) != task:
        raise ValueError(f"there is a task {task.name!r} already, in {known[task.name].package}")
    known[task.name] = task
