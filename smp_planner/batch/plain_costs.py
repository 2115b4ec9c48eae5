"""The costs of a batch in plain torch: values, and gradients in closed form.

What is computed is what `smp_planner.collision.costs` documents, for B problems at once and with
the exact distance to the obstacles in place of a grid. The derivative of a cost by a sphere's
centre is a force on its link; force and moment about the origin are summed from the tip to the base
and projected on the joint axes, so no Jacobian is formed. The values are differentiable, so that
autograd can check the gradients.

This is the reference: it asks the host which shapes and links matter, and does far more work than
the fused kernels of `smp_planner.batch.fused_kernels`, which compute the same.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from smp_planner.batch.problem_tables import BodyTables, Tables, ToolTables
from smp_planner.batch.shape_distance import LOCAL_DISTANCES, profile_distance
from smp_planner.collision.costs import CUTOFF_WIDTHS, REFERENCE_STEPS
from smp_planner.collision.verification import SELF_HORIZON
from smp_planner.occupancy.occupancy_map import TRUNCATION

__all__ = [
    "WEIGHTED",
    "Chain",
    "PlainCosts",
    "chain",
    "obstacle_distance",
    "plain_gaps",
    "project",
    "tool_cost",
]

ValueAndGradient = tuple[Tensor, Tensor]

WEIGHTED = ("obstacles", "self_collision", "velocity", "joint_limits")
"""Names of the costs in the order of `Tables.weights`."""


class Chain(NamedTuple):
    """Poses of links.

    Attributes:
        rotation: (..., n + 1, 3, 3); the last column is the axis of the joint before the link.
        position: (..., n + 1, 3) m.
        prismatic: (n) whether a joint is.
    """

    rotation: Tensor
    position: Tensor
    prismatic: tuple[bool, ...]


def chain(tables: Tables, configurations: Tensor) -> Chain:
    """Return the poses of all links.

    Args:
        tables: of the chain.
        configurations: (..., n) rad or m.
    """
    batch, rows = configurations.shape[:-1], tables.chain
    rotation = rows[0, :9].reshape(3, 3).expand(*batch, 3, 3)
    position = rows[0, 9:].expand(*batch, 3)
    rotations, positions = [rotation], [position]
    cosine, sine = configurations.cos(), configurations.sin()
    for joint, row in enumerate(rows[1:]):
        position = position + rotation @ row[9:]
        rotation = rotation @ row[:9].reshape(3, 3)
        x, y, z = rotation.unbind(-1)
        if tables.prismatic[joint]:
            position = position + z * configurations[..., joint, None]
        else:
            c, s = cosine[..., joint, None], sine[..., joint, None]
            rotation = torch.stack([x * c + y * s, y * c - x * s, z], -1)
        rotations.append(rotation)
        positions.append(position)
    return Chain(torch.stack(rotations, -3), torch.stack(positions, -2), tables.prismatic)


def project(links: Chain, force: Tensor, moment: Tensor) -> Tensor:
    """Return the joint torques (..., n), or forces, of forces and moments on links.

    Args:
        links: poses.
        force: (..., n + 1, 3).
        moment: (..., n + 1, 3), about the origin.
    """
    force, moment = (part[..., 1:, :].flip(-2).cumsum(-2).flip(-2) for part in (force, moment))
    arm = torch.linalg.cross(links.position[..., 1:, :], force)
    axis = links.rotation[..., 1:, :, 2]
    torque = (axis * (moment - arm)).sum(-1)
    if any(links.prismatic):
        slides = torch.tensor(links.prismatic, device=axis.device)
        torque = torch.where(slides, (axis * force).sum(-1), torque)
    return torque


def _placed(links: Chain, body: BodyTables) -> tuple[Tensor, Tensor]:
    """Return centres (B, P, T, S, 3) m of spheres, and the links (B, S) that they are on.

    Rows that only pad are put on link 0.
    """
    row = torch.arange(body.spheres.shape[1], device=body.spheres.device)
    link = (row[:, None] >= body.offsets[:, None, 1:-1]).sum(-1)
    link = torch.where(row < body.offsets[:, -1:], link, 0)
    which = link[:, None, None, :, None].expand(*links.position.shape[:3], -1, 3)
    position = links.position.gather(-2, which)
    rotation = links.rotation.gather(-3, which[..., None].expand(*which.shape, 3))
    center = body.spheres[:, None, None, :, :3, None]
    return position + (rotation @ center)[..., 0], link


def obstacle_distance(points: Tensor, body: BodyTables) -> ValueAndGradient:
    """Return distance (B, N) m of points (B, N, 3) to the nearest obstacle, and its gradient.

    Without obstacles the distance is infinite.
    """
    best = torch.full_like(points[..., 0], torch.inf)
    away = torch.zeros_like(points)
    for index in range(body.obstacles.shape[1]):
        row = body.obstacles[:, index]
        turn, center, size = row[:, 1:10].reshape(-1, 3, 3), row[:, 10:13], row[:, 13:16]
        local = (points - center[:, None]) @ turn.mT
        distance, slope = torch.full_like(best, torch.inf), torch.zeros_like(away)
        for code, profile in enumerate(LOCAL_DISTANCES.values()):
            mine = (row[:, 0] == code) & (index < body.obstacle_count)
            if not bool(mine.any()):
                continue
            found, gradient = profile_distance(*profile(local, size[:, None]))
            distance = torch.where(mine[:, None], found, distance)
            slope = torch.where(mine[:, None, None], gradient, slope)
        nearer = distance < best
        best = torch.where(nearer, distance, best)
        away = torch.where(nearer[..., None], slope @ turn, away)
    return best, away


def _forces(links: Chain, placed: Tensor, link: Tensor, force: Tensor) -> Tensor:
    """Return the joint torques (B, P, T, n) of forces (B, P, T, S, 3) at centres of spheres."""
    count = links.position.shape[-2]
    on_link = torch.nn.functional.one_hot(link.long(), count).to(force)[:, None, None]
    moment = torch.linalg.cross(placed, force)
    return project(links, on_link.mT @ force, on_link.mT @ moment)


def obstacle_cost(
    tables: Tables, body: BodyTables, trajectories: Tensor, width: float, margin: float
) -> ValueAndGradient:
    """Return the squared occupancy of spheres by obstacles (B, P), and its gradient (B, P, T, n).

    Args:
        tables: of the chain.
        body: spheres and obstacles.
        trajectories: (B, P, T, n) rad or m, the steps of the stage.
        width: m, of the edge.
        margin: m.
    """
    links = chain(tables, trajectories)
    placed, link = _placed(links, body)
    distance, away = obstacle_distance(placed.flatten(1, 3), body)
    distance, away = distance.reshape(placed.shape[:-1]), away.reshape(placed.shape)
    radius = body.spheres[:, None, None, :, 3]
    limit = (radius + margin + CUTOFF_WIDTHS * width).clamp_max(TRUNCATION)
    active = (distance < limit) & (link > 0)[:, None, None]
    value, slope = _occupancy(distance - radius - margin, limit - radius - margin, width, active)
    scale = body.scale[:, None]
    gradient = _forces(links, placed, link, slope[..., None] * away)
    return scale * value.sum((-1, -2)), scale[..., None, None] * gradient


def _occupancy(gap: Tensor, reach: Tensor, width: float, active: Tensor) -> ValueAndGradient:
    """Return p² less its value at `reach`, and its derivative by the gap; 0 where not active."""
    shifted = torch.where(active, gap, 0.0)
    occupancy = torch.sigmoid(-shifted / width)
    square = occupancy.square()
    value = square - torch.sigmoid(-reach / width).square()
    slope = -2.0 / width * square * (1.0 - occupancy)
    return torch.where(active, value, 0.0), torch.where(active, slope, 0.0)


def _spheres_of(link: int, body: BodyTables) -> tuple[slice, Tensor]:
    """Return the rows of a link's spheres in any of B scenes, and their numbers on it (B, rows)."""
    offsets = body.offsets[:, link]
    rows = slice(int(offsets.min()), int(body.offsets[:, link + 1].max()))
    return rows, torch.arange(rows.start, rows.stop, device=offsets.device) - offsets[:, None]


def self_cost(tables: Tables, trajectories: Tensor) -> ValueAndGradient:
    """Return the squared occupancy of spheres by one another (B, P), and its gradient."""
    links = chain(tables, trajectories)
    placed, link = _placed(links, tables.body)
    radius = tables.body.spheres[..., 3]
    width, margin = tables.own_edge_width, tables.own_margin
    reach = margin + CUTOFF_WIDTHS * width
    value = trajectories.new_zeros(trajectories.shape[:3])
    force, moment = torch.zeros_like(links.position), torch.zeros_like(links.position)
    balls = tables.body.balls[:, None, None]
    middle = links.position + (links.rotation @ balls[..., :3, None])[..., 0]
    for inner, outer in tables.body.pair_links:
        apart = torch.linalg.vector_norm(middle[..., inner, :] - middle[..., outer, :], dim=-1)
        if bool((apart >= balls[..., inner, 3] + balls[..., outer, 3] + reach).all()):
            continue
        near, place = _spheres_of(inner, tables.body)
        for row in range(int(tables.body.offsets[:, outer].min()), placed.shape[-2]):
            mine = link[:, row] == outer
            if not bool(mine.any()):
                break
            bits = tables.body.pair_masks[:, row, inner, None] >> place.clamp(0, 63)
            paired = mine[:, None] & (place >= 0) & (place < 63) & ((bits & 1) == 1)
            apart = placed[..., near, :] - placed[..., row : row + 1, :]
            square = apart.square().sum(-1)
            between = square.clamp_min(1e-18).sqrt()
            both = (radius[:, near] + radius[:, row : row + 1])[:, None, None]
            active = paired[:, None, None] & (between < both + reach)
            found, slope = _occupancy(
                between - both - margin, torch.full_like(between, reach - margin), width, active
            )
            value = value + found.sum(-1)
            pull = (slope / between)[..., None] * apart
            turn = torch.linalg.cross(placed[..., near, :], pull).sum(-2)
            pull = pull.sum(-2)
            force[..., inner, :] += pull.detach()
            force[..., outer, :] -= pull.detach()
            moment[..., inner, :] += turn.detach()
            moment[..., outer, :] -= turn.detach()
    scale = REFERENCE_STEPS / trajectories.shape[-2]
    return scale * value.sum(-1), scale * project(links, force, moment)


def plain_gaps(tables: Tables, stage: BodyTables, trajectories: Tensor) -> tuple[Tensor, Tensor]:
    """Return the gaps (B, P, T) m of a stage's spheres to obstacles, and to one another.

    Spheres on link 0 are left out of the first, and the second is at most `SELF_HORIZON`.

    Args:
        tables: of the chain.
        stage: spheres and obstacles.
        trajectories: (B, P, T, n) rad.
    """
    links = chain(tables, trajectories)
    placed, link = _placed(links, stage)
    distance, _ = obstacle_distance(placed.flatten(1, 3), stage)
    radius = stage.spheres[:, None, None, :, 3]
    gap = distance.reshape(placed.shape[:-1]) - radius
    gap = torch.where((link > 0)[:, None, None], gap, torch.inf).amin(-1)
    own = torch.full_like(gap, SELF_HORIZON)
    for inner, outer in stage.pair_links:
        near, place = _spheres_of(inner, stage)
        for row in range(int(stage.offsets[:, outer].min()), placed.shape[-2]):
            mine = link[:, row] == outer
            if not bool(mine.any()):
                break
            bits = stage.pair_masks[:, row, inner, None] >> place.clamp(0, 63)
            paired = mine[:, None] & (place >= 0) & (place < 63) & ((bits & 1) == 1)
            apart = placed[..., near, :] - placed[..., row : row + 1, :]
            apart = torch.linalg.vector_norm(apart, dim=-1)
            apart = apart - radius[..., near] - radius[..., row : row + 1]
            own = torch.minimum(own, torch.where(paired[:, None, None], apart, torch.inf).amin(-1))
    return gap, own


def velocity_cost(tables: Tables, trajectories: Tensor) -> ValueAndGradient:
    """Return the squared relative excess over the velocity limits (B, P), and its gradient."""
    share = trajectories.diff(dim=-2) * tables.per_step
    excess = share - share.clamp(-1.0, 1.0)
    scale = REFERENCE_STEPS / (trajectories.shape[-2] - 1)
    parts = torch.nn.functional.pad(2.0 * scale * tables.per_step * excess, (0, 0, 1, 1))
    return scale * excess.square().sum((-1, -2)), -parts.diff(dim=-2)


def limit_cost(tables: Tables, trajectories: Tensor) -> ValueAndGradient:
    """Return the squared excess over the joint limits (B, P), and its gradient."""
    excess = trajectories - trajectories.clamp(tables.lower, tables.upper)
    scale = REFERENCE_STEPS / trajectories.shape[-2]
    return scale * excess.square().sum((-1, -2)), 2.0 * scale * excess


def tool_cost(tables: Tables, tool: ToolTables, trajectories: Tensor) -> ValueAndGradient:
    """Return C_mod of boxes for carried points (B, P), and its gradient; see `mixture_cost`."""
    batch, particles, _, joints = trajectories.shape
    step = tool.step.long()[:, None, :, None].expand(batch, particles, -1, joints)
    share = tool.share[:, None, :, None]
    due = (1.0 - share) * trajectories.gather(2, step) + share * trajectories.gather(2, step + 1)
    links = chain(tables, due)
    last = links.rotation[..., -1, :, :]
    points = links.position[..., -1, :] + (last @ tool.point[:, None, ..., None])[..., 0]
    lower, upper = tool.lower[:, None], tool.upper[:, None]
    offset = (points - points.clamp(lower, upper)) / tool.sigma
    joint = tool.log_weight[:, None] - 0.5 * offset.square().sum(-1)
    # One row of options for each group; a group of none has the logarithm of 1.
    groups = torch.arange(1, tool.group.shape[1] + 1, device=points.device)
    member = tool.group[:, None] == groups[:, None]
    empty = ~member.any(-1)
    options = torch.where(member[:, None], joint[..., None, :], -torch.inf)
    options = torch.where(empty[:, None, :, None], 0.0, options)
    total = options.logsumexp(-1)
    total = torch.where(empty[:, None], 0.0, total)
    share_of = torch.where(member[:, None], (options - total[..., None]).exp(), 0.0).sum(-2)
    pull = share_of[..., None] * offset / tool.sigma
    force, moment = torch.zeros_like(links.position), torch.zeros_like(links.position)
    force[..., -1, :] = pull.detach()
    moment[..., -1, :] = torch.linalg.cross(points, pull).detach()
    torque = project(links, force, moment)
    gradient = torch.zeros_like(trajectories)
    gradient.scatter_add_(2, step, (1.0 - share) * torque)
    gradient.scatter_add_(2, step + 1, share * torque)
    return -total.sum(-1), gradient


class PlainCosts:
    """The costs of B problems by torch's own operations, in any dtype and on any device.

    Args:
        tables: the problems.
    """

    def __init__(self, tables: Tables) -> None:
        self.tables = tables

    def gradient(self, trajectories: Tensor, width: float) -> Tensor:
        """Return the gradient (B, P, T, n) of the weighted sum of costs.

        Args:
            trajectories: (B, P, T, n) rad.
            width: m, of the map's edge.
        """
        return self.weighted(trajectories, width)[1]

    def weighted(self, trajectories: Tensor, width: float) -> ValueAndGradient:
        """Return the weighted sum (B, P) of costs, and its gradient (B, P, T, n)."""
        weights = dict(zip(WEIGHTED, self.tables.weights, strict=True))
        found = self._costs(trajectories, width, self.tables.margin)
        parts = [
            (weights.get(name, 1.0) * value, weights.get(name, 1.0) * gradient)
            for name, (value, gradient) in found.items()
            if weights.get(name, 1.0) > 0.0
        ]
        values, gradients = zip(*parts, strict=True)
        return torch.stack(values).sum(0), torch.stack(gradients).sum(0)

    def weighted_sum(self, trajectories: Tensor) -> Tensor:
        """Return the weighted sums (B, P) of costs, with the edge at its last width."""
        return self.weighted(trajectories, self.tables.edge_width[1])[0]

    def costs(self, trajectories: Tensor) -> dict[str, Tensor]:
        """Return the unweighted costs (B, P) by name, with the edge at its last width."""
        found = self._costs(trajectories, self.tables.edge_width[1], 0.0)
        return {name: value for name, (value, _) in found.items()}

    def _costs(
        self, trajectories: Tensor, width: float, margin: float
    ) -> dict[str, ValueAndGradient]:
        tables = self.tables
        value = trajectories.new_zeros(trajectories.shape[:2])
        gradient = torch.zeros_like(trajectories)
        for stage in tables.stages:
            part = trajectories[:, :, stage.first : stage.last]
            found, slope = obstacle_cost(tables, stage, part, width, margin)
            value = value + found
            gradient[:, :, stage.first : stage.last] += slope.detach()
        return {
            "obstacles": (value, gradient),
            "self_collision": self_cost(tables, trajectories),
            "velocity": velocity_cost(tables, trajectories),
            "joint_limits": limit_cost(tables, trajectories),
            **{name: tool_cost(tables, t, trajectories) for name, t in tables.tools.items()},
        }
