"""The check of a batch's finished trajectories: collisions, limits and constraints, on the device.

It decides what `smp_planner.planning.assessment` decides, in float32 and with coarser bounds
between the samples, so that it calls nothing free that is not; within a millimetre of an obstacle
the two may differ.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from smp_planner.batch.problem_tables import BodyTables, Tables
from smp_planner.collision.verification import CLEARANCE_TOLERANCE

__all__ = ["Gaps", "PathGaps", "path_gaps"]

Gaps = Callable[[Tables, BodyTables, Tensor], tuple[Tensor, Tensor]]
"""Map from trajectories to their gaps to obstacles and to themselves; see `plain_gaps`."""


class PathGaps(NamedTuple):
    """Results of the check of a body along B x P trajectories.

    Attributes:
        clearance: (B, P) m, as of `smp_planner.collision.verification.CollisionCheck`.
        self_free: (B, P) whether the robot is clear of itself.
    """

    clearance: Tensor
    self_free: Tensor


def path_gaps(tables: Tables, stage: BodyTables, trajectories: Tensor, gaps: Gaps) -> PathGaps:
    """Check trajectories against the obstacles of a stage and the robot itself, between steps, too.

    The bounds are those of `smp_planner.collision.verification`, with the longest lever of each
    link in place of every sphere's. A segment whose gaps at the ends do not settle it is sampled
    at steps along which nothing moves by more than two tolerances.

    Args:
        tables: of the chain.
        stage: spheres and obstacles.
        trajectories: (B, P, T, n) rad, with the steps that `tables` was made for.
        gaps: of configurations.
    """
    path = trajectories[:, :, stage.first : stage.last].contiguous()
    gap, own = gaps(tables, stage, path)
    nearest, own_nearest = gap.amin(-1), own.amin(-1)
    change = path.diff(dim=-2)
    travel = (change.abs() @ stage.levers.mT[:, None]).amax(-1)
    if any(tables.prismatic):
        # Levers hold within the limits; beyond them, revolute joints may have longer ones.
        travel = travel + change.abs().sum(-1) * _beyond(tables, path)[..., None]
    bound = 0.5 * (gap[..., :-1] + gap[..., 1:] - travel)
    settled = (own[..., :-1] + own[..., 1:] >= travel) | (own_nearest < CLEARANCE_TOLERANCE)[
        ..., None
    ]
    settled &= bound >= nearest[..., None] - CLEARANCE_TOLERANCE
    open_ = ~settled & (travel > 2.0 * CLEARANCE_TOLERANCE)
    most = int(open_.flatten(1).sum(-1).max())
    if most:
        longest = float(torch.where(open_, travel, 0.0).max())
        samples = int(longest / (2.0 * CLEARANCE_TOLERANCE)) + 1
        # As many segments of each scene as of the one with the most: some are sampled in vain.
        order = open_.flatten(1).int().argsort(dim=-1, descending=True, stable=True)[:, :most]
        particle = order // change.shape[2]
        segments = order[..., None].expand(-1, -1, path.shape[-1])
        start = path[:, :, :-1].flatten(1, 2).gather(1, segments)
        along = change.flatten(1, 2).gather(1, segments)
        share = torch.arange(1, samples, device=path.device, dtype=path.dtype) / samples
        between = start[:, :, None] + share[:, None] * along[:, :, None]
        found, own_found = gaps(tables, stage, between.contiguous())
        nearest = nearest.scatter_reduce(1, particle, found.amin(-1), "amin")
        own_nearest = own_nearest.scatter_reduce(1, particle, own_found.amin(-1), "amin")
    nearest = torch.where((stage.obstacle_count > 0)[:, None], nearest, torch.inf)
    return PathGaps(nearest, own_nearest >= CLEARANCE_TOLERANCE)


def _beyond(tables: Tables, path: Tensor) -> Tensor:
    """Return by how much (B, P), m, prismatic joints are beyond their limits at most, all added."""
    slides = torch.tensor(tables.prismatic, device=path.device)
    excess = (path - path.clamp(tables.lower, tables.upper)).abs().amax(-2)
    return torch.where(slides, excess, 0.0).sum(-1)
