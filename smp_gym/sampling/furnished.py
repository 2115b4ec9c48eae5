"""Furniture between start and goal, and a witness that gets by.

Furniture cannot be put together around a witness as single obstacles are. So pieces of it are drawn
until one blocks the mean of the demonstrations and most of what a primitive would propose, and
still leaves a member of the family clear; that member, checked densely, is the witness.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.conversion import fixture_rows, to_row, to_solid_row
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import BLOCKING_DEPTH, Family, draw_family, member
from smp_gym.sampling.furniture import Place, draw_furniture
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.transfer import Query
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import Goal

__all__ = ["furnish"]

_WITNESS_CLEARANCE = 0.02
"""m, what furniture leaves between itself and the witness's spheres."""

_GOAL_BODY_CLEARANCE = 0.012
"""m, between furniture and points on the body of a goal."""

_FREE_SHARE = 0.03
_FIRST_PROPOSALS = ((10, 0.10), (30, 0.07))
"""Share of the proposals that furniture may leave free, and larger ones that it may leave of the
first so many: most pieces are thrown away for these few."""

_MEMBER_SAMPLES = 40
_WIDE_DETOURS = 168
"""Samples of each member of a family, more than for single obstacles since furniture is thin, and
how many wide detours are drawn."""

_PIECES = 40
_MEMBERS = 20
"""Numbers of pieces tried with a family, and of its members tried as the witness of each."""

_POINTS_PER_AXIS = (9, 9, 7)
"""Points on a goal's body along x, y and z that furniture is kept away from."""


def _points_of(goals: tuple[Goal, ...]) -> FloatArray:
    """Return (1, N, 3) m, points all over the bodies of goals."""
    points = []
    for goal in goals:
        row = np.array(to_solid_row(goal))
        steps = (np.linspace(-1.0, 1.0, count) for count in _POINTS_PER_AXIS)
        grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        points.append(row[1:4] + grid * row[6:9])
    return np.concatenate(points)[None]


def _blocks_enough(family: Family, rows: FloatArray) -> bool:
    """Return whether furniture blocks the mean and leaves few proposals free."""
    for count, share in (*_FIRST_PROPOSALS, (family.proposals, _FREE_SHARE)):
        paths = family.paths[:count]
        blocked = kernels.blocked_paths(paths, family.radius, rows, BLOCKING_DEPTH)
        free = family.free[:count] & ~blocked.any(axis=0)
        if free[0] or free.sum() > share * family.free[:count].sum():
            return False
    return True


def furnish(
    kind: str,
    query: Query,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw furniture between start and goal, and a witness; None if they do not fit together.

    Args:
        kind: of the furniture.
        query: which transfer to which goal.
        rng: source of all randomness.
        before: what was drawn for another goal: its witness stays one, and its furniture is in the
            result, too.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    transfer = replace(query.transfer, samples=_MEMBER_SAMPLES)
    query = replace(query, transfer=transfer)
    family = draw_family(query, transfer.proposals, _WIDE_DETOURS, rng)
    ends, points = (transfer.start[None], query.release[None]), _points_of(query.goals)
    x, y, z = (kinematics.end_effector_pose(transfer.start) @ transfer.held)[:3, 3].tolist()
    place = Place(query.goal.position, (x, y, z))
    others = np.empty((0, kernels.OBSTACLE_COLUMNS)) if before is None else before.rows
    other = None if before is None else before.witness
    able = family.able & ~family.near(others, _WITNESS_CLEARANCE).any(axis=0)
    bodies = fixture_rows(query.goals)

    def clearance(trajectory: FloatArray, rows: FloatArray) -> float:
        return float(transfer.clearances(trajectory, rows, 1.0).min())

    for _ in range(_PIECES):
        rows = np.array([to_row(part) for part in draw_furniture(kind, place, rng)])
        at_goals = kernels.path_clearances(points, np.zeros(points.shape[1]), rows, 1.0).min()
        if (
            clearance(ends[0], rows) < START_CLEARANCE
            or clearance(ends[1], rows) < _WITNESS_CLEARANCE
            or at_goals < _GOAL_BODY_CLEARANCE
            or (other is not None and clearance(other, rows) < _WITNESS_CLEARANCE)
        ):
            continue
        alive = np.flatnonzero(able & ~family.near(rows, _WITNESS_CLEARANCE).any(axis=0))
        if not len(alive) or not _blocks_enough(family, rows):
            continue
        together = np.concatenate([others, rows])
        for index in alive[:_MEMBERS]:
            witness = member(transfer, family, int(index))
            if is_witness(transfer, witness, bodies, together, _WITNESS_CLEARANCE):
                return Draw(
                    transfer.start, query.goals, together, witness if other is None else other
                )
    return None
