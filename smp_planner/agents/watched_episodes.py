"""Episodes of a planner's policy as decisions of several control steps, to be learned from.

A planner's policy acts in every step of the control; an agent's decision lasts several. What an
agent learns as a decision is the mean of the actions in its steps: they are rates, so held it comes
to the same joint angles.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from smp_gym.rollout import Moment, Policy, rollout
from smp_gym.sampling import sample_scene

__all__ = ["decision_actions", "watched"]


def watched(
    env: gymnasium.Env[Any, Any], policy: Policy, task: str, difficulty: str, seed: int
) -> list[Moment] | None:
    """Return the moments of an episode in a scene that nobody selected; None if it fails.

    Args:
        env: of the task, in which an action lasts one step.
        policy: acts.
        task: name of the task.
        difficulty: of the scene.
        seed: of the scene.
    """
    moments: list[Moment] = []
    scene = sample_scene(task, difficulty, seed)
    success = rollout(env, policy, scene=scene, recorders=[moments.append]).success
    return moments if success else None


def decision_actions(actions: NDArray[np.float32], repeat: int) -> NDArray[np.float32]:
    """Return the action (T, 7) of the decision that begins at each step of an episode.

    Args:
        actions: (T, 7), one a step.
        repeat: steps that a decision lasts; those that begin near the end last until the end.
    """
    means = [actions[first : first + repeat].mean(axis=0) for first in range(len(actions))]
    return np.stack(means).astype(np.float32)
