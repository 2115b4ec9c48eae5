"""Legs: stretches of a way between two rests, varied independently of each other.

Where a way must pass through certain configurations, what leads there and what follows can be
combined at will: N members of one leg and M of the next make N times M ways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.sampling import kernels
from smp_gym.sampling.body import Body
from smp_gym.sampling.detours import smoothstep
from smp_gym.sampling.grid import GRID_SLACK, near, rasterise
from smp_gym.sampling.witness import FIXTURE_CLEARANCE, within_limits

__all__ = [
    "BLOCKING_DEPTH",
    "Leg",
    "LegFamily",
    "draw_variations",
    "left_free",
    "make_family",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BLOCKING_DEPTH = 0.015
"""m, how deep an obstacle reaches into the covering spheres before a path counts as blocked."""

_MODES = (1.0, 0.5, 0.25)
"""Standard deviations of the modes of a detour: sin(pi s) sin(k pi s) along the leg, s from 0 to 1.
Value and slope vanish at both ends."""


@dataclass(frozen=True, eq=False)
class Leg(Body):
    """A leg of the demonstrated movements, and the body that moves on it.

    Attributes:
        demonstrations: (N, T, 6) rad, at the samples of a witness.
        steps: how many steps of theirs make a whole way.
        stride: every so many samples one is compared by.
        outline: index of the spheres that candidates are compared by; few, but all of the shape.
    """

    steps: int
    stride: int
    outline: NDArray[np.int64]

    def trajectories(
        self, begin: FloatArray, ends: FloatArray, base: NDArray[np.int64], detours: FloatArray
    ) -> FloatArray:
        """Return demonstrations, (M, T, 6) rad, carried to other ends, with detours.

        Args:
            begin: (6,) rad.
            ends: (M, 6) rad.
            base: (M,) which demonstration each is; -1 for their mean.
            detours: (M, K, 6) rad, how far along each of the modes.
        """
        shown = np.concatenate([self.demonstrations, self.demonstrations.mean(0, keepdims=True)])
        share = np.linspace(0.0, 1.0, shown.shape[1])
        blend = smoothstep(share)[:, None]
        carried = shown + (1.0 - blend) * (begin - shown[:, 0])[:, None] - blend * shown[:, -1:]
        order = np.arange(1, detours.shape[1] + 1)
        modes = np.sin(np.pi * share)[:, None] * np.sin(np.pi * share[:, None] * order)
        modes[-1] = 0.0
        result: FloatArray = carried[base] + blend * ends[:, None]
        result += np.einsum("tk,mkj->mtj", modes, detours)
        return result


def draw_variations(
    count: int, widths: tuple[float, float], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return random detours (M, K, 6) rad and shifts of the end (M, 6), in units of their width.

    Args:
        count: M.
        widths: rad, least and greatest standard deviation of a detour at the middle of a leg.
        rng: source of all randomness.
    """
    width = rng.uniform(*widths, size=(count, 1, 1))
    numbers = rng.standard_normal((count, len(_MODES) + 1, 6))
    return width * np.array(_MODES)[:, None] * numbers[:, :-1], numbers[:, -1]


@dataclass(frozen=True, eq=False)
class LegFamily:
    """Trajectories on a leg.

    Attributes:
        leg: on which they are.
        trajectories: (N, T, 6) rad, the first of them the mean of the proposals.
        proposals: how many, from the first, a primitive would propose.
        paths: (N, U, S, 3) m, centres of the outline's spheres at some of the samples.
        grid: which members sweep over which grid points.
        free: (P,) which proposals the table leaves free.
        able: (N,) which members may serve as witness, as far as seen from these samples.
    """

    leg: Leg
    trajectories: FloatArray
    proposals: int
    paths: FloatArray
    grid: NDArray[np.uint64]
    free: BoolArray
    able: BoolArray

    def blocks(self, rows: FloatArray) -> BoolArray:
        """Return (C, P), which obstacles block which proposals that were free, by the grid."""
        return near(self.grid, rows, -BLOCKING_DEPTH, self.proposals) & self.free

    def clears(self, rows: FloatArray, clearance: float) -> BoolArray:
        """Return (C, N), which obstacles keep a clearance (m) from which able, by the grid."""
        return ~near(self.grid, rows, clearance + GRID_SLACK, len(self.able)) & self.able


def make_family(leg: Leg, trajectories: FloatArray, proposals: int) -> LegFamily:
    """Return a family of (N, T, 6) trajectories, the first `proposals` of which are such."""
    coarse = np.ascontiguousarray(trajectories[:, :: leg.stride])
    paths = leg.paths(coarse, leg.outline)
    radius = leg.spheres.radius[leg.outline]
    grounded = np.isin(leg.outline, leg.moving)
    height = (paths[..., grounded, 2] - radius[grounded]).min(axis=(1, 2))
    return LegFamily(
        leg=leg,
        trajectories=trajectories,
        proposals=proposals,
        paths=paths,
        grid=rasterise(paths, radius),
        free=height[:proposals] > -BLOCKING_DEPTH,
        able=within_limits(coarse, leg.steps / leg.stride) & (height > FIXTURE_CLEARANCE),
    )


def left_free(leg: Leg, trajectories: FloatArray, rows: FloatArray) -> BoolArray:
    """Return which of those (N, T, 6) trajectories that the table leaves free obstacles do, too.

    Checked without the grid, with all spheres, at every `leg.stride`-th sample.
    """
    paths = leg.paths(np.ascontiguousarray(trajectories[:, :: leg.stride]), leg.swept)
    radius = leg.spheres.radius[leg.swept]
    grounded = np.isin(leg.swept, leg.moving)
    height = (paths[..., grounded, 2] - radius[grounded]).min(axis=(1, 2))
    steps = kernels.longest_steps(paths)
    blocked = kernels.blocked_paths(paths, radius, steps, rows, BLOCKING_DEPTH).any(axis=0)
    free: BoolArray = ~blocked[height > -BLOCKING_DEPTH]
    return free
