"""What the user asks of a path, checked and turned into `Site`s in normalised coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from smp_planner.library.modulation import TOLERANCE_SHARE, AnyOf, Box, Place, Site, ViaPoint
from smp_planner.movement_primitives.box_prior import SmoothBox

__all__ = ["Frame", "sites_of"]

FloatArray = NDArray[np.float64]

_SAME_PHASE = 1e-9


class Frame:
    """The coordinates in which paths are adapted: (x - offset) / scale.

    Args:
        offset: (D,) in the unit of the path.
        scale: same unit, positive.
    """

    def __init__(self, offset: FloatArray, scale: float) -> None:
        self.offset, self.scale = offset, scale

    @property
    def dimension(self) -> int:
        """D."""
        return len(self.offset)

    def inwards(self, points: ArrayLike) -> FloatArray:
        """Return points (..., D) in normalised coordinates."""
        return (np.asarray(points, np.float64) - self.offset) / self.scale

    def outwards(self, points: ArrayLike) -> FloatArray:
        """Return normalised points (..., D) in the unit of the path."""
        return np.asarray(points, np.float64) * self.scale + self.offset


def sites_of(
    frame: Frame,
    start: ArrayLike | Box | AnyOf | None,
    via_points: Sequence[ViaPoint | AnyOf],
    goal: ArrayLike | Box | AnyOf | None,
    sigma: float,
) -> tuple[Site, ...]:
    """Return what a path shall be near to, ascending in phase.

    Args:
        frame: of the path.
        start: where it shall begin; None leaves that to the demonstrations.
        via_points: what it shall pass.
        goal: where it shall end; None leaves that to the demonstrations.
        sigma: of tails where none is given, in extents.

    Raises:
        ValueError: a place of another dimension than the path, options of a via-point at different
            phases, or two sites of one phase that cannot both be met.
    """
    sites = []
    for name, phase, wanted in (("start", 0.0, start), ("goal", 1.0, goal)):
        if wanted is None:
            continue
        options, shares = _options(wanted)
        places = [
            _place(name, frame, option, share, sigma)
            for option, share in zip(options, shares, strict=True)
        ]
        sites.append(Site(name, phase, tuple(places)))
    for index, via in enumerate(via_points):
        name = f"via_points[{index}]"
        options, shares = _options(via)
        phases = set()
        places = []
        for option, share in zip(options, shares, strict=True):
            if not isinstance(option, ViaPoint):
                raise ValueError(f"{name} must be a ViaPoint or AnyOf of such, got {option!r}")
            phases.add(option.phase)
            places.append(_place(name, frame, option, share, sigma))
        if len(phases) > 1:
            raise ValueError(f"{name} must be options of one phase, got {sorted(phases)}")
        sites.append(Site(name, phases.pop(), tuple(places)))
    for first, second in combinations(sites, 2):
        _refuse_contradiction(frame, first, second)
    return tuple(sorted(sites, key=lambda site: site.phase))


def _options(wanted: Any) -> tuple[tuple[Any, ...], tuple[float, ...]]:
    if isinstance(wanted, AnyOf):
        assert wanted.shares is not None
        return tuple(wanted.options), tuple(wanted.shares)
    return (wanted,), (1.0,)


def _place(name: str, frame: Frame, wanted: Any, share: float, sigma: float) -> Place:
    paper_scale, tolerance = False, 0.0
    if isinstance(wanted, Box):
        if wanted.sigma is not None:
            sigma = wanted.sigma / frame.scale
        paper_scale = wanted.paper_scale
        lower, upper, point = wanted.lower, wanted.upper, None
    else:
        if isinstance(wanted, ViaPoint):
            tolerance = wanted.tolerance / frame.scale
            wanted = wanted.position
        point = np.asarray(wanted, np.float64)
        if not np.isfinite(point).all():
            raise ValueError(f"{name} must be finite, got {wanted!r}")
        lower = upper = point
    if lower.shape != (frame.dimension,):
        raise ValueError(
            f"{name} must have {frame.dimension} coordinates, as the demonstrations have, got "
            f"{np.shape(lower)}"
        )
    half = TOLERANCE_SHARE * tolerance / math.sqrt(frame.dimension)
    box = SmoothBox(
        torch.from_numpy(frame.inwards(lower) - half),
        torch.from_numpy(frame.inwards(upper) + half),
        torch.tensor(sigma),
        paper_scale,
    )
    return Place(box, None if point is None else frame.inwards(point), tolerance, share)


def _refuse_contradiction(frame: Frame, first: Site, second: Site) -> None:
    if abs(first.phase - second.phase) > _SAME_PHASE:
        return
    if not (first.is_exact and second.is_exact):
        return
    for a in first.places:
        for b in second.places:
            assert a.point is not None
            assert b.point is not None
            between = float(np.linalg.norm(a.point - b.point))
            if between <= a.tolerance + b.tolerance + _SAME_PHASE:
                return
    places = " and ".join(
        str(frame.outwards(site.places[0].point).tolist())  # type: ignore[arg-type]
        for site in (first, second)
    )
    raise ValueError(
        f"{first.name} and {second.name} contradict each other at phase {first.phase}: no path "
        f"passes {places} at once; for a choice of places use AnyOf"
    )
