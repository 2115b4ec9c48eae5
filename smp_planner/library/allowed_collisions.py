"""Allowed collisions of MoveIt's scenes, as far as plans can make use of them."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

from smp_gym.datasets.moveit_matrix import AllowedCollisions
from smp_planner.library.urdf import Robot

__all__ = ["passed_through", "touching_allowed", "warn_of_strangers"]

_LOGGER = logging.getLogger(__name__)


def touching_allowed(robot: Robot, allowed: AllowedCollisions) -> Robot:
    """Return a robot whose links, and bodies that it holds, may touch where a matrix allows it.

    What may touch already still may.

    Args:
        robot: with all that it holds.
        allowed: of the scene.
    """
    if not robot.bodies:
        if allowed.permitting:
            _LOGGER.warning(
                "allowed_collision_matrix is not used: the robot does not know the links of its "
                "spheres"
            )
        return robot
    names = sorted({*robot.links, *robot.held})
    pairs = {frozenset(pair) for pair in combinations(names, 2) if allowed.allows(*pair)}
    return replace(robot, touching=robot.touching | pairs)


def passed_through(
    robot: Robot, allowed: AllowedCollisions, objects: Iterable[str]
) -> frozenset[str]:
    """Return the objects of the world that all that moves may touch: they are no obstacles.

    Those that only some of it may touch are named in a warning: spheres of all links are kept clear
    of all obstacles. Links that stand still are not held against obstacles anyway.

    Args:
        robot: with all that it holds.
        allowed: of the scene.
        objects: their names.
    """
    links = robot.model.link if robot.bodies else ()
    moving = {name for name, link in zip(robot.bodies, links, strict=True) if link > 0}
    free = set()
    for name in sorted(set(objects)):
        touching = sorted(other for other in moving if allowed.allows(name, other))
        if moving and len(touching) == len(moving):
            free.add(name)
            _LOGGER.warning(
                "%s is no obstacle: allowed_collision_matrix lets all that moves touch it", name
            )
        elif touching:
            _LOGGER.warning(
                "allowed_collision_matrix lets %s touch %s, but plans keep them clear of it: an "
                "obstacle is one for all links that move",
                ", ".join(touching),
                name,
            )
    return frozenset(free)


def warn_of_strangers(
    robot: Robot | None, allowed: AllowedCollisions, objects: Iterable[str]
) -> None:
    """Log a warning of names in a matrix that are of nothing, or of no robot that is known."""
    permitting = allowed.permitting
    if robot is None:
        if permitting:
            _LOGGER.warning(
                "allowed_collision_matrix is not used: give robot=, whose links it is of (%s)",
                ", ".join(sorted(permitting)),
            )
        return
    strange = sorted(permitting - {*robot.links, *robot.held, *objects})
    if strange and robot.bodies:
        _LOGGER.warning(
            "allowed_collision_matrix lets %s touch something, but there are no bodies of these "
            "names",
            ", ".join(strange),
        )
