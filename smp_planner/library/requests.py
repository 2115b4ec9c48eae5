"""Requests for a path, checked and turned into constraints in normalised coordinates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from pydantic import BaseModel

from smp_gym.arrays import checked_array, shown
from smp_planner.library.frame import Frame
from smp_planner.library.joint_angles import JointAngles
from smp_planner.library.modulation import AnyOf, Box, ViaPoint
from smp_planner.movement_primitives.box_prior import SmoothBox
from smp_planner.planning.constraints import Constraint, Passing, Place
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint
from smp_planner.planning.tool_passing import ToolPassing

__all__ = ["Request", "constraints_of", "several"]

Request = ArrayLike | Box | GoalRegion | AnyOf
"""A request for the start or the end of a path."""

TOLERANCE_SHARE = 0.8
"""Share of a via-point's tolerance that the box around it takes up, corners included."""

_FARTHEST = 1e6
"""Extents from the middle of the demonstrations within which a path can be asked to pass."""

_SAME = 1e-9
"""Difference of phases, and extents, up to which two are the same."""


def several(name: str, given: Any, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    """Return what is given as a tuple; one alone counts as one of a list.

    Raises:
        ValueError: neither a list nor one of the kinds.
    """
    if isinstance(given, kinds):
        return (given,)
    if not isinstance(given, Iterable) or isinstance(given, str | bytes | Mapping | BaseModel):
        names = ", ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{name} must be a list of {names}; got {shown(given)}")
    return tuple(given)


def constraints_of(
    frame: Frame,
    start: Request | None,
    via_points: Sequence[ViaPoint | ToolViaPoint | AnyOf],
    goal: Request | None,
    sigma: float,
    angles: JointAngles | None,
) -> tuple[Constraint, ...]:
    """Return the constraints that requests for a path amount to, ascending in phase.

    Args:
        frame: of the path.
        start: of the path; None leaves that to the demonstrations.
        via_points: of the path.
        goal: of the path; None leaves that to the demonstrations.
        sigma: of tails where none is given, in extents; m for the regions of a tool.
        angles: limits and branches of the robot that moves; None for a ball.

    Raises:
        ValueError: a place of another dimension than the path, not finite or beyond the limits of
            a joint, options of a via-point at different phases, a place for the tool of no robot,
            or two constraints of one phase that cannot both be met.
    """
    constraints: list[Constraint] = []
    if start is not None:
        constraints.append(_passing("start", 0.0, frame, start, sigma, angles))
    if goal is not None:
        options, shares = _options(goal)
        if any(isinstance(option, GoalRegion) for option in options):
            constraints.append(_reaching(options, shares, angles))
        else:
            constraints.append(_passing("goal", 1.0, frame, goal, sigma, angles))
    for index, via in enumerate(via_points):
        name = f"via_points[{index}]"
        options, shares = _options(via)
        of_tool = any(isinstance(option, ToolViaPoint) for option in options)
        kind = ToolViaPoint if of_tool else ViaPoint
        for option in options:
            if not isinstance(option, kind):
                raise ValueError(
                    f"{name} must be a ViaPoint, a ToolViaPoint or AnyOf of one of these, got "
                    f"{option!r}"
                )
        phases = sorted({option.phase for option in options})
        if len(phases) > 1:
            raise ValueError(f"{name} must be options of one phase, got {phases}")
        if of_tool:
            if angles is None:
                raise ValueError(f"{name} is for a tool, but the primitive has no robot")
            model = angles.robot.model
            constraints.append(ToolPassing(name, phases[0], options, model, shares))
        else:
            constraints.append(_passing(name, phases[0], frame, via, sigma, angles))
    for first, second in combinations(constraints, 2):
        if isinstance(first, Passing) and isinstance(second, Passing):
            _refuse_contradiction(frame, first, second)
        elif isinstance(first, ToolPassing) and isinstance(second, ToolPassing):
            _refuse_places_apart(first, second)
    return tuple(sorted(constraints, key=lambda constraint: constraint.phases[0]))


def _options(request: Any) -> tuple[tuple[Any, ...], tuple[float, ...]]:
    if isinstance(request, AnyOf):
        assert request.shares is not None
        return tuple(request.options), tuple(request.shares)
    return (request,), (1.0,)


def _reaching(
    options: tuple[Any, ...], shares: tuple[float, ...], angles: JointAngles | None
) -> Reaching | ToolPassing:
    if angles is None:
        raise ValueError("goal is a region for a tool, but the primitive has no robot")
    if not all(isinstance(option, GoalRegion) for option in options):
        raise ValueError(f"goal must be regions for the tool or places of the path, got {options}")
    if any(option.orientation is not None for option in options):
        return ToolPassing("goal", 1.0, options, angles.robot.model, shares)
    return Reaching(options, angles.robot.model, shares)


def _passing(
    name: str, phase: float, frame: Frame, request: Any, sigma: float, angles: JointAngles | None
) -> Passing:
    options, shares = _options(request)
    for option in options:
        if name in ("start", "goal") and isinstance(option, GoalRegion | ViaPoint | ToolViaPoint):
            raise ValueError(f"{name} must be a point, a Box or AnyOf of such, got {option!r}")
    places = [
        _place(name, phase, frame, option, share, sigma, angles)
        for option, share in zip(options, shares, strict=True)
    ]
    return Passing(name, phase, tuple(places))


def _place(
    name: str,
    phase: float,
    frame: Frame,
    request: Any,
    share: float,
    sigma: float,
    angles: JointAngles | None,
) -> Place:
    paper_scale, tolerance, point = False, 0.0, None
    if isinstance(request, Box):
        if request.sigma is not None:
            sigma = float(frame.lengths_inwards(request.sigma))
        paper_scale = request.paper_scale
        lower, upper = request.lower, request.upper
    else:
        if isinstance(request, ViaPoint):
            tolerance = float(frame.lengths_inwards(request.tolerance))
            request = request.position
        point = lower = upper = checked_array(name, request)
    if lower.shape != (frame.dimension,):
        raise ValueError(
            f"{name} must have the {frame.dimension} coordinates that the demonstrations have, "
            f"got shape {np.shape(lower)}"
        )
    elif np.abs(np.concatenate([lower - frame.offset, upper - frame.offset])).max() > (
        _FARTHEST * frame.scale
    ):
        raise ValueError(
            f"{name} must be within {_FARTHEST:g} extents of the demonstrations, of "
            f"{frame.scale:.6g}, got {np.where(lower == upper, lower, upper).tolist()}"
        )
    if angles is not None:
        lower, upper = angles.placed(name, phase, lower, upper)
        point = None if point is None else lower
    half = TOLERANCE_SHARE * tolerance / math.sqrt(frame.dimension)
    box = SmoothBox(
        torch.from_numpy(frame.inwards(lower) - half),
        torch.from_numpy(frame.inwards(upper) + half),
        torch.tensor(sigma),
        paper_scale,
    )
    return Place(box, None if point is None else frame.inwards(point), tolerance, share)


def _refuse_contradiction(frame: Frame, first: Passing, second: Passing) -> None:
    if abs(first.phase - second.phase) > _SAME:
        return
    for a in first.places:
        for b in second.places:
            if a.point is None or b.point is None:
                return
            if np.linalg.norm(a.point - b.point) <= a.tolerance + b.tolerance + _SAME:
                return
    points = [constraint.places[0].point for constraint in (first, second)]
    places = " and ".join(frame.named(p) for p in points if p is not None)
    raise ValueError(
        f"{first.name} and {second.name} contradict each other at phase {first.phase}: no path "
        f"passes {places} at once; for a choice of places use AnyOf"
    )


def _refuse_places_apart(first: ToolPassing, second: ToolPassing) -> None:
    """Raise a ValueError if a point of the tool would have to be in two places at once."""
    if abs(first.phase - second.phase) > _SAME:
        return
    for a in first.places:
        for b in second.places:
            if not np.array_equal(a.point, b.point):
                return
            # How far apart two places are is bounded by that of a ball around one of them.
            reach = a.tolerance if isinstance(a, ToolViaPoint) else 0.0
            nearest = (
                a.center if isinstance(a, ToolViaPoint) else np.clip(b.center, a.lower, a.upper)
            )
            if float(b.distance(nearest)) <= reach + _SAME:
                return
    places = " and ".join(f"{np.round(c.places[0].center, 6)}" for c in (first, second))
    raise ValueError(
        f"{first.name} and {second.name} contradict each other at phase {first.phase}: no tool is "
        f"at {places} at once; for a choice of places use AnyOf"
    )
