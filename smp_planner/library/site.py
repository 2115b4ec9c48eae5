"""Sites: what a path shall be near to at one phase, as cost and as condition, Eq. (13) and (14)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from smp_planner.collision.costs import GoalCost
from smp_planner.collision.robot_model import RobotModel
from smp_planner.library.mover import ValueAndGradient
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.box_prior import SmoothBox
from smp_planner.planners.tying import tie_to_goals
from smp_planner.planning.problem import GoalRegion

__all__ = ["Place", "PlaceSite", "Site", "ToolSite"]

FloatArray = NDArray[np.float64]

TOLERANCE_STDS = 3.0
"""Standard deviations of the conditioned primitive that a via-point's tolerance is."""

_CERTAIN = 1e-6
"""Extents, standard deviation that evidence is computed with where a primitive has none."""

_ROUNDING = 1e-9
"""Extents by which a point may be missed that was met."""


class Site(Protocol):
    """What a path shall be near to at one phase; any of its places will do."""

    @property
    def name(self) -> str:
        """What the user calls it."""
        ...

    @property
    def phase(self) -> float:
        """In [0, 1]."""
        ...

    def missed(self, points: FloatArray) -> FloatArray:
        """Return by how much (P,) points (P, D) miss it."""
        ...

    def cost(self, points: FloatArray) -> ValueAndGradient:
        """Return C_mod (P,) of points (P, D), and its gradient (P, D)."""
        ...

    def condition(self, primitive: ProMP) -> list[tuple[ProMP, float]]:
        """Return the posterior for each place with its log-evidence."""
        ...


@dataclass(frozen=True, eq=False)
class Place:
    """One option of a `PlaceSite`, in normalised coordinates.

    Attributes:
        box: where the cost is zero, and its tails.
        point: (D,) to be passed; None for a box.
        tolerance: distance from the point that may remain.
        share: π_h.
    """

    box: SmoothBox
    point: FloatArray | None
    tolerance: float
    share: float

    def missed(self, points: FloatArray) -> FloatArray:
        """Return by how much (...) points (..., D) miss the place; 0 if they do not."""
        if self.point is None:
            outside = self.box.distance(torch.from_numpy(np.ascontiguousarray(points))).numpy()
            return np.asarray(np.linalg.norm(outside, axis=-1))
        distance = np.linalg.norm(points - self.point, axis=-1)
        return np.where(distance <= self.tolerance + _ROUNDING, 0.0, distance - self.tolerance)

    def condition(self, primitive: ProMP, phase: float) -> tuple[ProMP, float]:
        """Return the posterior after the place was observed, and the log of share and density.

        A box is observed as the Gaussian that has its moments: its middle, a third of its squared
        half extents and the variance of its tails.
        """
        if self.point is None:
            value = (self.box.lower + self.box.upper) / 2
            noise = ((self.box.upper - self.box.lower) / 2).square() / 3 + self.box.variance
        else:
            value = torch.from_numpy(self.point)
            noise = torch.full_like(value, (self.tolerance / TOLERANCE_STDS) ** 2)
        mean, covariance = primitive.marginal(phase)
        density = torch.distributions.MultivariateNormal(
            mean, covariance + torch.diag(noise + _CERTAIN**2)
        )
        evidence = math.log(self.share) + float(density.log_prob(value))
        return primitive.condition(phase, value, noise), evidence


@dataclass(frozen=True, eq=False)
class PlaceSite:
    """Places in the coordinates of the path.

    Attributes:
        name: what the user calls it.
        phase: in [0, 1].
        places: at least one.
    """

    name: str
    phase: float
    places: tuple[Place, ...]

    def missed(self, points: FloatArray) -> FloatArray:
        """Return by how much (P,) points (P, D) miss the nearest place."""
        return np.asarray(np.min([place.missed(points) for place in self.places], axis=0))

    def cost(self, points: FloatArray) -> ValueAndGradient:
        """Return C_mod (P,) of points (P, D), and its gradient (P, D).

        Of one place it is d² / (2 σ²), Eq. (14); of several, -log Σ π_h exp(-d_h² / (2 σ_h²)) / Z_h
        with the normalising constants Z_h relative to the least of them, so that it is log(H) or
        less inside the narrowest of places of equal shares.
        """
        at = torch.from_numpy(np.ascontiguousarray(points))
        boxes = [place.box for place in self.places]
        outside = torch.stack([box.distance(at) for box in boxes])
        variance = torch.stack([box.variance for box in boxes])[:, None]
        widths = torch.stack([box.upper - box.lower for box in boxes])
        spread = (widths + (2.0 * math.pi * variance[:, 0]).sqrt()).log().sum(-1)
        shares = torch.tensor([place.share for place in self.places], dtype=at.dtype)
        logits = -0.5 * (outside.square() / variance).sum(-1)
        logits = logits + (shares.log() - (spread - spread.min()))[:, None]
        membership = torch.softmax(logits, dim=0)
        gradient = (membership[..., None] * outside / variance).sum(0)
        return -torch.logsumexp(logits, dim=0).numpy(), gradient.numpy()

    def condition(self, primitive: ProMP) -> list[tuple[ProMP, float]]:
        """Return the posterior for each place with its log-evidence."""
        return [place.condition(primitive, self.phase) for place in self.places]


@dataclass(frozen=True, eq=False)
class ToolSite:
    """Regions of which a robot's tool shall be in one when the path ends.

    Attributes:
        goals: at least one region.
        shares: π_h of each.
        robot: whose tool it is.
        sigma: m, tails of the regions.
    """

    goals: tuple[GoalRegion, ...]
    shares: tuple[float, ...]
    robot: RobotModel
    sigma: float
    name: str = "goal"
    phase: float = 1.0

    def missed(self, points: FloatArray) -> FloatArray:
        """Return the distance (P,) m of the tool to the nearest region, at (P, n) rad."""
        errors = []
        for goal in self.goals:
            at = self.robot.carried_points(points, goal.point)[0]
            errors.append(np.linalg.norm(at - np.clip(at, goal.lower, goal.upper), axis=-1))
        return np.asarray(np.min(errors, axis=0))

    def cost(self, points: FloatArray) -> ValueAndGradient:
        """Return C_mod (P,) at configurations (P, n), and its gradient (P, n)."""
        cost = GoalCost(self.robot, self.goals, self.sigma, self.shares)
        value, gradient = cost(points[:, None])
        return value, gradient[:, -1]

    def condition(self, primitive: ProMP) -> list[tuple[ProMP, float]]:
        """Return the primitive tied to the likeliest posture that reaches a region.

        Raises:
            UnreachableError: no region is reached.
        """
        return [(tie_to_goals(primitive, self.goals, self.robot).primitive, 0.0)]
