"""What the planners of the paper's baselines share: one Gaussian, of all ways or of each."""

from __future__ import annotations

from typing import ClassVar

import torch

from smp_planner.movement_primitives import ProMPMixture
from smp_planner.planners.adapting import AdaptingPlanner, AdaptingSettings
from smp_planner.planners.base import PlannerSettings

__all__ = ["BaselinePlanner", "BaselineSettings"]


class BaselineSettings(AdaptingSettings):
    """Settings of planners that keep one Gaussian over the weights.

    Attributes:
        per_component: with demonstrations that go more than one way, whether each component of
            their mixture is adapted on its own, with its share of the particles; if not, one
            Gaussian is learned from all of them, as the paper's baselines have it.
    """

    per_component: bool = True


class BaselinePlanner(AdaptingPlanner):
    """Draws from a Gaussian over the weights that was adapted to the scene.

    The standard normals that are carried to it are those of the control `promp`.
    """

    Settings: ClassVar[type[PlannerSettings]] = BaselineSettings
    settings: BaselineSettings

    def _learn_mixture(self) -> ProMPMixture:
        if self.settings.per_component:
            return super()._learn_mixture()
        return ProMPMixture((self.primitive,), torch.ones(1))
