"""What a path shall pass: via-points, boxes, and choices among them, Eq. (13) and (14)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from smp_planner.movement_primitives.box_prior import SmoothBox

__all__ = ["AnyOf", "Box", "Place", "Site", "ViaPoint", "site_cost"]

FloatArray = NDArray[np.float64]

TOLERANCE_SHARE = 0.8
"""Share of a via-point's tolerance that the box around it takes up, corners included."""


def _vector(name: str, value: ArrayLike) -> FloatArray:
    array = np.array(value, np.float64)
    if array.ndim != 1 or not len(array) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be a vector of finite numbers, got {value!r}")
    return array


@dataclass(frozen=True, eq=False)
class Box:
    """A box in which a path shall start or end, with Gaussian tails outside: Eq. (14).

    Attributes:
        lower: (D,) lower corner, in the unit of the path.
        upper: (D,) upper corner.
        sigma: same unit, standard deviation of the tails; None takes that of the settings.
        paper_scale: reads the denominator of Eq. (14) as printed, √2 σ², in place of 2 σ².
    """

    lower: FloatArray
    upper: FloatArray
    sigma: float | None = None
    paper_scale: bool = False

    def __post_init__(self) -> None:
        lower, upper = _vector("Box.lower", self.lower), _vector("Box.upper", self.upper)
        if lower.shape != upper.shape or not (lower <= upper).all():
            raise ValueError(f"Box.lower {lower} must not exceed Box.upper {upper}")
        if self.sigma is not None and not (math.isfinite(self.sigma) and self.sigma > 0.0):
            raise ValueError(f"Box.sigma must be positive, got {self.sigma}")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)


@dataclass(frozen=True, eq=False)
class AnyOf:
    """Several places of which any will do: a mixture, C_mod = -log Σ π_h N(Φ_t w; μ_h, Σ_h).

    Attributes:
        options: points (D,) or `Box`es for start and goal; `ViaPoint`s of one phase for via-points.
        shares: π_h, positive; equal by default.
    """

    options: Sequence[ArrayLike | Box | ViaPoint]
    shares: Sequence[float] | None = None

    def __post_init__(self) -> None:
        options = tuple(self.options)
        if not options:
            raise ValueError("AnyOf.options must hold at least one place, got none")
        shares = np.ones(len(options)) if self.shares is None else np.asarray(self.shares, float)
        if shares.shape != (len(options),) or not (np.isfinite(shares) & (shares > 0)).all():
            raise ValueError(
                f"AnyOf.shares must be {len(options)} positive numbers, got {self.shares}"
            )
        object.__setattr__(self, "options", options)
        object.__setattr__(self, "shares", tuple((shares / shares.sum()).tolist()))


@dataclass(frozen=True, eq=False)
class ViaPoint:
    """A point that a path shall pass at a phase.

    Attributes:
        phase: in [0, 1].
        position: (D,) in the unit of the path.
        tolerance: same unit, distance that may remain; 0 is exactly.
    """

    phase: float
    position: FloatArray
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.phase <= 1.0:
            raise ValueError(f"ViaPoint.phase must lie in [0, 1], got {self.phase}")
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0.0):
            raise ValueError(f"ViaPoint.tolerance must not be negative, got {self.tolerance}")
        object.__setattr__(self, "position", _vector("ViaPoint.position", self.position))


@dataclass(frozen=True, eq=False)
class Place:
    """One option of a `Site`, in normalised coordinates.

    Attributes:
        box: where the cost is zero, and its tails.
        point: (D,) that a primitive can be conditioned on; None for a box.
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
        return np.asarray(np.maximum(distance - self.tolerance, 0.0))


@dataclass(frozen=True, eq=False)
class Site:
    """What a path shall be near to at one phase.

    Attributes:
        name: what the user calls it, for errors.
        phase: in [0, 1].
        places: at least one; any of them will do.
    """

    name: str
    phase: float
    places: tuple[Place, ...]

    @property
    def is_exact(self) -> bool:
        """Whether a primitive can be conditioned on it: all its places are points."""
        return all(place.point is not None for place in self.places)

    def missed(self, points: FloatArray) -> FloatArray:
        """Return by how much (...) points (..., D) miss the nearest place."""
        return np.asarray(np.min([place.missed(points) for place in self.places], axis=0))


def site_cost(site: Site, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return C_mod (P,) of points (P, D) at a site, and its gradient (P, D).

    Of one place it is d² / (2 σ²), Eq. (14); of several, -log Σ π_h exp(-d_h² / (2 σ_h²)) / Z_h,
    with the normalising constants Z_h relative to the least of them, so that it is log(H) or less
    inside a place of equal shares.
    """
    at = torch.from_numpy(np.ascontiguousarray(points))
    boxes = [place.box for place in site.places]
    outside = torch.stack([box.distance(at) for box in boxes])
    variance = torch.stack([box.variance for box in boxes])
    spread = torch.stack(
        [(box.upper - box.lower + (2.0 * math.pi * box.variance).sqrt()).log() for box in boxes]
    ).sum(-1)
    shares = torch.tensor([place.share for place in site.places], dtype=at.dtype)
    logits = -0.5 * (outside.square() / variance[:, None]).sum(-1)
    logits = logits + (shares.log() - (spread - spread.min()))[:, None]
    membership = torch.softmax(logits, dim=0)
    slopes = outside / variance[:, None]
    gradient = (membership[..., None] * slopes).sum(0)
    return -torch.logsumexp(logits, dim=0).numpy(), gradient.numpy()
