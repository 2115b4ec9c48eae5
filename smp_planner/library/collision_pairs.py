"""Self-collision pairs: spheres of a user's robot that must stay clear of each other."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_planner.collision.robot_model import RobotModel
from smp_planner.library.urdf import Robot

__all__ = ["PAIR_GAP", "with_collision_pairs"]

PAIR_GAP = 0.01
"""m, least gap of two spheres in all demonstrations from which on they are kept apart."""

_POSTURES = 200
"""Configurations drawn within the limits, to tell what overlaps whatever the robot does."""

_MOSTLY = 0.5
"""Share of them from which on an overlap says nothing about a demonstration."""

_LOGGER = logging.getLogger(__name__)

_CONFIGURATIONS = 50
"""Configurations of each demonstration in which gaps are measured."""


def with_collision_pairs(robot: Robot, demonstrations: Sequence[FloatArray]) -> RobotModel:
    """Return the model of a robot with the pairs of its spheres that must stay clear of each other.

    Those of links that are not neighbours and may not touch, and of what the robot holds with all
    links that move against it, unless they come nearer than `PAIR_GAP` in a demonstration: spheres
    reach beyond what they cover, and demonstrations are free. Links of which spheres overlap in a
    demonstration but not in most postures are logged as a warning: there the robot may have touched
    itself. So is a robot of which nothing that moves has a sphere.

    Args:
        robot: whose model's `collision_pairs` are replaced.
        demonstrations: (T_j, n) rad; configurations with NaN are passed over.
    """
    model, allowed = robot.model, robot.may_touch()
    if not (model.link > 0).any():
        _LOGGER.warning(
            "no link that moves has a body (bodiless=): plans of this robot are free of collisions "
            "whatever is in the way"
        )
    shown = [d[np.linspace(0, len(d) - 1, _CONFIGURATIONS).astype(int)] for d in demonstrations]
    number = np.repeat(np.arange(len(shown)), _CONFIGURATIONS)
    configurations = np.concatenate(shown)
    measured = np.isfinite(configurations).all(axis=1)
    number = number[measured]
    centers = model.sphere_centers(torch.from_numpy(configurations[measured])).numpy()
    link, radius = model.link, model.radius
    held = np.array([name in robot.held for name in robot.bodies] or [False] * len(link), np.bool_)
    pairs, overlapping = [], []
    for first in range(len(link)):
        apart = link > link[first] + np.where(held, 0, 1)
        others = np.flatnonzero(apart & ~allowed[first])
        distance = np.linalg.norm(centers[:, others] - centers[:, first : first + 1], axis=-1)
        gap = distance - radius[others] - radius[first]
        least = gap.min(axis=0)
        kept, deep = others[least > PAIR_GAP], others[least < 0.0]
        pairs.append(np.column_stack([np.full(len(kept), first), kept]))
        when = number[gap[:, least < 0.0].argmin(axis=0)]
        overlapping.append(
            np.column_stack([np.full(len(deep), first), deep, when, -1e3 * least[least < 0.0]])
        )
    _warn_of_contacts(robot, np.concatenate(overlapping or [np.empty((0, 4))]))
    empty = np.empty((0, 2), np.int64)
    return replace(model, collision_pairs=np.concatenate([empty, *pairs]))


def _warn_of_contacts(robot: Robot, overlapping: FloatArray) -> None:
    """Log links of which spheres overlap in a demonstration, unless they do in most postures.

    Args:
        robot: that they are of.
        overlapping: (K, 4) two spheres, the number of the demonstration, and how deep, mm.
    """
    if not len(overlapping):
        return
    model, rng = robot.model, np.random.default_rng(0)
    postures = rng.uniform(model.lower, model.upper, (_POSTURES, model.joints))
    centers = model.sphere_centers(torch.from_numpy(postures)).numpy()
    first, second = overlapping[:, :2].astype(int).T
    gap = np.linalg.norm(centers[:, first] - centers[:, second], axis=-1)
    gap -= model.radius[first] + model.radius[second]
    rare = (gap < 0.0).mean(axis=0) < _MOSTLY
    names = np.array(robot.bodies or [f"number {index}" for index in model.link])
    links = np.column_stack([names[first], names[second]])
    for pair in np.unique(links[rare], axis=0):
        found = overlapping[rare & (links == pair).all(axis=1)]
        deepest = found[found[:, 3].argmax()]
        _LOGGER.warning(
            "spheres of links %s and %s overlap by %.0f mm in demonstration %d, and are not kept "
            "apart in %d pairs: make the robot with a smaller overshoot, or leave out "
            "demonstrations in which it touches itself; if they may touch, say so by touching= or "
            "srdf=",
            *pair,
            deepest[3],
            int(deepest[2]),
            len(found),
        )
