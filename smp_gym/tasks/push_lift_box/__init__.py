"""PushLiftBox: push a box, grasp it on the way and lift it."""

from smp_gym.tasks.definition import TaskDefinition

__all__ = ["TASK"]

TASK = TaskDefinition("PushLiftBox", package=__name__)
