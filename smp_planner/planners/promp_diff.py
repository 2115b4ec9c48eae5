"""`promp_diff`: the mean carried by a flow out of the obstacles. The baseline ProMPs-Diff."""

from __future__ import annotations

from pydantic import Field

from smp_planner.adaptation import Flow
from smp_planner.planners.baseline import BaselinePlanner, BaselineSettings

__all__ = ["ProMPDiffPlanner", "ProMPDiffSettings"]


class ProMPDiffSettings(Flow, BaselineSettings):
    """Settings of ProMPs-Diff.

    Attributes:
        margin: see `LikelihoodSettings`; more than usual, because the flow ends where the map
            does, and draws around the mean that keep the prior's spread need room.
        edge_width: see `LikelihoodSettings`; wider at first, for the same reason.
    """

    margin: float = Field(default=0.03, ge=0.0)
    edge_width: tuple[float, float] = (0.1, 0.01)


class ProMPDiffPlanner(BaselinePlanner):
    """Draws with the prior's spread around a mean that left the obstacles."""

    name = "promp_diff"
    Settings = ProMPDiffSettings
