"""Exploration of agents beyond that of their own policy."""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.exploration")

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.noise import ActionNoise

__all__ = ["GripperOpenings"]


class GripperOpenings(ActionNoise):
    """Noise of exploration that opens the hand now and then, for long enough to let go.

    An object that is dropped ends an episode with failure, so an agent soon stops opening the hand,
    long before it has learned to be over a bin; only there it can learn that letting go is good.

    Args:
        probability: that an opening begins with a decision.
        decisions: that it lasts.
        seed: of the generator.
    """

    def __init__(self, probability: float, decisions: int, seed: int) -> None:
        super().__init__()
        self._probability, self._decisions = probability, decisions
        self._generator = np.random.default_rng(seed)
        self._left = 0

    def reset(self) -> None:
        """End an opening: the episode has ended."""
        self._left = 0

    def __call__(self) -> NDArray[np.float32]:
        """Return what is added to a decision (7,): -2, full opening whatever the agent wants."""
        noise = np.zeros(7, np.float32)
        if self._left == 0 and self._generator.random() < self._probability:
            self._left = self._decisions
        if self._left > 0:
            self._left -= 1
            noise[6] = -2.0
        return noise
