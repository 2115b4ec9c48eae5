"""The costs and the check of a batch by the kernels of `smp_planner.batch.fused_kernels`."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from smp_planner.batch import fused_kernels as kernels
from smp_planner.batch.plain_costs import WEIGHTED, tool_cost
from smp_planner.batch.problem_tables import BodyTables, Tables
from smp_planner.collision.costs import CUTOFF_WIDTHS, REFERENCE_STEPS
from smp_planner.collision.verification import SELF_HORIZON
from smp_planner.occupancy.occupancy_map import TRUNCATION

__all__ = ["FusedCosts", "fused_gaps"]

BLOCK = 32
"""Configurations of a program: one warp, so that what is far from all of it costs nothing."""

_WARPS_WANTED = 2048
"""Programs that keep a GPU busy; fewer scenes are split into more parts."""

_MOST_PARTS = 8

_REGISTERS = 168
"""That a thread may have: at 1024 scenes on an H200 a gradient took 9.3 ms with 168, 9.6 with 128,
10.6 with 96, and 12.2 with the 244 that the compiler takes."""


def _blocks(count: int) -> int:
    return math.ceil(count / BLOCK)


def _pairs(body: BodyTables) -> tuple[int, ...]:
    return tuple(itertools.chain.from_iterable(body.pair_links))


def _kinds(tables: Tables) -> tuple[int, ...]:
    """Return 1 for each prismatic joint, 0 for the others."""
    return tuple(int(slides) for slides in tables.prismatic)


def _parts(trajectories: Tensor) -> int:
    """Return how many programs share a block of configurations."""
    blocks = len(trajectories) * _blocks(trajectories[0, :, :, 0].numel())
    return max(1, min(_MOST_PARTS, _WARPS_WANTED // blocks))


class FusedCosts:
    """The costs of B problems, one kernel for each stage and one for the tool.

    Args:
        tables: the problems, in float32.
    """

    def __init__(self, tables: Tables) -> None:
        self.tables = tables
        self._whole = next(
            (
                number
                for number, stage in enumerate(tables.stages)
                if (stage.first, stage.last) == (0, tables.steps)
            ),
            None,
        )
        self._terms = _all_terms(tables)

    def gradient(self, trajectories: Tensor, width: float) -> Tensor:
        """Return the gradient (B, P, T, n) of the weighted sum of costs.

        Args:
            trajectories: (B, P, T, n) rad, contiguous.
            width: m, of the map's edge.
        """
        parts = _parts(trajectories)
        gradient = trajectories.new_empty((parts, *trajectories.shape))
        self._collisions(trajectories, gradient, None, width, self.tables.margin, parts)
        total = gradient[0] if parts == 1 else gradient.sum(0)
        if self._terms is not None:
            self._tools(trajectories, total)
        return total

    def weighted_sum(self, trajectories: Tensor) -> Tensor:
        """Return the weighted sums (B, P) of costs, with the edge at its last width."""
        weights = dict(zip(WEIGHTED, self.tables.weights, strict=True))
        total = trajectories.new_zeros(trajectories.shape[:2])
        for name, value in self._values(trajectories, self.tables.margin).items():
            total = total + weights.get(name, 1.0) * value
        return total

    def costs(self, trajectories: Tensor) -> dict[str, Tensor]:
        """Return the unweighted costs (B, P) by name, with the edge at its last width."""
        return self._values(trajectories, 0.0)

    def _values(self, trajectories: Tensor, margin: float) -> dict[str, Tensor]:
        parts = _parts(trajectories)
        values = trajectories.new_zeros((parts, len(WEIGHTED), *trajectories.shape[:3]))
        width = self.tables.edge_width[1]
        self._collisions(trajectories, None, values, width, margin, parts)
        found = dict(zip(WEIGHTED, values.sum(0).sum(-1), strict=True))
        for name, tool in self.tables.tools.items():
            found[name] = tool_cost(self.tables, tool, trajectories)[0]
        return found

    def _collisions(
        self,
        trajectories: Tensor,
        gradient: Tensor | None,
        values: Tensor | None,
        width: float,
        margin: float,
        parts: int,
    ) -> None:
        tables = self.tables
        whole = self._whole
        # The first launch writes to every step; the others add to it.
        first = tables.body if whole is None else tables.stages[whole]
        self._launch(
            trajectories, gradient, values, width, margin, parts, first, whole is not None, True
        )
        for number, stage in enumerate(tables.stages):
            if number != whole:
                self._launch(
                    trajectories, gradient, values, width, margin, parts, stage, True, False
                )

    def _launch(
        self,
        trajectories: Tensor,
        gradient: Tensor | None,
        values: Tensor | None,
        width: float,
        margin: float,
        parts: int,
        stage: BodyTables,
        obstacles: bool,
        own: bool,
    ) -> None:
        tables, body = self.tables, self.tables.body
        batch, particles, steps, joints = trajectories.shape
        length = stage.last - stage.first
        weights = tables.weights
        kernels.collisions[(_blocks(particles * length), batch, parts)](
            trajectories,
            trajectories if gradient is None else gradient,
            trajectories if values is None else values,
            tables.chain,
            *(stage.spheres, stage.offsets, stage.balls, stage.obstacles, stage.obstacle_count),
            stage.scale,
            *(body.spheres, body.offsets, body.balls, body.pair_masks),
            *(tables.per_step, tables.lower, tables.upper),
            *_strides(stage.spheres, stage.offsets, stage.balls, stage.obstacles),
            *_strides(body.spheres, body.offsets, body.balls, body.pair_masks),
            *(particles, steps, stage.first, length),
            *(batch * particles * steps, trajectories.numel()),
            *(weights[0], width, margin, TRUNCATION),
            *(weights[1], tables.own_edge_width, tables.own_margin),
            *(weights[2], REFERENCE_STEPS / (steps - 1), weights[3], REFERENCE_STEPS / steps),
            JOINTS=joints,
            PRISMATIC=_kinds(self.tables),
            PAIRS=_pairs(body),
            CUTOFF=CUTOFF_WIDTHS,
            OBSTACLES=obstacles,
            OWN=own,
            ADD=not own,
            VALUES=gradient is None,
            PARTS=parts,
            BLOCK=BLOCK,
            num_warps=1,
            maxnreg=_REGISTERS,
        )

    def _tools(self, trajectories: Tensor, gradient: Tensor) -> None:
        assert self._terms is not None
        batch, particles, steps, joints = trajectories.shape
        kernels.tools[(_blocks(particles), batch)](
            trajectories,
            gradient,
            self.tables.chain,
            *self._terms.columns,
            *(self._terms.columns[0].shape[1], particles, steps, 1.0 / self._terms.sigma),
            JOINTS=joints,
            PRISMATIC=_kinds(self.tables),
            BLOCK=BLOCK,
            num_warps=1,
        )


class _Terms(NamedTuple):
    """Boxes of all constraints, one after the other, as columns of `ToolTables`."""

    columns: tuple[Tensor, ...]
    sigma: float


def _all_terms(tables: Tables) -> _Terms | None:
    tools = list(tables.tools.values())
    if not tools:
        return None
    groups, passed = [], 0
    for tool in tools:
        groups.append(torch.where(tool.group > 0, tool.group + passed, 0))
        passed += tool.group.shape[1]
    names = ("step", "share", "point", "lower", "upper", "log_weight")
    columns = [torch.cat([getattr(tool, name) for tool in tools], 1) for name in names]
    columns.append(torch.cat(groups, 1).int())
    return _Terms(tuple(column.contiguous() for column in columns), tools[0].sigma)


def _strides(*tensors: Tensor) -> tuple[int, ...]:
    return tuple(tensor.stride(0) for tensor in tensors)


def fused_gaps(tables: Tables, stage: BodyTables, trajectories: Tensor) -> tuple[Tensor, Tensor]:
    """Return gaps (B, P, T) to obstacles and of the robot to itself; see `plain_gaps`."""
    batch, particles, steps, joints = trajectories.shape
    gap = trajectories.new_empty((batch, particles, steps))
    own = torch.empty_like(gap)
    kernels.gaps[(_blocks(particles * steps), batch)](
        *(trajectories, gap, own, tables.chain),
        *(stage.spheres, stage.offsets, stage.balls, stage.obstacles, stage.obstacle_count),
        stage.pair_masks,
        *_strides(stage.spheres, stage.offsets, stage.balls, stage.obstacles, stage.pair_masks),
        *(particles, steps, SELF_HORIZON),
        JOINTS=joints,
        PRISMATIC=_kinds(tables),
        PAIRS=_pairs(stage),
        BLOCK=BLOCK,
        num_warps=1,
    )
    return gap, own
