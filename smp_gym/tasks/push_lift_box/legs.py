"""Legs: segments of a trajectory between two rests, varied independently of each other.

Where a trajectory must pass through certain configurations, what leads there and what follows can
be combined at will: N members of one leg and M of the next make N times M trajectories.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.detours import smoothstep
from smp_gym.sampling.family import BLOCKING_DEPTH
from smp_gym.sampling.grid import Grid, near, rasterise
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.witness import FIXTURE_CLEARANCE, within_limits

__all__ = [
    "Leg",
    "LegFamily",
    "Members",
    "draw_detours",
    "free_paths",
    "left_free",
    "make_family",
]

_MODES = (1.0, 0.5, 0.25)
"""Standard deviations of the modes of a detour: sin(pi s) sin(k pi s) along the leg, s from 0 to 1.
Value and slope vanish at both ends."""


@dataclass(frozen=True, eq=False)
class Members:
    """Trajectories on a leg: demonstrations carried to other ends, with detours.

    Attributes:
        begin: (6,) rad.
        ends: (M, 6) rad.
        base: (M,) which demonstration each is; -1 for their mean.
        detours: (M, K, 6) rad, how far along each of the modes.
    """

    begin: FloatArray
    ends: FloatArray
    base: NDArray[np.int64]
    detours: FloatArray

    def __len__(self) -> int:
        return len(self.base)

    def __getitem__(self, which: slice) -> Members:
        return Members(self.begin, self.ends[which], self.base[which], self.detours[which])


@dataclass(frozen=True, eq=False)
class Leg(MovingBody):
    """A leg of the demonstrated movements, and the body that moves on it.

    Attributes:
        demonstrations: (N, T, 6) rad, at the samples of a witness.
        steps: how many steps of theirs make a whole trajectory.
        stride: every so many samples is one that members are compared by; divides T - 1.
        outline: index of the spheres that candidates are compared by; few, but all of the shape.
    """

    steps: int
    stride: int
    outline: NDArray[np.int64]

    def trajectories(self, members: Members, stride: int = 1) -> FloatArray:
        """Return trajectories (M, T, 6) rad, at every `stride`-th of the samples."""
        mean = self.demonstrations.mean(axis=0, keepdims=True)
        share = np.linspace(0.0, 1.0, mean.shape[1])
        blend = smoothstep(share)[::stride, None]
        order = np.arange(1, members.detours.shape[1] + 1)
        modes = (np.sin(np.pi * share) * np.sin(np.pi * share * order[:, None])).T[::stride]
        modes[-1] = 0.0
        shown = np.concatenate([self.demonstrations, mean])[:, ::stride]
        carried = shown + (1.0 - blend) * (members.begin - shown[:, :1]) - blend * shown[:, -1:]
        result: FloatArray = carried[members.base]
        result += blend * members.ends[:, None]
        result += np.einsum("tk,mkj->mtj", modes, members.detours)
        return result


def draw_detours(count: int, rng: np.random.Generator) -> FloatArray:
    """Return random detours (count, K, 6), of standard deviation about 1 at the middle of a leg."""
    return np.array(_MODES)[:, None] * rng.standard_normal((count, len(_MODES), 6))


@dataclass(frozen=True, eq=False)
class LegFamily:
    """Trajectories on a leg.

    Attributes:
        leg: on which they are.
        members: N, the first of them the mean of the proposals.
        proposals: P, number of the first members, those that a primitive would propose.
        paths: (N, U, S, 3) m, centres of the outline's spheres at every `leg.stride`-th sample.
        grid: occupancy of its points by the members.
        free: (P,) mask of the proposals that the table leaves free.
        able: (N,) mask of the members that may serve as witness, judged by these samples.
    """

    leg: Leg
    members: Members
    proposals: int
    paths: FloatArray
    grid: Grid
    free: BoolArray
    able: BoolArray

    def blocks(self, rows: FloatArray) -> BoolArray:
        """Return a mask (C, P) of the free proposals that obstacles block, by the grid."""
        return near(self.grid, rows, -BLOCKING_DEPTH, self.proposals) & self.free

    def clears(self, rows: FloatArray, clearance: float) -> BoolArray:
        """Return a mask (C, N) of feasible members that keep a clearance (m), by the grid."""
        return ~near(self.grid, rows, clearance, len(self.able)) & self.able


def make_family(leg: Leg, members: Members, proposals: int) -> LegFamily:
    """Return a family of members, the first `proposals` of which a primitive would propose."""
    trajectories = leg.trajectories(members, leg.stride)
    paths = leg.paths(trajectories, leg.outline)
    height = _height(leg, paths, leg.outline)
    return LegFamily(
        leg=leg,
        members=members,
        proposals=proposals,
        paths=paths,
        grid=rasterise(paths, leg.spheres.radius[leg.outline]),
        free=height[:proposals] > -BLOCKING_DEPTH,
        able=within_limits(trajectories, leg.steps / leg.stride) & (height > FIXTURE_CLEARANCE),
    )


def free_paths(leg: Leg, members: Members) -> FloatArray:
    """Return the paths (N, U, S, 3) m of all spheres of members that the table leaves free."""
    paths = leg.paths(leg.trajectories(members, leg.stride), leg.swept)
    return np.ascontiguousarray(paths[_height(leg, paths, leg.swept) > -BLOCKING_DEPTH])


def left_free(leg: Leg, paths: FloatArray, rows: FloatArray) -> BoolArray:
    """Return a mask (N,) of `free_paths` that obstacles leave free, without the grid."""
    radius = leg.spheres.radius[leg.swept]
    free: BoolArray = np.logical_not(
        kernels.blocked_paths(paths, radius, rows, BLOCKING_DEPTH).any(axis=0)
    )
    return free


def _height(leg: Leg, paths: FloatArray, which: NDArray[np.int64]) -> FloatArray:
    """Return the least height of the given spheres over the table, (N,) m."""
    radius = np.where(np.isin(which, leg.moving), leg.spheres.radius[which], -np.inf)
    height: FloatArray = kernels.lowest(paths, radius)
    return height
