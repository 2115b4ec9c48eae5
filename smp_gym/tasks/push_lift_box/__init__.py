"""PushLiftBox: push a box, grasp it and lift it."""

from smp_gym.tasks.definition import TaskDefinition

__all__ = ["TASK"]

TASK = TaskDefinition("PushLiftBox", package=__name__)
