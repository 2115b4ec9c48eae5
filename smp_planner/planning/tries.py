"""The tries of a problem: how many particles and how wide a prior each of them has."""

from __future__ import annotations

from typing import NamedTuple

from smp_planner.planning.settings import PlanSettings

__all__ = ["MORE_PARTICLES", "Try", "tries"]

MORE_PARTICLES = 4
"""Factor of the particles of a new try, where particles compete."""


class Try(NamedTuple):
    """A try of a problem.

    Attributes:
        particles: that are adapted, or proposals that are drawn.
        width: factor of the prior's added standard deviation, or of that of proposals.
    """

    particles: int
    width: float


def tries(settings: PlanSettings, *, compete: bool) -> list[Try]:
    """Return the tries of a problem, the first and those that follow while no particle is good.

    One try after the other has twice the added deviation. Where particles compete, the second has
    the prior as learned and `MORE_PARTICLES` times the particles instead, and so many have those
    that come after it: the larger a population, the more likely one of its first draws is near a
    narrow passage, and its offspring replaces all that is stuck.

    Args:
        settings: number of particles and of further tries.
        compete: whether particles are adapted as one population, or are proposals, not adapted.
    """
    count, numbers = settings.particles, range(settings.retries + 1)
    if not compete:
        return [Try(count, 2.0**number) for number in numbers]
    more = MORE_PARTICLES * count
    return [Try(more if number else count, 2.0 ** max(number - 1, 0)) for number in numbers]
