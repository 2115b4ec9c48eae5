"""Settings of plans for the user's own paths and robots."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from smp_planner.planning.settings import PlanSettings

__all__ = ["JOINT_SMOOTH_STD", "PATH_SMOOTH_STD", "SLIDE_SMOOTH_SHARE", "AdaptSettings"]

PATH_SMOOTH_STD = 0.1
"""Extents, standard deviation added to paths beside what the demonstrations teach."""

JOINT_SMOOTH_STD = 0.2
"""rad, likewise for the joints of a robot; m of prismatic ones, at most `SLIDE_SMOOTH_SHARE`."""

SLIDE_SMOOTH_SHARE = 0.1
"""Of the range of a prismatic joint: a rail of metres and a stroke of centimetres have no unit in
which one number would do for both."""


class AdaptSettings(PlanSettings):
    """`PlanSettings` with defaults for the user's own data: exact map, larger λ.

    An extent, the unit of lengths but for robots, is the longest side of the box around all
    demonstrations. λ is for sums scaled to `scene.REFERENCE_SPHERES` spheres of a robot.
    """

    map: Literal["exact", "shapes", "points"] = "exact"
    map_points: int = Field(default=20_000, ge=100, le=10_000_000)
    map_steps: int = Field(default=2000, ge=1)
    obstacle_weight: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
