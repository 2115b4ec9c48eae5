"""Constraints on trajectories: via-points, boxes, choices, poses, goal regions, Eq. (13), (14).

Each constraint enters twice: in closed form, by conditioning the primitive, and through a cost
that pulls on what conditioning leaves open. Which points or boxes are options of one constraint is
a mixture, C_mod = -log Σ π_h N(Φ_t w; μ_h, Σ_h).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_planner.collision.costs import Cost, ValueAndGradient, check_trajectories
from smp_planner.collision.robot_model import RobotModel
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.box_prior import SmoothBox, box_offset
from smp_planner.planning.postures import final_posture, pose_chain
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint, ViaPose

__all__ = [
    "Constraint",
    "Exactly",
    "Passing",
    "Place",
    "Poses",
    "Reaching",
    "ToolBoxes",
    "ToolPath",
    "at_phases",
    "mixture_cost",
    "segments",
    "spread_to_steps",
]

GOAL_STD = 0.005
"""Standard deviation, m, with which the primitive is conditioned on the goal point."""

POSTURE_STD = 0.1
"""Standard deviation, rad, that the final posture keeps around the one found for the goal."""

VIA_POSE_STD = 0.002
"""Standard deviation, rad, with which the primitive is conditioned on a via-pose."""

VIA_STD = 0.02
"""Standard deviation, m, with which the primitive is conditioned on via-points of the tool."""

TOLERANCE_STDS = 3.0
"""Standard deviations of the conditioned primitive that a via-point's tolerance is."""

_VIA_ITERATIONS = 8

_LEAST_STD = 1e-6
"""Extents, standard deviation that evidence is computed with where a primitive has none."""

_ROUNDING = 1e-9
"""Extents by which a point may be missed that was met."""


class Constraint(Protocol):
    """Protocol of constraints on a trajectory at one or more phases."""

    @property
    def name(self) -> str:
        """Name by which the user calls it."""
        ...

    @property
    def phases(self) -> tuple[float, ...]:
        """Phases in [0, 1] at which it holds a trajectory."""
        ...

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior for each option that it leaves, with its log-evidence."""
        ...

    def cost(self, settings: PlanSettings) -> Cost | None:
        """Return its cost C_mod; None where conditioning is all."""
        ...

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the violation (P,) of trajectories (P, T, D), a distance; 0 if they satisfy it."""
        ...

    def slack(self, settings: PlanSettings) -> float:
        """Return the largest violation that still counts as satisfied."""
        ...


def segments(count: int, phases: ArrayLike) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the segments of `count` equal steps that phases (H,) lie on, and where on them."""
    at = np.atleast_1d(np.asarray(phases, np.float64)) * (count - 1)
    first = np.minimum(at.astype(np.int64), count - 2)
    return first, at - first


def at_phases(trajectories: FloatArray, phases: ArrayLike) -> FloatArray:
    """Return the points (P, H, D) of trajectories (P, T, D) at phases, straight between samples."""
    first, share = segments(trajectories.shape[1], phases)
    share = share[:, None]
    return np.asarray((1.0 - share) * trajectories[:, first] + share * trajectories[:, first + 1])


def spread_to_steps(gradient: FloatArray, phases: ArrayLike, steps: int) -> FloatArray:
    """Return the gradient (P, T, D) by the samples of one (P, H, D) by points at phases (H,)."""
    first, share = segments(steps, phases)
    shares = np.zeros((steps, len(first)))
    of_points = np.arange(len(first))
    shares[first, of_points] = 1.0 - share
    shares[first + 1, of_points] += share
    return np.asarray(shares @ gradient)


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


def mixture_weights(
    variance: FloatArray, widths: FloatArray, shares: Sequence[float]
) -> FloatArray:
    """Return log(π_h / Z_h) (H,) of `mixture_cost`, Z_h relative to the least of them."""
    volume = np.log(widths + np.sqrt(2.0 * math.pi * variance)).sum(axis=-1)
    return np.asarray(np.log(np.asarray(shares)) - (volume - volume.min()))


def mixture_cost(
    offsets: FloatArray, variance: FloatArray, widths: FloatArray, shares: Sequence[float]
) -> ValueAndGradient:
    """Return C_mod of a choice of boxes, and its gradients by the point of each.

    Of one box it is Σ d² / (2 σ²), Eq. (14), the reading that makes it the negative logarithm of
    Gaussian tails; of several, -log Σ π_h exp(-d_h² / (2 σ_h²)) / Z_h with the normalising
    constants Z_h relative to the least of them, so that it is log(H) or less inside the narrowest
    of boxes of equal shares.

    Args:
        offsets: (H, P, d) from `box_offset`, of H boxes.
        variance: (H, d) σ² of the tails.
        widths: (H, d) of the boxes.
        shares: π_h, H positive numbers that sum to one.

    Returns:
        (P,), and (H, P, d).
    """
    scaled = offsets / np.sqrt(variance)[:, None]
    joint = mixture_weights(variance, widths, shares)[:, None]
    joint = joint - 0.5 * np.square(scaled).sum(axis=-1)
    largest = joint.max(axis=0)
    membership = np.exp(joint - largest)
    total = membership.sum(axis=0)
    gradient = (membership / total)[..., None] * (offsets / variance[:, None])
    return -(largest + np.log(total)), gradient


@dataclass(frozen=True, eq=False)
class Exactly:
    """A position or a velocity that the trajectory has with certainty.

    Attributes:
        name: what it is called.
        phase: in [0, 1].
        value: (D,) position, or velocity with respect to phase.
        derivative: whether `value` is a velocity.
    """

    name: str
    phase: float
    value: FloatArray
    derivative: bool = False

    @property
    def phases(self) -> tuple[float, ...]:
        """Phase of the position or velocity."""
        return (self.phase,)

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior after an exact observation."""
        value = torch.from_numpy(self.value)
        return [(primitive.condition(self.phase, value, derivative=self.derivative), 0.0)]

    def cost(self, settings: PlanSettings) -> Cost | None:
        """Return None: conditioning is all."""
        return None

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) from the position; 0 for a velocity."""
        if self.derivative:
            return np.zeros(len(trajectories))
        there = at_phases(trajectories, self.phase)[:, 0]
        return np.asarray(np.linalg.norm(there - self.value, axis=-1))

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`."""
        return settings.sigma


@dataclass(frozen=True, eq=False)
class Place:
    """One option of `Passing`, in the coordinates of the path.

    Attributes:
        box: where the cost is zero, and its tails.
        point: (D,) to be passed; None for a box.
        tolerance: distance from the point that may remain.
        share: π_h.
    """

    box: SmoothBox
    point: FloatArray | None
    tolerance: float
    share: float

    def missed(self, points: FloatArray) -> FloatArray:
        """Return the distance (...) of points (..., D) to the place; 0 within it."""
        if self.point is None:
            outside = box_offset(points, self.box.lower.numpy(), self.box.upper.numpy())
            return np.asarray(np.linalg.norm(outside, axis=-1))
        distance = np.linalg.norm(points - self.point, axis=-1)
        return np.where(distance <= self.tolerance + _ROUNDING, 0.0, distance - self.tolerance)

    def condition(self, primitive: ProMP, phase: float) -> tuple[ProMP, float]:
        """Return the posterior after the place was observed, and the log of share and density.

        A box is observed as the Gaussian that has its moments: its middle, a third of its squared
        half extents and the variance of its tails.
        """
        if self.point is None:
            value = (self.box.lower + self.box.upper) / 2
            noise = ((self.box.upper - self.box.lower) / 2).square() / 3 + self.box.variance
        else:
            value = torch.from_numpy(self.point)
            noise = torch.full_like(value, (self.tolerance / TOLERANCE_STDS) ** 2)
        mean, covariance = primitive.marginal(phase)
        density = torch.distributions.MultivariateNormal(
            mean, covariance + torch.diag(noise + _LEAST_STD**2)
        )
        evidence = math.log(self.share) + float(density.log_prob(value))
        return primitive.condition(phase, value, noise), evidence


@dataclass(frozen=True, eq=False)
class Passing:
    """Alternative places that the path passes at a phase.

    Attributes:
        name: what the user calls it.
        phase: in [0, 1].
        places: at least one.
    """

    name: str
    phase: float
    places: tuple[Place, ...]

    @property
    def phases(self) -> tuple[float, ...]:
        """The phase at which a place is passed."""
        return (self.phase,)

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) of trajectories (P, T, D) to the nearest place."""
        points = at_phases(trajectories, self.phase)[:, 0]
        return np.asarray(np.min([place.missed(points) for place in self.places], axis=0))

    def cost(self, settings: PlanSettings) -> Cost:
        """Return `mixture_cost` of the places' boxes."""
        boxes = [place.box for place in self.places]
        lower, upper = (
            np.stack([getattr(b, n).numpy() for b in boxes]) for n in ("lower", "upper")
        )
        variance = np.stack([box.variance.numpy() for box in boxes])
        shares = [place.share for place in self.places]

        def cost(trajectories: ArrayLike) -> ValueAndGradient:
            paths = check_trajectories(trajectories, lower.shape[1])
            points = at_phases(paths, self.phase)[:, 0]
            offsets = box_offset(points, lower[:, None], upper[:, None])
            value, slopes = mixture_cost(offsets, variance, upper - lower, shares)
            return value, spread_to_steps(slopes.sum(axis=0)[:, None], self.phase, paths.shape[1])

        return cost

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior for each place with its log-evidence."""
        return [place.condition(primitive, self.phase) for place in self.places]

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`."""
        return settings.sigma


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
        """Return `mixture_cost` of the regions, for the tool at the end of the trajectory."""
        lower, upper, _ = self.boxes(settings)
        variance = np.full(lower.shape, settings.sigma**2)

        own = np.stack([goal.point for goal in self.goals])
        distinct, which = np.unique(own, axis=0, return_inverse=True)

        def cost(trajectories: ArrayLike) -> ValueAndGradient:
            paths = check_trajectories(trajectories, self.robot.joints)
            ends = np.ascontiguousarray(paths[:, -1])
            carried = [self.robot.carried_points(ends, point) for point in distinct]
            points = np.stack([carried[k][0] for k in which.ravel()])
            offsets = box_offset(points, lower[:, None], upper[:, None])
            value, slopes = mixture_cost(offsets, variance, upper - lower, self.shares)
            gradient = np.zeros(paths.shape)
            for k, (_, jacobians) in enumerate(carried):
                pull = slopes[which.ravel() == k].sum(axis=0)
                gradient[:, -1] += (pull[:, None] @ jacobians)[:, 0]
            return value, gradient

        return cost

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

    Raises:
        ValueError: a via-point with an orientation, which is for `ToolPassing`.
    """

    via_points: tuple[ToolViaPoint, ...]
    robot: RobotModel
    name: str = "via_points"

    def __post_init__(self) -> None:
        _refuse_orientations("via_points", self.via_points)

    @property
    def phases(self) -> tuple[float, ...]:
        """Phases of the via-points."""
        return tuple(via.phase for via in self.via_points)

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the largest distance (P,) m to a via-point.

        Via-points are to be passed in their order: each is passed not before the one before it. Of
        all choices of moments in that order, the one whose worst miss is least counts.
        """
        worst = np.zeros(trajectories.shape[:2])
        before = None
        for via in self.via_points:
            if before is None or (via.point != before).any():
                points = self.robot.carried_points(trajectories, via.point)[0]
                before = via.point
            missed = np.linalg.norm(points - via.position, axis=-1) - via.tolerance
            worst = np.minimum.accumulate(np.maximum(worst, missed), axis=1)
        return np.asarray(worst.min(axis=1))

    def boxes(self, settings: PlanSettings) -> ToolBoxes:
        """Return boxes that reach `PlanSettings.via_share` of the tolerance to each side."""
        places = np.array([via.position for via in self.via_points])
        half = settings.via_share * np.array([[via.tolerance] for via in self.via_points])
        return ToolBoxes(places - half, places + half, np.zeros(len(places)))

    def cost(self, settings: PlanSettings) -> Cost:
        """Return the sum of the boxes' costs, Eq. (14), for the tool when they are due."""
        lower, upper, _ = self.boxes(settings)

        def cost(trajectories: ArrayLike) -> ValueAndGradient:
            paths = check_trajectories(trajectories, self.robot.joints)
            due = at_phases(paths, self.phases)
            points, jacobians = self._carried(due)
            offset = box_offset(points, lower, upper) / settings.sigma
            slopes = ((offset / settings.sigma)[..., None, :] @ jacobians)[..., 0, :]
            value = 0.5 * np.square(offset).sum(axis=(1, 2))
            return value, spread_to_steps(slopes, self.phases, paths.shape[1])

        return cost

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
        unit = torch.eye(root.shape[1], dtype=dtype)
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
            latent = torch.linalg.solve(scaled.mT @ scaled + unit, scaled.mT @ residual)
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
        name: what the user calls it.
    """

    via_poses: tuple[ViaPose, ...]
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
        """Return zeros (P,): particles take the poses as the primitive does."""
        return np.zeros(len(trajectories))

    def slack(self, settings: PlanSettings) -> float:
        """Return 0."""
        return 0.0
