"""DoubleSidedPlacement: set the object down on either of two pads."""

from smp_gym.tasks.definition import TaskDefinition

__all__ = ["TASK"]

TASK = TaskDefinition("DoubleSidedPlacement", package=__name__)
