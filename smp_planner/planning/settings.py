"""Settings of the planning pipeline: the prior that is learned, and the costs it is adapted to."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from smp_planner.strict_settings import StrictSettings

__all__ = ["MOST_PARTICLES", "PlanSettings", "PriorSettings"]

MOST_PARTICLES = 10_000
"""Particles of a plan at most: what they cost each other grows with the square."""

_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class PriorSettings(StrictSettings):
    """Settings of learning a primitive from demonstrations.

    Lengths are rad for a robot, or m of its prismatic joints, and extents of the demonstrations for
    paths in the plane or in space (`smp_planner.library.frame`).

    Attributes:
        smooth_std: standard deviation added to what demonstrations teach, to all coordinates the
            same number, each in its unit, or a number for each; see `ProMP.fit`.
        smooth_length_scale: of that addition, l in phase. Trajectories come out smoother than their
            weights: away from the ends as if it were sqrt(l^2 + 2 / (K - 3)^2).
        basis_functions: K of the primitive, 1 / (K - 3) of the phase apart.
        modes: how many groups the demonstrations fall into; None lets them decide
            (`demonstrated_modes`).
        nan_is_missing: whether NaN stands for a number that was not measured; see `ProMP.fit`.
        per_component: whether each mode of the demonstrations is a component of the prior that is
            adapted on its own, with its share of the particles; if not, one Gaussian is learned
            from all of them, as the paper's baselines have it.
    """

    smooth_std: _Positive | Annotated[tuple[_Positive, ...], Field(min_length=1)] = 0.2
    smooth_length_scale: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    basis_functions: int = Field(default=15, ge=4, le=1000)
    modes: int | None = Field(default=None, ge=1)
    nan_is_missing: bool = False
    per_component: bool = True


class PlanSettings(StrictSettings):
    """Map, costs and number of tries of a plan.

    Lengths are m for a robot, and extents for paths in the plane or in space.

    Attributes:
        particles: P, size of the set.
        samples: T of the trajectories in a plan.
        map: "exact" takes the obstacles themselves; "shapes" composes networks trained once per
            obstacle shape; "points" trains one network from labelled points of the scene, the
            paper's method (Eq. (12)), which takes seconds.
        map_points: how many points "points" learns from.
        map_steps: of that training.
        planning_steps: steps of phase at which costs are evaluated.
        obstacle_weight: λ of Eq. (12), for sums scaled to `costs.REFERENCE_STEPS` steps.
        self_collision_weight: λ of the same cost between a robot's own links.
        margin: by which spheres are enlarged while planning.
        edge_width: width of the map's edge in the first and the last iteration.
        sigma: tails of the boxes of goals and via-points, Eq. (13) and (14); what misses its place
            by no more has reached it.
        modulation: "exact" conditions the primitive in closed form on what the constraints allow,
            before costs narrow it down; "likelihood" leaves all to the costs, as in the paper.
        via_share: half width of the box around a tool's via-point, as a share of its tolerance.
        velocity_weight: of the excess over the joint velocity limits.
        limit_weight: of the excess over the joint limits.
        duration_limit: s, within which an executable trajectory must be feasible.
        forecast_horizon: s, for which obstacles that move are taken to go on as they were observed;
            then they are taken to stay. With 0 they are taken to stand where they are.
        forecast_growth: m by which such an obstacle is enlarged for each metre that it is expected
            to have gone.
        forecast_margin: m, least and greatest margin of such an obstacle.
        widths: factors, at least 1, of the prior's added deviation, ascending: the prior is a
            mixture of primitives, of one for each width, of equal shares. A narrow one keeps near
            to the demonstrations, a wide one gets around what they never met.
        retries: how often a problem without a good particle is tried again, with more particles or
            a wider prior, see `smp_planner.planning.tries`.
    """

    particles: int = Field(default=42, ge=1, le=MOST_PARTICLES)
    samples: int = Field(default=200, ge=2, le=10_000)
    map: Literal["exact", "shapes", "points"] = "shapes"
    map_points: int = Field(default=100_000, ge=100, le=10_000_000)
    map_steps: int = Field(default=5000, ge=1)
    planning_steps: int = Field(default=50, ge=10, le=10_000)
    obstacle_weight: float = Field(default=3.0, gt=0.0, allow_inf_nan=False)
    self_collision_weight: float = Field(default=3.0, ge=0.0, allow_inf_nan=False)
    margin: float = Field(default=0.01, ge=0.0, allow_inf_nan=False)
    edge_width: tuple[_Positive, _Positive] = (0.05, 0.01)
    sigma: float = Field(default=0.005, gt=0.0, allow_inf_nan=False)
    modulation: Literal["exact", "likelihood"] = "exact"
    via_share: float = Field(default=0.5, ge=0.0, le=1.0)
    velocity_weight: float = Field(default=10.0, ge=0.0, allow_inf_nan=False)
    limit_weight: float = Field(default=3000.0, ge=0.0, allow_inf_nan=False)
    duration_limit: float = Field(default=15.0, gt=0.0, allow_inf_nan=False)
    forecast_horizon: float = Field(default=2.0, ge=0.0, allow_inf_nan=False)
    forecast_growth: float = Field(default=0.2, ge=0.0, allow_inf_nan=False)
    forecast_margin: tuple[_NotNegative, _NotNegative] = (0.01, 0.05)
    widths: tuple[float, ...] = (1.0,)
    retries: int = Field(default=2, ge=0)

    @field_validator("widths")
    @classmethod
    def _ascending(cls, widths: tuple[float, ...]) -> tuple[float, ...]:
        if not (widths and widths[0] >= 1.0 and np.isfinite(widths).all()):
            raise ValueError(f"widths must be finite numbers of at least 1, got {widths}")
        if any(b <= a for a, b in pairwise(widths)):
            raise ValueError(f"widths must ascend, got {widths}")
        return widths
