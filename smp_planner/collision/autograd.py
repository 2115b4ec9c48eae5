"""The costs of `smp_planner.collision.costs` in torch, with gradients by autograd.

Plain tensors over all configurations and pairs at once, as a paper's code would have it: forward
kinematics by matrix products, the map by `grid_sample`, the gradient by back-propagation. In
float64 it is the oracle of the compiled loops, in float32 the slow side of a comparison of speed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from smp_gym.arrays import FloatArray
from smp_planner.collision.costs import (
    CUTOFF_WIDTHS,
    CollisionCost,
    JointLimitCost,
    SelfCollisionCost,
    ValueAndGradient,
    VelocityLimitCost,
    steps_scale,
)
from smp_planner.collision.robot_model import RobotModel
from smp_planner.occupancy.grid import DistanceGrid

__all__ = [
    "by_autograd",
    "joint_limits",
    "map_collision",
    "sampled_distance",
    "self_collision",
    "velocity_limits",
]


def by_autograd(cost: Callable[[Tensor], Tensor], trajectories: Tensor) -> ValueAndGradient:
    """Return value (P,) and gradient (P, T, n) of a cost of tensors.

    Args:
        cost: differentiable, from trajectories (P, T, n) to (P,).
        trajectories: (P, T, n) rad.
    """
    q = trajectories.detach().requires_grad_()
    value = cost(q)
    (gradient,) = torch.autograd.grad(value.sum(), q)
    return value.detach().double().numpy(), gradient.double().numpy()


def _constant(value: object, like: Tensor) -> Tensor:
    return torch.as_tensor(np.asarray(value), dtype=like.dtype, device=like.device)


def sampled_distance(grid: DistanceGrid, points: Tensor) -> Tensor:
    """Return the interpolated distance (...) m at points (..., 3) m, constant beyond the grid."""
    extent = grid.spacing * (np.array(grid.values.shape) - 1)
    unit = 2.0 * (points - _constant(grid.origin, points)) / _constant(extent, points) - 1.0
    found = grid_sample(
        _constant(grid.values, points)[None, None],
        unit.flip(-1).reshape(1, 1, 1, -1, 3),
        padding_mode="border",
        align_corners=True,
    )
    return found.reshape(points.shape[:-1])


def _excess(gap: Tensor, reach: Tensor, edge_width: float) -> Tensor:
    """Return p^2 - p_reach^2 of gaps, zero beyond the reach."""
    beyond = torch.sigmoid(-reach / edge_width).square()
    excess = torch.sigmoid(-gap / edge_width).square() - beyond
    return torch.where(gap < reach, excess, torch.zeros_like(excess))


def map_collision(
    cost: CollisionCost, trajectories: Tensor, edge_width: float, margin: float
) -> Tensor:
    """Return the value (P,) of a `CollisionCost`."""
    robot: RobotModel = cost.robot
    moving = torch.as_tensor(robot.link > 0, device=trajectories.device)
    centers = robot.sphere_centers(trajectories)[..., moving, :]
    offset = _constant(robot.radius, trajectories)[moving] + margin
    truncation = float(cost.grid.values.max())
    reach = (offset + CUTOFF_WIDTHS * edge_width).clamp(max=truncation) - offset
    gap = sampled_distance(cost.grid, centers) - offset
    total = _excess(gap, reach, edge_width).sum(dim=(1, 2))
    return cost.scale * steps_scale(trajectories.shape[1]) * total


def self_collision(cost: SelfCollisionCost, trajectories: Tensor) -> Tensor:
    """Return the value (P,) of a `SelfCollisionCost`."""
    pairs = torch.as_tensor(cost.robot.collision_pairs, device=trajectories.device)
    centers = cost.robot.sphere_centers(trajectories)
    both = _constant(cost.robot.radius, trajectories)[pairs].sum(dim=1)
    between = torch.linalg.vector_norm(
        centers[..., pairs[:, 0], :] - centers[..., pairs[:, 1], :], dim=-1
    )
    reach = _constant(CUTOFF_WIDTHS * cost.edge_width, trajectories)
    total = _excess(between - both - cost.margin, reach, cost.edge_width).sum(dim=(1, 2))
    return steps_scale(trajectories.shape[1]) * total


def joint_limits(cost: JointLimitCost, trajectories: Tensor) -> Tensor:
    """Return the value (P,) of a `JointLimitCost`."""
    lower = _constant(cost.lower + cost.margin, trajectories)
    upper = _constant(cost.upper - cost.margin, trajectories)
    excess = torch.relu(trajectories - upper) + torch.relu(lower - trajectories)
    return steps_scale(trajectories.shape[1]) * excess.square().sum(dim=(1, 2))


def velocity_limits(cost: VelocityLimitCost, trajectories: Tensor) -> Tensor:
    """Return the value (P,) of a `VelocityLimitCost`."""
    segments = trajectories.shape[1] - 1
    allowed: FloatArray = cost.duration * cost.fraction * cost.velocity
    share = trajectories.diff(dim=1).abs() * segments / _constant(allowed, trajectories)
    return steps_scale(segments) * torch.relu(share - 1.0).square().sum(dim=(1, 2))
