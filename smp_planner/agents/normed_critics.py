"""An ensemble of critics with layer normalisation, as a policy of stable-baselines3's SAC.

Ball et al. 2023, "Efficient Online Reinforcement Learning with Offline Data": normalised layers
bound what a critic can make of actions that nobody has tried, and so keep it from overestimating
them. A random pair of the ensemble gives the target, as in Chen et al. 2021, "Randomized Ensembled
Double Q-Learning".
"""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.normed_critics")

from typing import Any

from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.sac.policies import MultiInputPolicy
from torch import nn

__all__ = ["NormedCritics", "NormedCriticsPolicy"]


class NormedCritics(ContinuousCritic):
    """Critics whose hidden layers are normalised before their activation.

    Args:
        named: arguments of `ContinuousCritic`, by name.
    """

    def __init__(self, **named: Any) -> None:
        super().__init__(**named)
        for index, plain in enumerate(self.q_networks):
            first = next(plain.children())
            assert isinstance(first, nn.Linear)
            layers = create_mlp(
                first.in_features,
                1,
                named["net_arch"],
                named["activation_fn"],
                post_linear_modules=[nn.LayerNorm],
            )
            self.q_networks[index] = nn.Sequential(*layers)
            setattr(self, f"qf{index}", self.q_networks[index])


class NormedCriticsPolicy(MultiInputPolicy):
    """The policy of SAC for observations that are a `Dict`, with `NormedCritics`."""

    def make_critic(
        self, features_extractor: BaseFeaturesExtractor | None = None
    ) -> ContinuousCritic:
        """Return the critics, untrained."""
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return NormedCritics(**arguments).to(self.device)
