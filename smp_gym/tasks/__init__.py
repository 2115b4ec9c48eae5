"""The tasks: goals, success and scenes of episodes, without a physics engine; a folder for each.

A task's folder holds four files. ``__init__`` exports ``TASK``, a light
`smp_gym.tasks.definition.TaskDefinition`; ``rules`` exports ``RULES``: goals, success, reward,
contacts; ``scenes`` exports ``SAMPLER``, which draws its scenes; ``demonstrator`` exports
``demonstrate``, which records its demonstrations. `smp_gym.tasks.registry` lists the folders.
"""

from smp_gym.tasks.definition import Task, TaskDefinition
from smp_gym.tasks.registry import make_task, task_definition, task_names
from smp_gym.tasks.status import Status

__all__ = ["Status", "Task", "TaskDefinition", "make_task", "task_definition", "task_names"]
