"""The joints of a URDF that move: the chain to a tip, its limits, and where all others stand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from smp_gym.arrays import checked_array, checked_number, shown
from smp_planner.collision.verification import LIMIT_TOLERANCE
from smp_planner.library.urdf_reading import Joint

__all__ = ["MovingChain", "moving_chain"]


class MovingChain(NamedTuple):
    """The joints of a robot, and those of them that move.

    Attributes:
        joints: all of them by name, with the limits that hold.
        positions: where each stands, rad or m; None for those that move.
        moving: those that move, from the root to the tip.
    """

    joints: Mapping[str, Joint]
    positions: Mapping[str, float | None]
    moving: Sequence[Joint]


def moving_chain(
    described: Iterable[Joint], tip: str, held: Any, limits: Any, velocities: Any
) -> MovingChain:
    """Return the chain of joints that move a link.

    Args:
        described: joints of the URDF.
        tip: name of the link.
        held: see `smp_planner.library.urdf.Robot.from_urdf`, as the next two.
        limits: in place of those of the URDF.
        velocities: likewise.

    Raises:
        ValueError: an argument names no joint or is out of range, no joint moves the link, or one
            that does is of another kind or without limits.
    """
    joints = _limited({joint.name: joint for joint in described}, limits, velocities)
    chain = _chain_to(joints, tip)
    positions = _positions(joints, {joint.name for joint in chain}, _checked_held(held, joints))
    moving = [joint for joint in chain if positions[joint.name] is None]
    _check_moving(moving, tip)
    return MovingChain(joints, positions, moving)


def _named(name: str, given: Any, joints: Mapping[str, Joint]) -> dict[str, Any]:
    """Return an argument that maps joints to something."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ValueError(f"{name} must map names of joints to numbers, got {shown(given)}")
    unknown = sorted(str(joint) for joint in given if joint not in joints)
    if unknown:
        raise ValueError(f"{name} names joints that the URDF lacks: {', '.join(unknown)}")
    return dict(given)


def _limited(joints: Mapping[str, Joint], limits: Any, velocities: Any) -> dict[str, Joint]:
    """Return joints with the limits that replace those of the URDF."""
    changed = dict(joints)
    for name, given in _named("limits", limits, joints).items():
        lower, upper = checked_array(f"limits[{name!r}]", given, (2,)).tolist()
        if not lower < upper:
            raise ValueError(f"limits[{name!r}] must be (lower, upper) of a range, got {given}")
        changed[name] = replace(changed[name], lower=lower, upper=upper)
    for name, given in _named("velocities", velocities, joints).items():
        velocity = checked_number(f"velocities[{name!r}]", given, above=0.0)
        changed[name] = replace(changed[name], velocity=velocity)
    return changed


def _checked_held(held: Any, joints: Mapping[str, Joint]) -> dict[str, float]:
    positions = {}
    for name, given in _named("held", held, joints).items():
        joint, position = joints[name], checked_number(f"held[{name!r}]", given)
        if joint.is_fixed:
            raise ValueError(f"held names the joint {name!r}, which is fixed")
        if joint.kind in ("floating", "planar") and position != 0.0:
            raise ValueError(
                f"held[{name!r}] must be 0 for a {joint.kind} joint, whose place is no number, got "
                f"{position}: base= says where the robot stands"
            )
        bounded = joint.kind in ("revolute", "prismatic") and joint.lower <= joint.upper
        beyond = max(joint.lower - position, position - joint.upper)
        if bounded and beyond > LIMIT_TOLERANCE:
            raise ValueError(
                f"held[{name!r}] must be within the joint's limits [{joint.lower}, {joint.upper}], "
                f"got {position}"
            )
        positions[name] = position
    return positions


def _positions(
    joints: Mapping[str, Joint], on_chain: Set[str], held: Mapping[str, float]
) -> dict[str, float | None]:
    """Return where each joint stands, rad or m; None for those that move."""
    positions: dict[str, float | None] = {}
    for joint in joints.values():
        # A mimic joint stands as what it follows, which may be one, too.
        passed, factor, offset = [joint], 1.0, 0.0
        while passed[-1].name not in held and passed[-1].follows is not None:
            source, by, plus = passed[-1].follows
            factor, offset = factor * by, factor * plus + offset
            passed.append(joints[source])
            if len(passed) > len(joints):
                raise ValueError(f"joint {joint.name!r} mimics itself, by {source!r}")
        last = passed[-1]
        if last.name in held:
            positions[joint.name] = factor * held[last.name] + offset
        elif last.is_fixed or last.name not in on_chain:
            positions[joint.name] = factor * last.nearest_to_zero + offset
        elif len(passed) > 1:
            raise ValueError(
                f"joint {joint.name!r} is a mimic of {last.name!r}, which moves: it must be held"
            )
        else:
            positions[joint.name] = None
    return positions


def _chain_to(joints: Mapping[str, Joint], tip: str) -> list[Joint]:
    """Return the joints from the root to a tip."""
    above = {joint.child: joint for joint in joints.values()}
    chain, link = [], tip
    while link in above:
        chain.append(above[link])
        link = above[link].parent
    return chain[::-1]


def _check_moving(chain: Sequence[Joint], tip: str) -> None:
    if not chain:
        raise ValueError(f"tip {tip!r} must be moved by at least one joint, got none")
    for joint in chain:
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise ValueError(
                f"joint {joint.name!r} in the chain to {tip!r} is {joint.kind}; only revolute, "
                f"continuous and prismatic joints can be planned for, others must be held"
            )
        numbers = (joint.lower, joint.upper, joint.velocity)
        if not (np.isfinite(numbers).all() and joint.lower < joint.upper and joint.velocity > 0.0):
            unit = "m" if joint.kind == "prismatic" else "rad"
            raise ValueError(
                f"joint {joint.name!r} must have a range and a velocity limit, got "
                f"[{joint.lower}, {joint.upper}] {unit} and {joint.velocity} {unit}/s; others can "
                f"be given as limits={{{joint.name!r}: (lower, upper)}} and "
                f"velocities={{{joint.name!r}: velocity}}"
            )
