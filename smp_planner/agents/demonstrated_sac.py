"""SAC from demonstrations: a cloned actor, and critics that learn before it does.

Critics that know nothing drive a cloned actor to where they err most in its favour. So the actor
stays as it was cloned until they have learned what it is worth, and then learns more slowly than
they do. They are kept from overestimating as in Ball et al. 2023, "Efficient Online Reinforcement
Learning with Offline Data": normalised layers, an ensemble, several steps for one of the actor, no
entropy in their targets; and a target is never beyond the returns that there can be. The actor's
loss has its squared distance to what was shown (Fujimoto and Gu 2021, "A Minimalist Approach to
Offline Reinforcement Learning"). There is no hindsight: what succeeds is shown.
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.demonstrated_sac")

from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.utils import polyak_update

from smp_gym.env import FAILURE_REWARD, SUCCESS_REWARD
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

        The spread is that of what was shown with noise, so that something is left to explore. The
        learning rate falls to 0, so that what was cloned does not hang on the last steps.
        """
        assert self.demonstrations is not None
        optimiser = torch.optim.Adam(self.actor.parameters(), _CLONING_RATE)
        distribution: Any = self.actor.action_dist
        steps = self.demonstrations.cloning_steps
        for step in range(steps):
            optimiser.param_groups[0]["lr"] = _CLONING_RATE * (1.0 - step / steps)
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
        """Take steps of the critics, and one of the actor once it learns."""
        assert self.demonstrations is not None
        assert self.replay_buffer is not None
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        alone = self.num_timesteps < self.demonstrations.critic_decisions
        for _ in range(gradient_steps * (self.demonstrations.critic_steps if alone else 1)):
            batch: Any = self.replay_buffer.sample(batch_size)
            self._learn_values(batch)
            self._n_updates += 1
        if not alone:
            self._learn_to_act(batch)

    @torch.no_grad()
    def targets(self, batch: DictReplayBufferSamples) -> torch.Tensor:
        """Return targets (B, 1) of the critics, within the returns that there can be."""
        actions = self.actor(batch.next_observations)
        values = torch.cat(self.critic_target(batch.next_observations, actions), dim=1)
        pair = values[:, torch.randperm(values.shape[1])[:2]]
        value = pair.amin(dim=1, keepdim=True).clamp(FAILURE_REWARD, SUCCESS_REWARD)
        return batch.rewards + (1.0 - batch.dones) * self.gamma * value

    def _learn_values(self, batch: DictReplayBufferSamples) -> None:
        target = self.targets(batch)
        found = torch.cat(self.critic(batch.observations, batch.actions), dim=1)
        loss = (found - target).square().mean(dim=0).sum()
        self.critic.optimizer.zero_grad()
        loss.backward()
        self.critic.optimizer.step()
        polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)

    def _learn_to_act(self, batch: DictReplayBufferSamples) -> None:
        assert self.demonstrations is not None
        actions, log_density = self.actor.action_log_prob(batch.observations)
        values = torch.cat(self.critic(batch.observations, actions), dim=1)
        loss = (self.ent_coef_tensor * log_density - values.amin(dim=1)).mean()
        if self.demonstrations.pull:
            shown = self._shown()
            off = self.actor(shown.observations, deterministic=True) - shown.actions
            loss = loss + self.demonstrations.pull * off.square().mean()
        self.actor.optimizer.zero_grad()
        loss.backward()
        self.actor.optimizer.step()

    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        assert self.demonstrations is not None
        for group in self.actor.optimizer.param_groups:
            group["lr"] *= self.demonstrations.actor_rate

    def _shown(self) -> DictReplayBufferSamples:
        assert isinstance(self.replay_buffer, ShownReplayBuffer)
        return self.replay_buffer.shown_batch(_BATCH)
