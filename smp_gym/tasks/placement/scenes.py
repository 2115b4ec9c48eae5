"""Scenes of Placement: a bin, and obstacles or furniture before it."""

from __future__ import annotations

import functools

import numpy as np

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.sampling.blocking import block, block_around_witness
from smp_gym.sampling.clutter import CLUTTER, clutter
from smp_gym.sampling.displaced import NARROW, displaced
from smp_gym.sampling.draws import Draw, SceneSampler
from smp_gym.sampling.furnished import furnish
from smp_gym.sampling.furniture import FURNITURE
from smp_gym.sampling.moving import among_moving
from smp_gym.sampling.specification import SPECIFICATIONS
from smp_gym.sampling.transfer import Query, Transfer, make_transfer
from smp_gym.scene import Goal
from smp_gym.tasks.placement.rules import (
    BIN_LOWER,
    BIN_UPPER,
    HELD_OBJECT_POSE,
    START_CONFIGURATION,
)

__all__ = ["SAMPLER", "demonstrated_transfer"]

_GOAL_CLEARANCE = 0.015
"""m, of obstacles from the bin, sideways."""


@functools.lru_cache(maxsize=1)
def demonstrated_transfer() -> Transfer:
    """Return the movement into the bin that the demonstrations show."""
    demonstrations = Demonstrations.load("Placement")
    return make_transfer(
        demonstrations,
        slice(None),
        0,
        START_CONFIGURATION,
        HELD_OBJECT_POSE,
        _GOAL_CLEARANCE,
        blind_side=("Placement", 0),
    )


def _draw_query(rng: np.random.Generator) -> Query:
    """Draw a bin."""
    x, y, z = rng.uniform(BIN_LOWER, BIN_UPPER)
    return Query(demonstrated_transfer(), (Goal(position=(float(x), float(y), float(z))),))


def _draw(difficulty: str, rng: np.random.Generator) -> Draw | None:
    return block_around_witness((_draw_query(rng),), SPECIFICATIONS[difficulty], rng)


def _place(difficulty: str, rng: np.random.Generator) -> Draw | None:
    query = _draw_query(rng)
    rows = block(query, SPECIFICATIONS[difficulty], rng)
    return None if rows is None else Draw(query.transfer.start, query.goals, rows)


def _furnish(kind: str, difficulty: str, rng: np.random.Generator) -> Draw | None:
    return furnish(kind, difficulty, _draw_query(rng), rng)


def _clutter(difficulty: str, rng: np.random.Generator) -> Draw | None:
    return clutter(_draw_query(rng), CLUTTER[difficulty], rng)


def _move(difficulty: str, rng: np.random.Generator) -> Draw | None:
    return among_moving(_draw_query(rng), difficulty, rng)


def _displace(difficulty: str, rng: np.random.Generator) -> Draw | None:
    query = _draw_query(rng)
    drawn = block_around_witness((query,), SPECIFICATIONS[NARROW], rng)
    return displaced(query, drawn, difficulty, rng)


SAMPLER = SceneSampler(
    _draw,
    _place,
    families={kind: functools.partial(_furnish, kind) for kind in FURNITURE}
    | {"clutter": _clutter, "moving": _move, "displaced": _displace},
)
