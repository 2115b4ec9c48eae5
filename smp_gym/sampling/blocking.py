"""Obstacles that block most trajectories to a goal, with or without a witness that gets by.

The witness is drawn at random from the family first, then obstacles are chosen that come near it
and block as many of the others as they can. So the place of the opening varies from scene to scene
as the family does: no one detour gets through many of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import draw_wall
from smp_gym.sampling.candidates import Candidates
from smp_gym.sampling.choice import apart, choose
from smp_gym.sampling.conversion import fixture_rows
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import Family, draw_family, member
from smp_gym.sampling.obstacles import START_CLEARANCE, draw_candidates, vary
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.transfer import Query, carry
from smp_gym.sampling.witness import WITNESS_SAMPLES, is_witness

__all__ = ["block", "block_around_witness"]

_MAX_FAMILIES = 4
_MAX_WITNESSES = 3
_MAX_ROUNDS = 3
_MAX_CHOICES = 6
"""Numbers of families tried for a goal, of witnesses tried of a family, of rounds that add
candidates for a witness, and of choices made from them in each round."""

_PARENTS = 24
"""Number of the candidates that have children, others that resemble them."""

_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))


def _choose(
    query: Query,
    specification: DifficultySpecification,
    family: Family,
    others: FloatArray,
    useful: Callable[[FloatArray], BoolArray],
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return (M, 9) obstacles that block the mean and enough of proposals and wider detours.

    Args:
        query: which transfer to which goal.
        specification: of these obstacles.
        family: of the trajectories to the goal.
        others: (K, 9) rows of obstacles that the scene holds besides.
        useful: returns which of obstacles (C, 9) may be chosen.
        rng: source of all randomness.

    Returns:
        (M, 9) rows; None if none were found.
    """
    if not specification.obstacles:
        return _NO_ROWS
    already = family.blocked(others).sum(axis=0)
    candidates = Candidates.none(family)
    free = family.free & (already == 0)
    for _ in range(_MAX_ROUNDS):
        # What is left free after a choice shows where obstacles are missing.
        pool = draw_candidates(query, family, free, rng)
        candidates = candidates.joined(Candidates.guessed(family, pool[useful(pool)]))
        pool = vary(query, candidates.most_blocking(_PARENTS), rng)
        candidates = candidates.joined(Candidates.guessed(family, pool[useful(pool)]))
        for _ in range(_MAX_CHOICES):
            choice = choose(candidates.rows, candidates.blocks, already, specification)
            if choice is None:
                break
            known = candidates.check(family, choice)
            free = family.free & (already == 0) & ~candidates.blocks[choice].any(axis=0)
            share, wide_share = family.shares(free)
            if (
                not free[0]
                and share <= specification.free_share
                and wide_share <= specification.wide_share
            ):
                return candidates.rows[choice]
            if known:
                break
    return None


def block_around_witness(
    query: Query,
    specification: DifficultySpecification,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw a witness, and obstacles between start and goal; None if they do not fit together.

    Args:
        query: which transfer to which goal.
        specification: of these obstacles.
        rng: source of all randomness.
        before: what was drawn for another goal: its witness stays one, and its obstacles are in the
            result, too.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    crowd = specification.obstacles > 0
    counts = (query.transfer.proposals, query.transfer.wide) if crowd else (0, 0)
    if before is None:
        rows = draw_wall(rng) if crowd else _NO_ROWS
        before = Draw(query.transfer.start, query.goals, rows)
    for _ in range(_MAX_FAMILIES if crowd else 1):
        family = draw_family(query, *counts, rng)
        drawn = _enclose(query, specification, family, rng, before)
        if drawn is not None:
            return drawn
    return None


def _enclose(
    query: Query,
    specification: DifficultySpecification,
    family: Family,
    rng: np.random.Generator,
    before: Draw,
) -> Draw | None:
    """Draw a witness out of a family and obstacles around it; None if too much stays free."""
    transfer, clearance = query.transfer, specification.clearance
    others, earlier = before.rows, before.witness
    able = np.flatnonzero(family.able & ~family.near(others, clearance).any(axis=0))
    bodies = fixture_rows(query.goals)

    for index in rng.permutation(able)[:_MAX_WITNESSES]:
        witness = member(transfer, family, int(index))
        if not is_witness(transfer, witness, bodies, others, clearance):
            continue
        kept = [witness] if earlier is None else [witness, earlier]

        def useful(rows: FloatArray, kept: list[FloatArray] = kept) -> BoolArray:
            beside: BoolArray = np.asarray(apart(rows, others).all(axis=1))
            beside[beside] = transfer.kept_clear(kept, rows[beside], clearance)
            return beside

        rows = _choose(query, specification, family, others, useful, rng)
        if rows is not None:
            together = np.concatenate([others, rows])
            return Draw(transfer.start, query.goals, together, kept[-1])
    return None


def block(
    query: Query,
    specification: DifficultySpecification,
    rng: np.random.Generator,
    others: FloatArray = _NO_ROWS,
) -> FloatArray | None:
    """Return (M, 9) rows that block the mean and enough of the proposals, and the others.

    They keep clear of the configurations that all proposals share, start and release, but nobody
    looks for a witness. None if nothing blocks enough.

    Args:
        query: which transfer to which goal.
        specification: of these obstacles.
        rng: source of all randomness.
        others: (K, 9) rows of obstacles that the scene holds besides.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    transfer = query.transfer
    family = draw_family(query, transfer.proposals, 0, rng)
    end = carry(transfer, query.release, WITNESS_SAMPLES).mean(axis=0)[-1:]

    def useful(rows: FloatArray) -> BoolArray:
        clear = transfer.clearances(end, rows, START_CLEARANCE) >= START_CLEARANCE
        return np.asarray(clear & apart(rows, others).all(axis=1))

    rows = _choose(query, specification, family, others, useful, rng)
    return None if rows is None else np.concatenate([others, rows])
