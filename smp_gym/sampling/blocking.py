"""Obstacles that block most trajectories to a goal, with or without a witness that gets by.

The witness is drawn at random from the family first, then obstacles are chosen that come near it
and block as many of the others as they can. So the place of the opening varies from scene to scene
as the family does: no one detour gets through many of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import draw_wall
from smp_gym.sampling.candidates import Candidates
from smp_gym.sampling.choice import apart, choose
from smp_gym.sampling.conversion import fixture_rows
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import Family, draw_family, member, with_neighbours
from smp_gym.sampling.grid import GRID_SHAPE, points, within
from smp_gym.sampling.obstacles import START_CLEARANCE, draw_candidates, fits, fitted, vary
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.transfer import Query, carry
from smp_gym.sampling.witness import WITNESS_SAMPLES, is_witness
from smp_gym.scene import SHAPES

__all__ = ["block", "block_around_witness"]

_MAX_FAMILIES = 4
_MAX_WITNESSES = 6
_MAX_ROUNDS = 3
_MAX_CHOICES = 6
"""Numbers of families tried for a goal, of witnesses tried of a family, of rounds that add
candidates for a witness, and of choices made from them in each round."""

_PARENTS = 24
_GENERATIONS = 2
"""Number of the candidates that have children, others that resemble them but are larger, and how
many times in a round."""

_HOPELESS = 0.25
"""Share of the proposals that no candidate blocks, from which on no choice is looked for."""

_UNBLOCKED = 0.0
_LEAST_HALF = 0.04
_MAX_LOOKED_AT = 60
"""Largest share of the proposals that pass no point where an obstacle of this half width (m) could
stand beside a witness, and number of members looked at for one."""

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
    start = family.free & (already == 0)
    free = start

    def add(rows: FloatArray) -> BoolArray:
        """Add candidates; return which members none of all blocks."""
        nonlocal candidates
        candidates = candidates.joined(Candidates.guessed(family, fitted(query, rows, useful)))
        return np.asarray(start & ~candidates.blocks.any(axis=0))

    for _ in range(_MAX_ROUNDS):
        # What is left free after a choice shows where obstacles are missing.
        left = add(draw_candidates(query, family, free, rng))
        if family.shares(left)[0] > _HOPELESS:
            return None
        left = add(draw_candidates(query, family, left, rng))
        for _ in range(_GENERATIONS):
            left = add(vary(candidates.most_blocking(_PARENTS), rng))
        if (family.shares(left) > specification.shares).any():
            return None
        for _ in range(_MAX_CHOICES):
            choice = choose(candidates.rows, candidates.blocks, already, specification)
            if choice is None:
                break
            known = candidates.check(family, choice)
            free = start & ~candidates.blocks[choice].any(axis=0)
            if not free[0] and (family.shares(free) <= specification.shares).all():
                return candidates.rows[choice]
            if known:
                break
    return None


def block_around_witness(
    queries: Sequence[Query], specification: DifficultySpecification, rng: np.random.Generator
) -> Draw | None:
    """Draw a witness for each query and obstacles around it; None if they do not fit together.

    Args:
        queries: transfers from one start to different goals.
        specification: of the obstacles in the way of each.
        rng: source of all randomness.

    Returns:
        A draw whose witness is that of the first query.

    Raises:
        UnreachableError: a goal is out of reach.
    """
    crowd = specification.obstacles > 0
    wall = draw_wall(rng) if crowd else _NO_ROWS
    start, goals = queries[0].transfer.start, queries[0].goals
    places = np.logical_and.reduce([_places(query) for query in queries])
    for _ in range(_MAX_FAMILIES if crowd else 1):
        families = [
            draw_family(query, *(query.transfer.counts if crowd else (0, 0)), rng, blind=crowd)
            for query in queries
        ]
        for _ in range(_MAX_WITNESSES):
            witnesses = _draw_witnesses(queries, families, wall, places, specification, rng)
            if witnesses is None:
                break
            rows = _enclose(queries, families, witnesses, wall, specification, rng)
            if rows is not None:
                return Draw(start, goals, rows, witnesses[0].trajectory)
    return None


@dataclass(frozen=True, eq=False)
class _Witness:
    """The member `index` of a family as a feasible reference trajectory, (W, 6) rad."""

    index: int
    trajectory: FloatArray


def _draw_witnesses(
    queries: Sequence[Query],
    families: Sequence[Family],
    others: FloatArray,
    places: BoolArray,
    specification: DifficultySpecification,
    rng: np.random.Generator,
) -> list[_Witness] | None:
    """Draw a member of each family that is clear of others (K, 9), and lets the rest be blocked.

    By small obstacles at some of the places (X, Y, Z), points of the grid.
    """
    crowd, clearance = specification.obstacles > 0, specification.clearance
    found: list[_Witness] = []
    for number, (query, family) in enumerate(zip(queries, families, strict=True)):
        able = family.able & ~family.near(others, clearance).any(axis=0)
        if crowd:
            # The proposals shall be blocked.
            able[: family.proposals] = False
        for index in rng.permutation(np.flatnonzero(able))[:_MAX_LOOKED_AT]:
            left = places & ~within(family.paths[index], family.radius, clearance + _LEAST_HALF)
            if crowd and any(
                of.share_past(left) > _UNBLOCKED for of in reversed(families[: number + 1])
            ):
                continue
            trajectory = member(query.transfer, family, int(index))
            bodies = fixture_rows(query.goals)
            if is_witness(query.transfer, trajectory, bodies, others, clearance):
                found.append(_Witness(int(index), trajectory))
                places = left
                break
        else:
            return None
    return found


def _places(query: Query) -> BoolArray:
    """Return which points of the grid (X, Y, Z) a small obstacle may stand at."""
    centers = points()
    rows = np.zeros((len(centers), kernels.OBSTACLE_COLUMNS))
    rows[:, 0], rows[:, 1:4] = SHAPES.index("sphere"), centers
    rows[:, 4], rows[:, 6:] = 1.0, _LEAST_HALF
    return fits(query, rows).reshape(GRID_SHAPE)


def _enclose(
    queries: Sequence[Query],
    families: Sequence[Family],
    witnesses: Sequence[_Witness],
    others: FloatArray,
    specification: DifficultySpecification,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return others (K, 9) and obstacles around witnesses, (M, 9); None if too much stays free."""
    kept = [queries[0].transfer.looks(witness.trajectory) for witness in witnesses]
    together = others
    for query, family, witness in zip(queries, families, witnesses, strict=True):

        def useful(rows: FloatArray, together: FloatArray = together) -> BoolArray:
            beside: BoolArray = np.asarray(apart(rows, together).all(axis=1))
            for looks in kept:
                beside[beside] = looks.clear(rows[beside], specification.clearance)
            return beside

        if specification.obstacles:
            family = with_neighbours(query.transfer, family, witness.index, rng)
        rows = _choose(query, specification, family, together, useful, rng)
        if rows is None:
            return None
        together = np.concatenate([together, rows])
    return together


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
    end = transfer.swept_path(carry(transfer, query.release, WITNESS_SAMPLES).mean(axis=0)[-1:])

    def useful(rows: FloatArray) -> BoolArray:
        clear = end.clear(rows, START_CLEARANCE)
        return np.asarray(clear & apart(rows, others).all(axis=1))

    rows = _choose(query, specification, family, others, useful, rng)
    return None if rows is None else np.concatenate([others, rows])
