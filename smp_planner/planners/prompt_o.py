"""`prompt_o`: draws optimised one by one, and the mean moved to theirs. The baseline ProMPT-O."""

from __future__ import annotations

from pydantic import Field

from smp_planner.adaptation import OptimisedMean
from smp_planner.planners.baseline import BaselinePlanner, BaselineSettings

__all__ = ["ProMPTOPlanner", "ProMPTOSettings"]


class ProMPTOSettings(OptimisedMean, BaselineSettings):
    """Settings of ProMPT-O.

    Attributes:
        obstacle_weight: see `LikelihoodSettings`; more than usual, because only the mean gives way,
            and draws around it that keep the prior's spread need room.
    """

    obstacle_weight: float = Field(default=10.0, gt=0.0)


class ProMPTOPlanner(BaselinePlanner):
    """Draws with the prior's spread around the mean of optimised draws."""

    name = "prompt_o"
    Settings = ProMPTOSettings
