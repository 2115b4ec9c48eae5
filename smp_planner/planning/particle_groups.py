"""The particles of a plan in groups that are drawn alike: its homotopy classes, and the rest."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smp_gym.arrays import IntArray

if TYPE_CHECKING:
    from smp_planner.planning.plan import Plan

__all__ = ["CHOSEN", "DEMONSTRATED", "OBSTACLE", "ParticleGroup", "particle_groups"]

CHOSEN, DEMONSTRATED, OBSTACLE = "#f28c1c", "#c0392b", "#444444"
"""Colours of the chosen particle, of demonstrations and of obstacles."""

_CLASSES = ("#1b7f4b", "#2b4c9b", "#8e44ad", "#0f9aa8", "#b5651d", "#c2307a")
_OTHERS, _NOT_GOOD = "#5b6770", "#9aa0a6"
"""Colours of the classes, the largest first, of those beyond, and of what is not good."""


class ParticleGroup(NamedTuple):
    """Particles that are drawn alike.

    Attributes:
        members: indices of the particles.
        color: of their lines, "#rrggbb".
        good: whether they are good.
        label: what they are, and how many.
    """

    members: IntArray
    color: str
    good: bool
    label: str


def particle_groups(plan: Plan) -> Iterator[ParticleGroup]:
    """Yield the groups of a plan's particles, the largest homotopy class first.

    Args:
        plan: whose particles they are.
    """
    good = np.flatnonzero(plan.good)
    classes = [good[members] for members in plan.modes.members]
    named = len(classes) if len(classes) <= len(_CLASSES) else len(_CLASSES) - 1
    for number, (members, color) in enumerate(
        zip(classes[:named], _CLASSES, strict=False), start=1
    ):
        yield ParticleGroup(members, color, True, f"class {number}: {len(members)}")
    if classes[named:]:
        rest = np.concatenate(classes[named:])
        label = f"{len(classes) - named} other classes: {len(rest)}"
        yield ParticleGroup(rest, _OTHERS, True, label)
    bad = np.flatnonzero(~plan.good)
    if len(bad):
        yield ParticleGroup(bad, _NOT_GOOD, False, f"not good: {len(bad)}")
