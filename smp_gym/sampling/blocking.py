"""Obstacles that block most trajectories to a goal, with or without a witness that gets by."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
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
_MAX_ROUNDS = 3
_MAX_CHOICES = 12
"""Numbers of families tried for a goal, of rounds that add candidates for a family, and of choices
made from them in each round."""

_PARENTS = 24
"""Number of the candidates that have children, others that resemble them."""

_GLANCE = 8
"""Every so-many-th sample of another witness is looked at first."""

_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))


def _choices(
    query: Query,
    specification: DifficultySpecification,
    family: Family,
    others: FloatArray,
    able: BoolArray,
    useful: Callable[[FloatArray], Candidates],
    rng: np.random.Generator,
) -> Iterator[tuple[FloatArray, BoolArray]]:
    """Yield choices of obstacles that block the mean and enough of the proposals.

    Args:
        query: which transfer to which goal.
        specification: of these obstacles.
        family: of the trajectories to the goal.
        others: (K, 9) rows of obstacles that the scene holds besides.
        able: (N,) which members may serve as witness; it may change between choices.
        useful: returns those of obstacles (C, 9) that may be chosen.
        rng: source of all randomness.

    Yields:
        (M, 9) rows, and (N,) from which members all of them keep their clearance, on the grid.
    """
    crowd = specification.obstacles > 0
    proposed = family.free[: family.proposals]
    already = family.blocked(others).sum(axis=0)
    most = int(specification.free_share * proposed.sum())
    candidates = Candidates.none(family, len(able))
    free = proposed & (already == 0)
    for _ in range(_MAX_ROUNDS if crowd else 1):
        if crowd:
            # What is left free after a choice shows where obstacles are missing.
            pool = draw_candidates(query, family, free, rng)
            candidates = candidates.joined(useful(pool))
            pool = vary(query, candidates.most_blocking(_PARENTS), rng)
            candidates = candidates.joined(useful(pool))
        for _ in range(_MAX_CHOICES):
            choice = choose(
                candidates.rows, candidates.blocks, candidates.clears & able, already, specification
            )
            if choice is None:
                break
            known = candidates.check(family, choice)
            free = proposed & (already == 0) & ~candidates.blocks[choice].any(axis=0)
            if crowd and (free[0] or free.sum() > most):
                if known:
                    break
                continue
            yield candidates.rows[choice], np.all(candidates.clears[choice], axis=0)


def block_around_witness(
    query: Query,
    specification: DifficultySpecification,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw obstacles between start and goal, and a witness; None if they do not fit together.

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
    for _ in range(_MAX_FAMILIES if crowd else 1):
        family = draw_family(query, *counts, rng)
        drawn = _place(query, specification, family, rng, before)
        if drawn is not None:
            return drawn
    return None


def _place(
    query: Query,
    specification: DifficultySpecification,
    family: Family,
    rng: np.random.Generator,
    before: Draw | None,
) -> Draw | None:
    """Draw obstacles for a family and find its witness; None if too much is free or nothing."""
    transfer, clearance = query.transfer, specification.clearance
    others = _NO_ROWS if before is None else before.rows
    able = family.able & ~family.near(others, clearance).any(axis=0)
    bodies = fixture_rows(query.goals)

    def leaves_clear(trajectory: FloatArray, rows: FloatArray) -> BoolArray:
        return np.asarray(transfer.clearances(trajectory, rows, clearance) >= clearance)

    def useful(rows: FloatArray) -> Candidates:
        if before is not None and before.witness is not None:
            rows = rows[leaves_clear(before.witness[::_GLANCE], rows)]
            rows = rows[apart(rows, others).all(axis=1)]
        clears = ~family.near(rows, clearance)
        # What blocks every member, at the start or before the goal, is of no use.
        kept = (clears & able).any(axis=1)
        return Candidates.guessed(family, rows[kept], clears[kept])

    choices = _choices(query, specification, family, others, able, useful, rng)
    for rows, clears in choices:
        witness = None if before is None else before.witness
        if witness is not None and not leaves_clear(witness, rows).all():
            return None
        together = np.concatenate([others, rows])
        alive = able & clears
        for index in np.flatnonzero(alive):
            found = member(transfer, family, int(index))
            if is_witness(transfer, found, bodies, together, clearance):
                return Draw(
                    transfer.start, query.goals, together, found if witness is None else witness
                )
        able[alive] = False
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

    def useful(rows: FloatArray) -> Candidates:
        clear = transfer.clearances(end, rows, START_CLEARANCE) >= START_CLEARANCE
        rows = rows[clear & apart(rows, others).all(axis=1)]
        # One possible witness that nothing comes near.
        return Candidates.guessed(family, rows, np.ones((len(rows), 1), np.bool_))

    one = np.ones(1, np.bool_)
    choices = _choices(query, specification, family, others, one, useful, rng)
    for rows, _ in choices:
        return np.concatenate([others, rows])
    return None
