"""Self-collision pairs: spheres of a user's robot that must stay clear of each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_planner.collision.robot_model import RobotModel

__all__ = ["PAIR_GAP", "with_collision_pairs"]

PAIR_GAP = 0.01
"""m, least gap of two spheres in all demonstrations from which on they are kept apart."""

_CONFIGURATIONS = 50
"""Configurations of each demonstration in which gaps are measured."""


def with_collision_pairs(model: RobotModel, demonstrations: Sequence[FloatArray]) -> RobotModel:
    """Return a robot with the pairs of its spheres that must stay clear of each other.

    Those of links that are not neighbours, unless they come nearer than `PAIR_GAP` in a
    demonstration: spheres reach beyond what they cover, and demonstrations are free.

    Args:
        model: whose `collision_pairs` are replaced.
        demonstrations: (T_j, n) rad.
    """
    shown = [d[np.linspace(0, len(d) - 1, _CONFIGURATIONS).astype(int)] for d in demonstrations]
    centers = model.sphere_centers(torch.from_numpy(np.concatenate(shown))).numpy()
    link, radius = model.link, model.radius
    pairs = []
    for first in range(len(link)):
        others = np.flatnonzero(link > link[first] + 1)
        gap = np.linalg.norm(centers[:, others] - centers[:, first : first + 1], axis=-1).min(
            axis=0
        )
        kept = others[gap - radius[others] - radius[first] > PAIR_GAP]
        pairs.append(np.column_stack([np.full(len(kept), first), kept]))
    empty = np.empty((0, 2), np.int64)
    return replace(model, collision_pairs=np.concatenate([empty, *pairs]))
