"""Families of trajectories: what a primitive would propose for a goal, and wider detours."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.blind_detours import detour_functions
from smp_gym.sampling.conversion import to_solid_row
from smp_gym.sampling.detours import HARMONICS, detour_basis, detours
from smp_gym.sampling.grid import Grid, near, passing, rasterise
from smp_gym.sampling.transfer import Query, Transfer, carry
from smp_gym.sampling.witness import FIXTURE_CLEARANCE, WITNESS_SAMPLES, within_limits
from smp_gym.scene import goal_boxes

__all__ = ["BLOCKING_DEPTH", "Family", "draw_family", "member", "members", "with_neighbours"]


BLOCKING_DEPTH = 0.015
"""Metres: how deep an obstacle reaches into the covering spheres before a path counts as blocked.
The spheres stand out of the arm's shapes by about that much."""


_WIDE = (1.0, 2.5)
_SWEEPING = (2.0, 6.0)
_SWEEPING_HARMONICS = 4
"""How many times as wide as ordinary detours wide ones are. Every other one is sweeping: wider
still, but of the lowest harmonics only, such as going high over everything or drawing the hand back
to the base: what a policy could do that is blind to obstacles."""


_NEIGHBOURS = 64
_BESIDE = 0.35
"""Number of trajectories beside a reference trajectory, and their distance from it in units of the
ordinary width."""


_BESIDE_BLIND = 4
_BLIND_WIDTH = 0.12
"""Number of detours beside each blind one, and standard deviation of their numbers from its (rad).
"""


@dataclass(frozen=True, eq=False)
class Family:
    """Trajectories for one goal: mean of the carried demonstrations, these, and their detours.

    Attributes:
        configuration: (6,) rad, where all of them end.
        base: (M,) which demonstration each detour belongs to.
        numbers: (M, F, 6) standard normal numbers, times the width, of the detours.
        paths: (N, T, S, 3) m, centres of the swept spheres; N = 1 + demonstrations + M.
        radius: (S,) m.
        grids: which members pass which grid points: grids, and how many members each is of.
        proposals: how many, from the first, a primitive would propose.
        wide: how many, after them, are wider detours.
        blind: how many, after those, are or resemble the transfer's blind detours.
        free: (N,) whether table and goals leave a member free.
        able: (N,) whether a member may serve as witness, as far as seen from these samples.
    """

    configuration: FloatArray
    base: NDArray[np.int64]
    numbers: FloatArray
    paths: FloatArray
    radius: FloatArray
    grids: tuple[tuple[Grid, int], ...]
    proposals: int
    wide: int
    blind: int
    free: BoolArray
    able: BoolArray

    def near(self, rows: FloatArray, distance: float) -> BoolArray:
        """Return a mask (C, N) of members that come within a distance (m) of obstacles."""
        return np.concatenate(
            [near(grid, rows, distance, members) for grid, members in self.grids], axis=1
        )

    def share_past(self, cells: BoolArray) -> float:
        """Return the share of the free proposals that pass none of the grid's points (X, Y, Z)."""
        free = self.free[: self.proposals]
        past = free & ~passing(self.grids[0][0], cells, self.proposals)
        return float(past.sum() / max(1, free.sum()))

    def blocked(self, rows: FloatArray) -> BoolArray:
        """Return a mask (C, N) of members that obstacles block, checked without the grid."""
        return kernels.blocked_paths(self.paths, self.radius, rows, BLOCKING_DEPTH)

    def shares(self, free: BoolArray) -> FloatArray:
        """Return the shares (3,) of proposals, wider and blind detours that are still free (N,).

        Of those that are free by themselves; the share of none is 0.
        """
        ends = np.cumsum([0, self.proposals, self.wide, self.blind])
        return np.array(
            [
                free[low:high].sum() / max(1, self.free[low:high].sum())
                for low, high in itertools.pairwise(ends)
            ]
        )


def draw_family(
    query: Query, proposals: int, wide: int, rng: np.random.Generator, blind: bool = False
) -> Family:
    """Draw the family of a query.

    Args:
        query: which transfer to which goal.
        proposals: how many detours of ordinary width.
        wide: how many wider ones.
        rng: source of all randomness.
        blind: whether with the transfer's blind detours.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    transfer, configuration = query.transfer, query.release
    demonstrations = len(transfer.demonstrations)
    base = rng.integers(demonstrations, size=proposals + wide)
    features = detour_basis(transfer.samples).shape[1]
    numbers = rng.standard_normal((len(base), features, 6))
    numbers[proposals::2] *= rng.uniform(*_WIDE, size=(len(numbers[proposals::2]), 1, 1))
    sweeping = numbers[proposals + 1 :: 2]
    sweeping *= rng.uniform(*_SWEEPING, size=(len(sweeping), 1, 1))
    sweeping *= (np.arange(features) % HARMONICS < _SWEEPING_HARMONICS)[:, None]
    carried = carry(transfer, configuration, transfer.samples)
    mean = carried.mean(axis=0, keepdims=True)
    known = _draw_blind(transfer, rng) if blind else np.empty((0, *mean.shape[1:]))
    trajectories = np.concatenate(
        [mean, carried, carried[base] + detours(numbers, transfer.samples), mean + known]
    )
    paths = transfer.paths(trajectories, transfer.swept)
    radius = transfer.spheres.radius[transfer.swept]
    grounded = np.isin(transfer.swept, transfer.moving)
    height = kernels.lowest(paths, np.where(grounded, radius, -np.inf))
    # The bin counts as solid here.
    solids = np.array([to_solid_row(goal) for goal in query.goals if goal_boxes(goal)])
    solids = solids.reshape(-1, kernels.OBSTACLE_COLUMNS)
    clearance = np.minimum(
        height, kernels.least_clearances(paths, radius, solids, 1.1 * FIXTURE_CLEARANCE)
    )
    able = (clearance >= FIXTURE_CLEARANCE) & within_limits(trajectories)
    able[len(able) - len(known) :] = False
    return Family(
        configuration=configuration,
        base=base,
        numbers=numbers,
        paths=paths,
        radius=radius,
        grids=((rasterise(paths, radius), len(paths)),),
        proposals=1 + demonstrations + proposals,
        wide=wide,
        blind=len(known),
        free=clearance > -BLOCKING_DEPTH,
        able=able,
    )


def _draw_blind(transfer: Transfer, rng: np.random.Generator) -> FloatArray:
    """Return (M, T, 6) rad: the transfer's blind detours, and others beside each of them."""
    numbers = np.repeat(transfer.blind, 1 + _BESIDE_BLIND, axis=0)
    numbers += _BLIND_WIDTH * rng.standard_normal(numbers.shape)
    numbers[:: 1 + _BESIDE_BLIND] = transfer.blind
    return np.einsum("kt,mkj->mtj", detour_functions(transfer.samples), numbers)


def with_neighbours(
    transfer: Transfer, family: Family, index: int, rng: np.random.Generator
) -> Family:
    """Return a family with trajectories beside one of its detours: they fill the gap around it.

    Args:
        transfer: of the family.
        family: of trajectories.
        index: of the member, a detour.
        rng: source of all randomness.
    """
    detour = index - 1 - len(transfer.demonstrations)
    aside = _BESIDE * rng.standard_normal((_NEIGHBOURS, *family.numbers.shape[1:]))
    carried = carry(transfer, family.configuration, transfer.samples)[family.base[detour]]
    trajectories = carried + detours(family.numbers[detour] + aside, transfer.samples)
    paths = transfer.paths(trajectories, transfer.swept)
    return replace(
        family,
        paths=np.concatenate([family.paths, paths]),
        grids=(*family.grids, (rasterise(paths, family.radius), len(paths))),
        free=np.append(family.free, np.ones(len(paths), np.bool_)),
        able=np.append(family.able, np.zeros(len(paths), np.bool_)),
    )


def member(transfer: Transfer, family: Family, index: int) -> FloatArray:
    """Return member `index` of a family, (W, 6) rad, at the samples of a witness."""
    carried = carry(transfer, family.configuration, WITNESS_SAMPLES)
    if index == 0:
        mean: FloatArray = carried.mean(axis=0)
        return mean
    if index <= len(carried):
        return carried[index - 1]
    detour = index - 1 - len(carried)
    numbers = family.numbers[detour : detour + 1]
    return carried[family.base[detour]] + detours(numbers, WITNESS_SAMPLES)[0]


def members(transfer: Transfer, family: Family) -> FloatArray:
    """Return all members of a family but the blind ones, (N, W, 6) rad, see `member`."""
    carried = carry(transfer, family.configuration, WITNESS_SAMPLES)
    mean = carried.mean(axis=0, keepdims=True)
    detoured = carried[family.base] + detours(family.numbers, WITNESS_SAMPLES)
    return np.concatenate([mean, carried, detoured])
