"""Postures that constraints of joints and of the tool ask for, phase by phase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planning.constraints import Exactly, Passing, Place
from smp_planner.planning.problem import Problem
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.planning.tool_passing import ToolPassing
from smp_planner.planning.tool_postures import drawn_postures

__all__ = ["AskedPostures", "asked_postures", "is_asked"]


@dataclass(frozen=True)
class AskedPostures:
    """Configurations that a search for paths goes through, layer by layer.

    Attributes:
        start: (n,) rad.
        phases: of what follows, ascending; the last is 1.
        layers: for each phase configurations (C,n) rad, one of which is passed there.
    """

    start: FloatArray
    phases: tuple[float, ...]
    layers: tuple[FloatArray, ...]


def is_asked(problem: Problem) -> bool:
    """Return whether a problem asks for places of the path, or of the tool with its orientation."""
    return any(isinstance(each, Passing | ToolPassing) for each in problem.constraints)


def asked_postures(
    problem: Problem, count: int, steps: int, rng: np.random.Generator
) -> AskedPostures:
    """Return postures of all constraints of a problem, not checked for collisions.

    Places of joints are taken as they are, boxes of joints by even draws; places of the tool by
    `drawn_postures`, wherever demonstrations are.

    Args:
        problem: with one constraint at a phase.
        count: of postures that are sought for each.
        steps: of the trajectory, of which there is at least one between two phases.
        rng: source of all randomness.

    Raises:
        UnreachableError: a place of the tool is out of reach, or not with its orientation.
        ValueError: what a search for paths does not keep: a velocity, an uncertain start, no goal,
            several constraints of one phase, or less than a step apart, or one of another kind.
    """
    start: FloatArray | None = None
    found: dict[float, FloatArray] = {}
    for constraint in problem.constraints:
        name, robot = constraint.name, problem.robot
        if isinstance(constraint, Exactly) and constraint.derivative:
            if constraint.value.any():
                raise ValueError(
                    f"{name} must be zero for a search for paths, which begins and ends at rest, "
                    f"got {constraint.value.tolist()}"
                )
            continue
        if not isinstance(constraint, Exactly | Passing | ToolPassing | Reaching):
            raise ValueError(f"{name} is of a kind that a search for paths does not keep")
        (phase,) = constraint.phases
        if phase == 0.0:
            if start is not None:
                raise ValueError(f"{name} must be the one constraint of phase 0, got another")
            start = _start_of(constraint)
            continue
        if phase in found:
            raise ValueError(
                f"{name} must be the one constraint of phase {phase} for a search for paths, got "
                "another"
            )
        if isinstance(constraint, Exactly):
            found[phase] = constraint.value[None]
        elif isinstance(constraint, Passing):
            shares = shared_out(count, np.ones(len(constraint.places)))
            drawn = [
                _drawn(place, max(1, share), rng)
                for place, share in zip(constraint.places, shares, strict=True)
            ]
            found[phase] = np.concatenate(drawn)
        else:
            places = constraint.goals if isinstance(constraint, Reaching) else constraint.places
            near = np.zeros(robot.joints) if start is None else start
            found[phase] = drawn_postures(name, places, robot, near, count, rng)
    if start is None:
        raise ValueError("start must be given for a search for paths, got none")
    if 1.0 not in found:
        raise ValueError("goal must be given for a search for paths, got none")
    phases = tuple(sorted(found))
    at = [round(phase * steps) for phase in (0.0, *phases)]
    for before, after, phase in zip(at[:-1], at[1:], phases, strict=True):
        if after <= before:
            raise ValueError(
                f"phases must be at least {1.0 / steps:.3g} apart for a search for paths, from 0 "
                f"to 1, got {', '.join(f'{each:g}' for each in phases)}, of which {phase:g} is not"
            )
    return AskedPostures(start, phases, tuple(found[phase] for phase in phases))


def _start_of(constraint: Exactly | Passing | ToolPassing | Reaching) -> FloatArray:
    """Return the configuration (n,) rad in which a path begins."""
    if isinstance(constraint, Exactly):
        return constraint.value
    points = [p.point for p in constraint.places] if isinstance(constraint, Passing) else [None]
    if len(points) != 1 or points[0] is None:
        raise ValueError(
            f"{constraint.name} must be one configuration for a search for paths, got a choice"
        )
    return np.asarray(points[0])


def _drawn(place: Place, count: int, rng: np.random.Generator) -> FloatArray:
    """Return configurations (C,n) rad of a place: its point, or even draws from its box."""
    if place.point is not None:
        return place.point[None]
    lower, upper = place.box.lower.numpy(), place.box.upper.numpy()
    return np.asarray(rng.uniform(lower, upper, (count, len(lower))))
