"""What a primitive of one's own is adapted with; all lengths are in extents."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["JOINT_SMOOTH_STD", "SMOOTH_STD", "AdaptSettings", "FitSettings"]

SMOOTH_STD = 0.1
"""Extents, freedom that paths get beside what the demonstrations teach."""

JOINT_SMOOTH_STD = 0.2
"""rad, likewise for the joints of a robot."""


class FitSettings(BaseModel):
    """How a primitive is learned.

    An extent is the longest side of the box around all demonstrations; for a robot it is 1 rad.

    Attributes:
        smooth_std: extents, freedom added to what the demonstrations teach; see `ProMP.fit`. None
            takes `SMOOTH_STD`, and for a robot `JOINT_SMOOTH_STD`.
        smooth_length_scale: of that freedom, in phase.
        basis: K basis functions.
        modes: how many groups the demonstrations fall into; 1 forces one Gaussian, None lets them
            decide (`demonstrated_modes`).
        nan_is_missing: whether NaN stands for a number that was not measured; see `ProMP.fit`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    smooth_std: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    smooth_length_scale: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    basis: int = Field(default=15, ge=4)
    modes: int | None = Field(default=None, ge=1)
    nan_is_missing: bool = False


class AdaptSettings(BaseModel):
    """Map and costs of an adaptation.

    Attributes:
        map: "exact" asks bodies themselves; "neural" trains a network from labelled points of the
            scene, the paper's way (Eq. (12)), which takes seconds. Of a `PointCloud` a network is
            trained in any case, once.
        map_points: how many points a network learns from.
        map_steps: of its training.
        planning_steps: steps of phase at which costs are evaluated.
        samples: T of the trajectories that are returned.
        obstacle_weight: λ of Eq. (12), for sums scaled to `costs.REFERENCE_STEPS` steps, and for a
            robot to `chain.REFERENCE_SPHERES` spheres.
        margin: extents (m for a robot), by which spheres are enlarged while planning.
        edge_width: same unit, width of the map's edge in the first and the last iteration.
        sigma: extents (m for a tool), tails of boxes and standard deviation of points that are not
            conditioned on; what misses its place by no more has passed it.
        modulation: "exact" conditions the primitive in closed form on points and on the Gaussians
            of boxes, before costs narrow them down; "likelihood" leaves all to the costs, the
            paper's way (Eq. (13) and (14)).
        self_collision_weight: of a robot's spheres among each other.
        velocity_weight: of the excess over a robot's velocity limits.
        limit_weight: of the excess over a robot's joint limits.
        duration_limit: s, within which a robot's path must be feasible.
        retries: how often a scene without a good particle is tried again with twice the freedom.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    map: Literal["exact", "neural"] = "exact"
    map_points: int = Field(default=20_000, ge=100)
    map_steps: int = Field(default=2000, ge=1)
    planning_steps: int = Field(default=50, ge=10)
    samples: int = Field(default=200, ge=2)
    obstacle_weight: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
    margin: float = Field(default=0.01, ge=0.0, allow_inf_nan=False)
    edge_width: tuple[float, float] = (0.05, 0.01)
    sigma: float = Field(default=0.005, gt=0.0, allow_inf_nan=False)
    modulation: Literal["exact", "likelihood"] = "exact"
    self_collision_weight: float = Field(default=3.0, ge=0.0, allow_inf_nan=False)
    velocity_weight: float = Field(default=10.0, ge=0.0, allow_inf_nan=False)
    limit_weight: float = Field(default=100.0, ge=0.0, allow_inf_nan=False)
    duration_limit: float = Field(default=15.0, gt=0.0, allow_inf_nan=False)
    retries: int = Field(default=1, ge=0)
