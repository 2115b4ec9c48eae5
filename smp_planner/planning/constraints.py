"""Constraints on trajectories: via-points, boxes, and choices of these, Eq. (13), (14).

Each constraint enters twice: in closed form, by conditioning the primitive, and through a cost
that pulls on what conditioning leaves open. Which points or boxes are options of one constraint is
a mixture, C_mod = -log Σ π_h N(Φ_t w; μ_h, Σ_h).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_planner.collision.costs import Cost, ValueAndGradient, check_trajectories
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.box_prior import SmoothBox, box_offset
from smp_planner.planning.settings import PlanSettings

__all__ = [
    "Constraint",
    "Exactly",
    "Passing",
    "Place",
    "at_phases",
    "mixture_cost",
    "mixture_weights",
    "segments",
    "spread_to_steps",
]

TOLERANCE_STDS = 3.0
"""Standard deviations of the conditioned primitive that a via-point's tolerance is."""

_LEAST_STD = 1e-6
"""Extents, standard deviation that evidence is computed with where a primitive has none."""

_ROUNDING = 1e-9
"""Extents by which a point may be missed that was met."""


class Constraint(Protocol):
    """Protocol of constraints on a trajectory at one or more phases."""

    @property
    def name(self) -> str:
        """Name by which the user calls it."""
        ...

    @property
    def phases(self) -> tuple[float, ...]:
        """Phases in [0, 1] at which it holds a trajectory."""
        ...

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior for each option that it leaves, with its log-evidence."""
        ...

    def cost(self, settings: PlanSettings) -> Cost | None:
        """Return its cost C_mod; None where conditioning is all."""
        ...

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the violation (P,) of trajectories (P, T, D), a distance; 0 if they satisfy it."""
        ...

    def slack(self, settings: PlanSettings) -> float:
        """Return the largest violation that still counts as satisfied."""
        ...


def segments(count: int, phases: ArrayLike) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the segments of `count` equal steps that phases (H,) lie on, and where on them."""
    at = np.atleast_1d(np.asarray(phases, np.float64)) * (count - 1)
    first = np.minimum(at.astype(np.int64), count - 2)
    return first, at - first


def at_phases(trajectories: FloatArray, phases: ArrayLike) -> FloatArray:
    """Return the points (P, H, D) of trajectories (P, T, D) at phases, straight between samples."""
    first, share = segments(trajectories.shape[1], phases)
    share = share[:, None]
    return np.asarray((1.0 - share) * trajectories[:, first] + share * trajectories[:, first + 1])


def spread_to_steps(gradient: FloatArray, phases: ArrayLike, steps: int) -> FloatArray:
    """Return the gradient (P, T, D) by the samples of one (P, H, D) by points at phases (H,)."""
    first, share = segments(steps, phases)
    shares = np.zeros((steps, len(first)))
    of_points = np.arange(len(first))
    shares[first, of_points] = 1.0 - share
    shares[first + 1, of_points] += share
    return np.asarray(shares @ gradient)


def mixture_weights(
    variance: FloatArray, widths: FloatArray, shares: Sequence[float]
) -> FloatArray:
    """Return log(π_h / Z_h) (H,) of `mixture_cost`, Z_h relative to the least of them."""
    volume = np.log(widths + np.sqrt(2.0 * math.pi * variance)).sum(axis=-1)
    return np.asarray(np.log(np.asarray(shares)) - (volume - volume.min()))


def mixture_cost(
    offsets: FloatArray, variance: FloatArray, widths: FloatArray, shares: Sequence[float]
) -> ValueAndGradient:
    """Return C_mod of a choice of boxes, and its gradients by the point of each.

    Of one box it is Σ d² / (2 σ²), Eq. (14), the reading that makes it the negative logarithm of
    Gaussian tails; of several, -log Σ π_h exp(-d_h² / (2 σ_h²)) / Z_h with the normalising
    constants Z_h relative to the least of them, so that it is log(H) or less inside the narrowest
    of boxes of equal shares.

    Args:
        offsets: (H, P, d) from `box_offset`, of H boxes.
        variance: (H, d) σ² of the tails.
        widths: (H, d) of the boxes.
        shares: π_h, H positive numbers that sum to one.

    Returns:
        (P,), and (H, P, d).
    """
    scaled = offsets / np.sqrt(variance)[:, None]
    joint = mixture_weights(variance, widths, shares)[:, None]
    joint = joint - 0.5 * np.square(scaled).sum(axis=-1)
    largest = joint.max(axis=0)
    membership = np.exp(joint - largest)
    total = membership.sum(axis=0)
    gradient = (membership / total)[..., None] * (offsets / variance[:, None])
    return -(largest + np.log(total)), gradient


@dataclass(frozen=True, eq=False)
class Exactly:
    """A position or a velocity that the trajectory has with certainty.

    Attributes:
        name: what it is called.
        phase: in [0, 1].
        value: (D,) position, or velocity with respect to phase.
        derivative: whether `value` is a velocity.
    """

    name: str
    phase: float
    value: FloatArray
    derivative: bool = False

    @property
    def phases(self) -> tuple[float, ...]:
        """Phase of the position or velocity."""
        return (self.phase,)

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior after an exact observation."""
        value = torch.from_numpy(self.value)
        return [(primitive.condition(self.phase, value, derivative=self.derivative), 0.0)]

    def cost(self, settings: PlanSettings) -> Cost | None:
        """Return None: conditioning is all."""
        return None

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) from the position; 0 for a velocity."""
        if self.derivative:
            return np.zeros(len(trajectories))
        there = at_phases(trajectories, self.phase)[:, 0]
        return np.asarray(np.linalg.norm(there - self.value, axis=-1))

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`."""
        return settings.sigma


@dataclass(frozen=True, eq=False)
class Place:
    """One option of `Passing`, in the coordinates of the path.

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
        """Return the distance (...) of points (..., D) to the place; 0 within it."""
        if self.point is None:
            outside = box_offset(points, self.box.lower.numpy(), self.box.upper.numpy())
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
            mean, covariance + torch.diag(noise + _LEAST_STD**2)
        )
        evidence = math.log(self.share) + float(density.log_prob(value))
        return primitive.condition(phase, value, noise), evidence


@dataclass(frozen=True, eq=False)
class Passing:
    """Alternative places that the path passes at a phase.

    Attributes:
        name: what the user calls it.
        phase: in [0, 1].
        places: at least one.
    """

    name: str
    phase: float
    places: tuple[Place, ...]

    @property
    def phases(self) -> tuple[float, ...]:
        """The phase at which a place is passed."""
        return (self.phase,)

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) of trajectories (P, T, D) to the nearest place."""
        points = at_phases(trajectories, self.phase)[:, 0]
        return np.asarray(np.min([place.missed(points) for place in self.places], axis=0))

    def cost(self, settings: PlanSettings) -> Cost:
        """Return `mixture_cost` of the places' boxes."""
        boxes = [place.box for place in self.places]
        lower, upper = (
            np.stack([getattr(b, n).numpy() for b in boxes]) for n in ("lower", "upper")
        )
        variance = np.stack([box.variance.numpy() for box in boxes])
        shares = [place.share for place in self.places]

        def cost(trajectories: ArrayLike) -> ValueAndGradient:
            paths = check_trajectories(trajectories, lower.shape[1])
            points = at_phases(paths, self.phase)[:, 0]
            offsets = box_offset(points, lower[:, None], upper[:, None])
            value, slopes = mixture_cost(offsets, variance, upper - lower, shares)
            return value, spread_to_steps(slopes.sum(axis=0)[:, None], self.phase, paths.shape[1])

        return cost

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior for each place with its log-evidence."""
        return [place.condition(primitive, self.phase) for place in self.places]

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`."""
        return settings.sigma
