"""Environments of a process, for experiments that take the scenes of a task in a row."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import gymnasium

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.scene import TASKS

__all__ = ["environment"]


@lru_cache(maxsize=len(TASKS))
def environment(task: str, difficulty: str) -> gymnasium.Env[Any, Any]:
    """Return the environment of a task and a difficulty, made once."""
    return gymnasium.make(environment_id(task), difficulty=difficulty)
