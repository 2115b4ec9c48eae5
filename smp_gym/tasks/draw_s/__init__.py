"""DrawS: draw an S in the air with a pen."""

from smp_gym.tasks.definition import TaskDefinition

__all__ = ["TASK"]

TASK = TaskDefinition("DrawS", package=__name__)
