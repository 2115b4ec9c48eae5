"""The particles of a plan in groups that are drawn alike: its homotopy classes, and the rest."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smp_gym.arrays import IntArray

if TYPE_CHECKING:
    from smp_planner.planning.plan import Plan

__all__ = [
    "CHOSEN",
    "DEMONSTRATED",
    "EXECUTED",
    "OBSTACLE",
    "ParticleGroup",
    "groups_on_the_way",
    "particle_groups",
]

CHOSEN, DEMONSTRATED, OBSTACLE, EXECUTED = "#f28c1c", "#c0392b", "#444444", "#00b3ff"
"""Colours of the chosen particle, of demonstrations, of obstacles, and of what was executed."""

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


def groups_on_the_way(plan: Plan, earlier: Plan) -> Iterator[ParticleGroup]:
    """Yield the groups of particles on their way, in the colours that their classes have at last.

    Args:
        plan: that they became.
        earlier: one of its `history`.
    """
    known = {
        tuple(plan.signatures[member]): each
        for each in particle_groups(plan)
        if each.good
        for member in each.members
    }
    found: dict[tuple[str, str], list[int]] = {}
    for index, (good, signature) in enumerate(zip(earlier.good, earlier.signatures, strict=True)):
        each = known.get(tuple(signature))
        if not good:
            name, color = "not good", _NOT_GOOD
        elif each is None:
            name, color = "other classes", _OTHERS
        else:
            name, color = each.label.partition(":")[0], each.color
        found.setdefault((name, color), []).append(index)
    for (name, color), members in sorted(found.items()):
        label = f"{name}: {len(members)}"
        yield ParticleGroup(np.array(members), color, name != "not good", label)
