"""Placement: carry an object into a bin."""

from smp_gym.tasks.definition import TaskDefinition

__all__ = ["TASK"]

TASK = TaskDefinition("Placement", package=__name__)
