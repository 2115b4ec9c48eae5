"""SAC that begins with what was shown: a cloned actor, and a critic that learns before it does.

A critic that knows nothing drives a cloned actor to where it errs most in its favour, and all that
was cloned is lost within a hundred decisions. So the actor stays as it was cloned until the critic
has learned what it is worth, and later takes, beside each step of SAC, one towards what was shown
(the weights of Fujimoto and Gu 2021, "A Minimalist Approach to Offline Reinforcement Learning", are
of the same order).
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.demonstrated_sac")

from typing import Any

import torch
from stable_baselines3 import SAC
from torch import Tensor

from smp_planner.agents.hyper_parameters import DemonstrationSettings
from smp_planner.agents.shown_decisions import ShownReplayBuffer

__all__ = ["DemonstratedSAC"]

_BATCH = 256
_CLONING_RATE = 1e-3
_LARGEST = 0.97
"""Rate that is cloned: greater ones are at the ends of the range, where the density has none."""


class DemonstratedSAC(SAC):
    """SAC whose replay buffer is a `ShownReplayBuffer`; once it is trained, an agent of SAC.

    Args:
        arguments: of SAC.
        demonstrations: how it learns from what is shown; None if it is loaded from a file.
        named: arguments of SAC, by name.
    """

    def __init__(
        self, *arguments: Any, demonstrations: DemonstrationSettings | None = None, **named: Any
    ) -> None:
        self.demonstrations = demonstrations
        super().__init__(*arguments, **named)

    def clone(self) -> float:
        """Teach the actor what was shown, mean and spread; return the loss in the end.

        The spread is that of what was shown with noise, so that something is left to explore.
        """
        assert self.demonstrations is not None
        loss = torch.zeros(())
        optimiser = torch.optim.Adam(self.actor.parameters(), _CLONING_RATE)
        distribution: Any = self.actor.action_dist
        for _ in range(self.demonstrations.cloning_steps):
            seen, actions = self._shown()
            noise = self.demonstrations.noise * torch.randn(actions.shape)
            mean, log_std, _ = self.actor.get_action_dist_params(seen)
            found = distribution.proba_distribution(mean, log_std)
            loss = -found.log_prob((actions + noise).clamp(-_LARGEST, _LARGEST)).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        return float(loss.detach())

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Take steps of the gradient, and as many towards what was shown."""
        super().train(gradient_steps, batch_size)
        assert self.demonstrations is not None
        if self._warm() or not self.demonstrations.pull:
            return
        for _ in range(gradient_steps):
            seen, actions = self._shown()
            found = self.actor(seen, deterministic=True)
            loss = self.demonstrations.pull * (found - actions).square().mean()
            self.actor.optimizer.zero_grad()
            loss.backward()
            self.actor.optimizer.step()

    def _warm(self) -> bool:
        """Return whether the critic alone learns."""
        assert self.demonstrations is not None
        return self.num_timesteps < self.demonstrations.critic_decisions

    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        if self._warm():
            for group in self.actor.optimizer.param_groups:
                group["lr"] = 0.0

    def _shown(self) -> tuple[dict[str, Tensor], Tensor]:
        """Return observations and actions of a batch of what was shown."""
        assert isinstance(self.replay_buffer, ShownReplayBuffer)
        return self.replay_buffer.shown_batch(_BATCH)
