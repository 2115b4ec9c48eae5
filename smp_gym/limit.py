"""The limit of an episode's steps, passed on from `TimeLimit` to the environment inside it."""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TimeLimit

from smp_gym.env import ManipulationEnv
from smp_gym.observation import LONGEST_LIMIT

__all__ = ["EpisodeLimit"]


class EpisodeLimit(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Tells a `ManipulationEnv` after how many steps the `TimeLimit` around it truncates.

    ``gymnasium.make(id, max_episode_steps=n)`` gives the limit to `TimeLimit` alone; the
    environment's observation and failures speak of it, too. The ids are registered with this
    wrapper. With ``max_episode_steps=-1``, which is without limit, the environment counts in
    `smp_gym.observation.LONGEST_LIMIT` steps.

    Args:
        env: an environment made of a `ManipulationEnv`.

    Raises:
        ValueError: the limit is not from 1 to `LONGEST_LIMIT`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, ManipulationEnv):
            raise ValueError(f"env must be made of a ManipulationEnv, got {type(inner).__name__}")
        inner.limit = _limit(env)


def _limit(env: gymnasium.Env[Any, Any]) -> int:
    """Return the limit of the outermost `TimeLimit`, `LONGEST_LIMIT` without one."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            return env._max_episode_steps
        env = env.env
    return LONGEST_LIMIT
