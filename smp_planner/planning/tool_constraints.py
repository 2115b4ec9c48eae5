"""Constraints on the tool of the tasks' arm: goal regions, via-points in their order, poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from smp_gym.arrays import FloatArray, checked_count
from smp_gym.geometry.polylines import equal_arc_chords
from smp_planner.collision.costs import Cost, ValueAndGradient
from smp_planner.collision.robot_model import RobotModel
from smp_planner.movement_primitives import ProMP
from smp_planner.planning.constraints import at_phases, mixture_weights
from smp_planner.planning.postures import final_posture, pose_chain
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_box_cost import ToolBoxCost
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint, ViaPose

__all__ = ["Poses", "Reaching", "ToolBoxes", "ToolPath"]

GOAL_STD = 0.005
"""Standard deviation, m, with which the primitive is conditioned on the goal point."""

POSTURE_STD = 0.1
"""Standard deviation, rad, that the final posture keeps around the one found for the goal."""

VIA_POSE_STD = 0.002
"""Standard deviation, rad, with which the primitive is conditioned on a via-pose."""

POSE_TOLERANCE = 0.02
"""Distance, m, from its place in a via-pose up to which a point of the hand's frame has taken it:
far more than conditioning leaves open."""

_POSE_POINTS = 0.1 * np.concatenate([np.zeros((1, 3)), np.eye(3)])
"""(4, 3) m, points of the hand's frame whose places make up a pose."""

VIA_STD = 0.02
"""Standard deviation, m, with which the primitive is conditioned on via-points of the tool."""

_VIA_ITERATIONS = 8

_CHORD_PARTS = 4
"""Parts of the straight line between two recorded points of the tool's path, at whose ends its
distance to via-points is measured."""

_AT_REST = 1e-8
"""Standard deviations of the primitive: smaller changes end the search for a trajectory."""


def _refuse_orientations(name: str, places: Sequence[GoalRegion | ToolViaPoint]) -> None:
    for index, place in enumerate(places):
        if place.orientation is not None:
            raise ValueError(
                f"{name}[{index}].orientation must be None here, got {place.orientation!r}"
            )


class ToolBoxes(NamedTuple):
    """Boxes in which a point carried by the hand must be.

    Attributes:
        lower: (H, 3) m.
        upper: (H, 3) m.
        log_weight: (H,) as of `mixture_weights`, where they are options; 0 where each must be met.
    """

    lower: FloatArray
    upper: FloatArray
    log_weight: FloatArray


@dataclass(frozen=True, eq=False)
class Reaching:
    """Goal regions, in one of which the tool is at the end of the trajectory.

    Attributes:
        goals: at least one region.
        robot: whose tool it is.
        shares: π_h, positive; equal by default. They are scaled to sum to one.
        name: what the user calls it.

    Raises:
        ValueError: no region, one with an orientation, which is for `ToolPassing`, or `shares` are
            not as many positive numbers.
    """

    goals: tuple[GoalRegion, ...]
    robot: RobotModel
    shares: tuple[float, ...] = ()
    name: str = "goal"

    def __post_init__(self) -> None:
        if not len(self.goals):
            raise ValueError("goals must hold at least one GoalRegion, got none")
        _refuse_orientations("goals", self.goals)
        shares = np.asarray(self.shares or np.ones(len(self.goals)), np.float64)
        if shares.shape != (len(self.goals),) or not (np.isfinite(shares) & (shares > 0)).all():
            raise ValueError(
                f"shares must be {len(self.goals)} positive numbers, got {self.shares}"
            )
        object.__setattr__(self, "shares", tuple((shares / shares.sum()).tolist()))

    @property
    def phases(self) -> tuple[float, ...]:
        """Phase of the end, 1."""
        return (1.0,)

    def distances(self, trajectories: FloatArray) -> FloatArray:
        """Return the distances (H, P) m of the tool to each region at the ends of (P, T, n) rad."""
        ends = np.ascontiguousarray(trajectories[:, -1])
        return np.array(
            [goal.distance(self.robot.carried_points(ends, goal.point)[0]) for goal in self.goals]
        )

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) m of the tool to the nearest region at the end."""
        return np.asarray(self.distances(trajectories).min(axis=0))

    def boxes(self, settings: PlanSettings) -> ToolBoxes:
        """Return the regions as options of one mixture."""
        lower = np.stack([goal.lower for goal in self.goals])
        upper = np.stack([goal.upper for goal in self.goals])
        variance = np.full(lower.shape, settings.sigma**2)
        return ToolBoxes(lower, upper, mixture_weights(variance, upper - lower, self.shares))

    def cost(self, settings: PlanSettings) -> Cost:
        """Return the cost of a choice of the regions, for the tool at the end."""
        lower, upper, log_weight = self.boxes(settings)
        points = np.stack([goal.point for goal in self.goals])
        phases = self.phases * len(points)
        return ToolBoxCost(self.robot, points, phases, lower, upper, settings.sigma, log_weight)

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the primitive conditioned on the likeliest posture that reaches a region.

        Raises:
            UnreachableError: no region is reached.
        """
        mean, covariance = primitive.marginal(1.0)
        posture = final_posture(mean.numpy(), covariance.numpy(), self.goals, self.robot, GOAL_STD)
        goal = min(
            self.goals,
            key=lambda g: float(
                np.linalg.norm(self.robot.carried_points(posture, g.point)[0] - g.center)
            ),
        )
        jacobian = self.robot.carried_points(posture, goal.point)[1] / GOAL_STD
        information = jacobian.T @ jacobian + np.eye(len(posture)) / POSTURE_STD**2
        noise = torch.from_numpy(np.linalg.inv(information))
        posterior = primitive.condition(1.0, torch.from_numpy(posture), (noise + noise.mT) / 2)
        return [(posterior, 0.0)]

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`."""
        return settings.sigma


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Via-points that the tool passes in their order.

    Attributes:
        via_points: at least one, in the order of their phases.
        robot: whose tool it is.
        name: what the user calls it.
        traced: points at equal steps of its arc by which the tool's path is recorded, where what is
            recorded has to pass the via-points, which cuts the corners of the path; by default the
            path itself has to.

    Raises:
        ValueError: a via-point with an orientation, which is for `ToolPassing`, or `traced` is
            neither None nor a whole number from 2 on.
    """

    via_points: tuple[ToolViaPoint, ...]
    robot: RobotModel
    name: str = "via_points"
    traced: int | None = None

    def __post_init__(self) -> None:
        _refuse_orientations("via_points", self.via_points)
        if self.traced is not None:
            checked_count("traced", self.traced, least=2)

    @property
    def phases(self) -> tuple[float, ...]:
        """Phases of the via-points."""
        return tuple(via.phase for via in self.via_points)

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the largest distance (P,) m to a via-point.

        Via-points are to be passed in their order: each is passed not before the one before it. Of
        all choices of moments in that order, the one whose worst miss is least counts.
        """
        worst = np.zeros((len(trajectories), 1))
        before = None
        for via in self.via_points:
            if before is None or (via.point != before).any():
                points = self._recorded(trajectories, via.point)
                before = via.point
            missed = np.linalg.norm(points - via.position, axis=-1) - via.tolerance
            worst = np.minimum.accumulate(np.maximum(worst, missed), axis=1)
        return np.asarray(worst.min(axis=1))

    def _recorded(self, trajectories: FloatArray, point: FloatArray) -> FloatArray:
        """Return the path (P, M, 3) m of a point carried by the tool, as it is recorded."""
        path = self.robot.carried_points(trajectories, point)[0]
        if self.traced is None:
            return path
        return equal_arc_chords(np.ascontiguousarray(path, np.float64), self.traced, _CHORD_PARTS)

    def boxes(self, settings: PlanSettings) -> ToolBoxes:
        """Return boxes that reach `PlanSettings.via_share` of the tolerance to each side."""
        places = np.array([via.position for via in self.via_points])
        half = settings.via_share * np.array([[via.tolerance] for via in self.via_points])
        return ToolBoxes(places - half, places + half, np.zeros(len(places)))

    def cost(self, settings: PlanSettings) -> Cost:
        """Return the sum of the boxes' costs, Eq. (14), for the tool when they are due."""
        lower, upper, _ = self.boxes(settings)
        points = np.stack([via.point for via in self.via_points])
        return ToolBoxCost(self.robot, points, self.phases, lower, upper, settings.sigma)

    def _carried(self, due: FloatArray) -> ValueAndGradient:
        """Return the points (P, H, 3) that (P, H, n) rad carry, and their Jacobians."""
        point = self.via_points[0].point
        if all((via.point == point).all() for via in self.via_points):
            return self.robot.carried_points(due, point)
        carried = [
            self.robot.carried_points(due[:, h], via.point) for h, via in enumerate(self.via_points)
        ]
        points, jacobians = zip(*carried, strict=True)
        return np.stack(points, axis=1), np.stack(jacobians, axis=1)

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the primitive conditioned on the via-points, linearised where they are met.

        The most likely trajectory that passes them up to `VIA_STD` is found by Gauss-Newton in
        the coordinates of the primitive's square root; about it the tool's place is taken to be
        linear in the weights (Laplace's approximation).
        """
        dtype = primitive.mean.dtype
        places = np.array([via.position for via in self.via_points])
        identity = torch.eye(primitive.dimension, dtype=dtype)
        values = primitive.basis.values(torch.tensor(self.phases, dtype=dtype))
        root = primitive.root
        unit = torch.eye(places.size, dtype=dtype)
        latent = torch.zeros(root.shape[1], dtype=dtype)
        rows, value = torch.empty(0), torch.empty(0)
        for _ in range(_VIA_ITERATIONS):
            weights = primitive.mean + root @ latent
            q = (values @ weights.reshape(-1, primitive.dimension)).numpy()
            points, jacobians = (found[0] for found in self._carried(q[None]))
            target = places - points + np.einsum("kij,kj->ki", jacobians, q)
            jacobian = torch.from_numpy(np.ascontiguousarray(jacobians))
            by_joint = torch.einsum("kij,kb,jd->kibd", jacobian, values, identity)
            rows = by_joint.reshape(-1, primitive.mean.shape[-1])
            value = torch.from_numpy(target).ravel()
            scaled = rows @ root / VIA_STD
            residual = (value - rows @ primitive.mean) / VIA_STD
            before = latent
            latent = scaled.mT @ torch.linalg.solve(scaled @ scaled.mT + unit, residual)
            if float((latent - before).abs().max()) < _AT_REST:
                break
        noise = torch.full((len(rows),), VIA_STD**2, dtype=dtype)
        return [(primitive.observe(rows, value, noise), 0.0)]

    def slack(self, settings: PlanSettings) -> float:
        """Return 0: each via-point has its tolerance."""
        return 0.0


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses that the hand takes one after the other.

    Attributes:
        via_poses: at least one, in the order of their phases.
        robot: whose hand it is.
        name: what the user calls it.
    """

    via_poses: tuple[ViaPose, ...]
    robot: RobotModel
    name: str = "via_poses"

    @property
    def phases(self) -> tuple[float, ...]:
        """Phases of the poses."""
        return tuple(via.phase for via in self.via_poses)

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the primitive conditioned on configurations that take the poses.

        Raises:
            UnreachableError: a via-pose is out of reach.
        """
        rest = torch.zeros(primitive.dimension, dtype=torch.float64)
        spread = VIA_POSE_STD**2 * torch.eye(primitive.dimension, dtype=torch.float64)
        expected = primitive.marginal(self.via_poses[-1].phase)[0].numpy()
        chain = pose_chain([via.pose for via in self.via_poses], expected)
        for via, configuration in zip(self.via_poses, chain, strict=True):
            primitive = primitive.condition(via.phase, torch.from_numpy(configuration), spread)
            if via.rest:
                primitive = primitive.condition(via.phase, rest, derivative=True)
        return [(primitive, 0.0)]

    def cost(self, settings: PlanSettings) -> Cost | None:
        """Return None: conditioning is all."""
        return None

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return by how much (P,) m the hand misses a pose, less `POSE_TOLERANCE`.

        That is the largest distance of a point of its frame, the origin or one 0.1 m along an axis,
        from where it is in the pose.
        """
        due = np.ascontiguousarray(at_phases(trajectories, self.phases))
        poses = np.stack([via.pose for via in self.via_poses])
        worst = np.zeros(len(trajectories))
        for point in _POSE_POINTS:
            asked = poses[:, :3, :3] @ point + poses[:, :3, 3]
            away = np.linalg.norm(self.robot.carried_points(due, point)[0] - asked, axis=-1)
            worst = np.maximum(worst, away.max(axis=1))
        return worst - POSE_TOLERANCE

    def slack(self, settings: PlanSettings) -> float:
        """Return 0: the tolerance is that of all poses."""
        return 0.0
