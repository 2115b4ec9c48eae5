"""`cpromp`: Gaussian variational inference over the weights. The baseline CProMPs."""

from __future__ import annotations

from smp_planner.adaptation import GaussianVI
from smp_planner.planners.baseline import BaselinePlanner, BaselineSettings

__all__ = ["CProMPPlanner", "CProMPSettings"]


class CProMPSettings(GaussianVI, BaselineSettings):
    """Settings of CProMPs."""


class CProMPPlanner(BaselinePlanner):
    """Draws from the Gaussian that is nearest to the posterior."""

    name = "cpromp"
    Settings = CProMPSettings
