"""SAC that begins with what was shown: a cloned actor, and a critic that learns before it does.

A critic that knows nothing drives a cloned actor to where it errs most in its favour, and all that
was cloned is lost within a hundred decisions. So the actor stays as it was cloned until the critic
has learned what it is worth, and then learns more slowly than it does, with a step towards what was
shown beside each step of SAC (as Fujimoto and Gu 2021, "A Minimalist Approach to Offline
Reinforcement Learning", add that to the loss). There is no hindsight: what succeeds is shown.
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.demonstrated_sac")

from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

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

    def clone(self) -> None:
        """Teach the actor what was shown, mean and spread.

        The spread is that of what was shown with noise, so that something is left to explore.
        """
        assert self.demonstrations is not None
        optimiser = torch.optim.Adam(self.actor.parameters(), _CLONING_RATE)
        distribution: Any = self.actor.action_dist
        for _ in range(self.demonstrations.cloning_steps):
            shown = self._shown()
            noise = self.demonstrations.noise * torch.randn(shown.actions.shape)
            actions = (shown.actions + noise).clamp(-_LARGEST, _LARGEST)
            mean, log_std, _ = self.actor.get_action_dist_params(shown.observations)
            found = distribution.proba_distribution(mean, log_std)
            loss = -found.log_prob(actions).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Take steps of the gradient, and as many towards what was shown once the actor learns."""
        assert self.demonstrations is not None
        if self._critic_alone():
            super().train(gradient_steps * self.demonstrations.critic_steps, batch_size)
            return
        super().train(gradient_steps, batch_size)
        for _ in range(gradient_steps if self.demonstrations.pull else 0):
            shown = self._shown()
            found = self.actor(shown.observations, deterministic=True)
            loss = self.demonstrations.pull * (found - shown.actions).square().mean()
            self.actor.optimizer.zero_grad()
            loss.backward()
            self.actor.optimizer.step()

    def _critic_alone(self) -> bool:
        assert self.demonstrations is not None
        return self.num_timesteps < self.demonstrations.critic_decisions

    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        assert self.demonstrations is not None
        share = 0.0 if self._critic_alone() else self.demonstrations.actor_rate
        for group in self.actor.optimizer.param_groups:
            group["lr"] *= share
        if self._critic_alone() and self.ent_coef_optimizer is not None:
            # Of an actor that stays as it is the weight of the entropy would fall without an end.
            for group in self.ent_coef_optimizer.param_groups:
                group["lr"] = 0.0

    def _shown(self) -> DictReplayBufferSamples:
        assert isinstance(self.replay_buffer, ShownReplayBuffer)
        return self.replay_buffer.shown_batch(_BATCH)
