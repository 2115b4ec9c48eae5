"""Decisions that last several environment steps, in training and in acting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium

from smp_gym.rollout import Policy

__all__ = ["ACTION_REPEAT", "CPU_SECONDS", "ActionRepeat", "HeldActions", "acting"]


ACTION_REPEAT = "action_repeat"
"""Attribute of an agent, in its file too: environment steps that a decision lasts."""

CPU_SECONDS = "cpu_seconds"
"""Attribute of an agent, in its file too: processor time of its training, evaluations included."""

_PREVIOUS = "previous_achieved_goal"


class ActionRepeat(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper in which every action is taken several times, or until the episode ends.

    At 20 decisions a second, random exploration stays where it is; at 4 it gets somewhere. Rewards
    are summed (the sparse reward is given in the last step of an episode only), and the goal
    achieved before, of the dense reward, is that before the first of the steps.

    Args:
        env: to be wrapped.
        times: that an action is taken.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], times: int) -> None:
        super().__init__(env)
        self._times = times

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take an action; return what the last step returned, and the sum of the rewards."""
        total, first = 0.0, None
        for _ in range(self._times):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            first = info.get(_PREVIOUS) if first is None else first
            if terminated or truncated:
                break
        if first is not None:
            info = {**info, _PREVIOUS: first}
        return observation, total, terminated, truncated, info


class _Held(NamedTuple):
    action: Any
    left: int
    state: Any


@dataclass(frozen=True)
class HeldActions:
    """A policy that decides in every so many steps, and holds its action in between.

    In an environment it does what the policy does in `ActionRepeat` of it.

    Attributes:
        policy: decides.
        times: environment steps that a decision lasts.
    """

    policy: Policy
    times: int

    def predict(
        self,
        observation: Any,
        state: _Held | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, _Held]:
        """Return an action of one episode, and what is held as the state."""
        if state is not None and state.left > 0:
            return state.action, state._replace(left=state.left - 1)
        inner = None if state is None else state.state
        action, inner = self.policy.predict(observation, inner, episode_start, deterministic)
        return action, _Held(action, self.times - 1, inner)


def acting(agent: Policy) -> Policy:
    """Return a policy that acts in every environment step as an agent decides, see `ACTION_REPEAT`.

    Raises:
        ValueError: the agent's decisions do not last a whole number of steps, at least one.
    """
    times = getattr(agent, ACTION_REPEAT, 1)
    if not isinstance(times, int) or times < 1:
        raise ValueError(f"{ACTION_REPEAT} of an agent must be at least 1, got {times!r}")
    return HeldActions(agent, times) if times > 1 else agent
