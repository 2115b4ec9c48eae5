"""Costs of trajectories, each with its gradient: obstacles, the arm itself, limits, points, goals.

A cost is called with trajectories (P,T,n) rad, at equal steps of phase, and returns its value (P,)
and its gradient (P,T,n), both float64. Calling with anything else raises a ValueError.

A weight (the paper's lambda, Eq. (6)) keeps its meaning when T changes: what is summed along the
trajectory is scaled to `REFERENCE_STEPS` steps. So weight 1 with T = 200 pulls as hard as with
T = 50, and Eq. (12) is met literally at T = 50.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_planner.collision import kernels as compiled
from smp_planner.collision.robot_model import RobotModel
from smp_planner.occupancy.grid import DistanceGrid
from smp_planner.planning.problem import GoalRegion

__all__ = [
    "REACH",
    "REFERENCE_STEPS",
    "VELOCITY_FRACTION",
    "CarriedBoxCost",
    "CollisionCost",
    "Cost",
    "GoalCost",
    "JointLimitCost",
    "SelfCollisionCost",
    "VelocityLimitCost",
    "ViaPointCost",
    "carried_via_point_cost",
    "check_trajectories",
]

FloatArray = NDArray[np.float64]
ValueAndGradient = tuple[FloatArray, FloatArray]

REFERENCE_STEPS = 50
"""Steps to which sums along a trajectory are scaled, whatever its T."""

REACH = 6.0
"""Edge widths from a sphere's surface at which its occupancy counts as zero (p^2 = 6e-6 there)."""

VELOCITY_FRACTION = 0.9
"""Share of a joint's velocity limit that plans may use: up to it the grasp is known to hold."""


class Cost(Protocol):
    """A cost of whole trajectories that needs no further argument."""

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return the value (P,) and the gradient (P,T,n) of trajectories (P,T,n) rad."""
        ...


def check_trajectories(trajectories: ArrayLike, joints: int | None = None) -> FloatArray:
    """Return trajectories as a contiguous float64 array (P,T,n).

    Raises:
        ValueError: not three axes, no step, the wrong number of joints, or not finite.
    """
    array = np.ascontiguousarray(trajectories, np.float64)
    width = "n" if joints is None else joints
    if array.ndim != 3 or array.shape[1] == 0 or array.shape[2] != (joints or array.shape[-1]):
        raise ValueError(f"trajectories must have shape (P, T, {width}), got {array.shape}")
    if not np.isfinite(array).all():
        p, t, j = np.argwhere(~np.isfinite(array))[0]
        raise ValueError(
            f"trajectories must be finite, got {array[p, t, j]} in particle {p}, step {t}, "
            f"joint {j}"
        )
    return array


def _steps_last(trajectories: FloatArray) -> FloatArray:
    """Return (P,n,T), the order of `smp_planner.collision.kernels`."""
    return np.ascontiguousarray(trajectories.swapaxes(1, 2))


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)


def _scales(name: str, value: ArrayLike, size: int) -> FloatArray:
    array = np.asarray(value, np.float64)
    if array.shape not in ((), (size,)) or not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"{name} must be a positive number or {size} of them, got {value!r}")
    return np.broadcast_to(array, (size,))


def _steps(steps: ArrayLike) -> NDArray[np.int64]:
    array = np.atleast_1d(np.asarray(steps))
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer) or not len(array):
        raise ValueError(f"steps must be one or more integers, got {steps!r}")
    return array.astype(np.int64)


def _inside(steps: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return steps counted from the front; negative ones count from the end."""
    if not ((steps >= -count) & (steps < count)).all():
        raise ValueError(f"steps must lie in [-{count}, {count}) for T = {count}, got {steps}")
    return steps % count


def _points(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, np.float64)
    if array.shape == shape[1:]:
        array = np.broadcast_to(array, shape)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape} or {shape[1:]}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array}")
    return array


def _scatter(shape: tuple[int, ...], steps: NDArray[np.int64], parts: FloatArray) -> FloatArray:
    """Return zeros (P,T,n) with parts (P,H,n) added at steps (H,), of which some may be equal."""
    gradient = np.zeros(shape)
    for h, step in enumerate(steps):
        gradient[:, step] += parts[:, h]
    return gradient


@dataclass(frozen=True)
class CollisionCost:
    """Squared occupancy of the link spheres, Eq. (12).

    The map is asked at every sphere that moves: p = sigma(-(d - r - margin) / edge_width) with d
    the distance of the centre to the nearest obstacle and r the radius. Summed is p^2 less the
    value that it has where the map is cut off or `REACH` edge widths away, whichever is nearer: a
    sphere far from everything costs exactly nothing, and nothing is computed for it.

    Attributes:
        robot: the arm and what it carries; spheres on link 0 do not move and are left out.
        grid: the scene's map.
    """

    robot: RobotModel
    grid: DistanceGrid

    @cached_property
    def _truncation(self) -> float:
        return float(self.grid.values.max())

    @cached_property
    def _blocks(self) -> NDArray[np.float32]:
        return compiled.least_of_blocks(self.grid.values)

    @property
    def summed_spheres(self) -> int:
        """Number of spheres in the sum; a weight is worth stating only together with it."""
        return int(np.count_nonzero(self.robot.link))

    def __call__(
        self, trajectories: ArrayLike, edge_width: float = 0.01, margin: float = 0.0
    ) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n).

        Args:
            trajectories: (P,T,n) rad.
            edge_width: m, scale of the sigmoid; wide edges reach farther, narrow ones are sharper.
            margin: m, by which every sphere is enlarged.

        Raises:
            ValueError: wrong shape or not finite, or `edge_width` is not positive.
        """
        q = check_trajectories(trajectories, self.robot.joints)
        width = _positive("edge_width", edge_width)
        if not math.isfinite(margin):
            raise ValueError(f"margin must be finite, got {margin}")
        robot, grid = self.robot, self.grid
        limit = np.minimum(robot.radius + margin + REACH * width, self._truncation)
        value, gradient = np.empty(len(q)), np.empty((len(q), robot.joints, q.shape[1]))
        compiled.map_collision(
            _steps_last(q),
            robot.base,
            robot.joint_origins,
            robot.link,
            robot.center,
            robot.radius,
            grid.values,
            grid.origin,
            1.0 / grid.spacing,
            self._blocks,
            limit,
            width,
            float(margin),
            value,
            gradient,
        )
        scale = REFERENCE_STEPS / q.shape[1]
        return scale * value, scale * np.ascontiguousarray(gradient.swapaxes(1, 2))


@dataclass(frozen=True)
class SelfCollisionCost:
    """Squared occupancy of the arm's spheres by one another, in the manner of Eq. (12).

    For each pair of `RobotModel.collision_pairs`, p = sigma(-(gap - margin) / edge_width) with the
    gap between the two surfaces; p^2, less its value at `margin` + `REACH` edge widths, is summed.

    Attributes:
        robot: the arm and what it carries.
        edge_width: m.
        margin: m, gap at which the occupancy is one half.
    """

    robot: RobotModel
    edge_width: float = 0.005
    margin: float = 0.0

    def __post_init__(self) -> None:
        _positive("edge_width", self.edge_width)
        if not (math.isfinite(self.margin) and self.margin > -REACH * self.edge_width):
            raise ValueError(
                f"margin must be above {-REACH * self.edge_width} (minus {REACH} edge widths), "
                f"got {self.margin}"
            )

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        q = check_trajectories(trajectories, self.robot.joints)
        robot, pairs = self.robot, self.robot.link_pairs
        value, gradient = np.empty(len(q)), np.empty((len(q), robot.joints, q.shape[1]))
        compiled.self_collision(
            _steps_last(q),
            robot.base,
            robot.joint_origins,
            robot.link,
            robot.center,
            robot.radius,
            pairs.groups,
            pairs.sizes,
            pairs.pairs,
            pairs.ball_center,
            pairs.ball_radius,
            self.margin + REACH * self.edge_width,
            self.edge_width,
            self.margin,
            value,
            gradient,
        )
        scale = REFERENCE_STEPS / q.shape[1]
        return scale * value, scale * np.ascontiguousarray(gradient.swapaxes(1, 2))


@dataclass(frozen=True, eq=False)
class JointLimitCost:
    """Squared excess over the joint limits, rad^2, summed over joints and steps.

    Attributes:
        lower: (n,) rad.
        upper: (n,) rad.
        margin: rad, kept from both limits.
    """

    lower: FloatArray
    upper: FloatArray
    margin: float = 0.0

    def __post_init__(self) -> None:
        lower, upper = np.asarray(self.lower, np.float64), np.asarray(self.upper, np.float64)
        if lower.ndim != 1 or lower.shape != upper.shape:
            raise ValueError(
                f"lower and upper must have one shape (n,), got {lower.shape} and {upper.shape}"
            )
        if not (self.margin >= 0.0 and (lower + self.margin < upper - self.margin).all()):
            raise ValueError(
                f"limits {lower} and {upper} with a margin of {self.margin} leave no room"
            )
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        q = check_trajectories(trajectories, len(self.lower))
        excess = q - np.clip(q, self.lower + self.margin, self.upper - self.margin)
        scale = REFERENCE_STEPS / q.shape[1]
        return scale * np.square(excess).sum(axis=(1, 2)), 2.0 * scale * excess


def _velocities(velocity: ArrayLike) -> FloatArray:
    array = np.asarray(velocity, np.float64)
    if array.ndim != 1 or not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"velocity must be (n,) positive numbers, got {velocity!r}")
    return array


def _differences(trajectories: ArrayLike, joints: int) -> FloatArray:
    q = check_trajectories(trajectories, joints)
    if q.shape[1] < 2:
        raise ValueError(f"trajectories must have at least 2 steps, got {q.shape[1]}")
    return np.diff(q, axis=1)


def _from_differences(parts: FloatArray) -> FloatArray:
    """Return the gradient (P,T,n) that derivatives (P,T-1,n) by differences of steps amount to."""
    gradient = np.zeros((parts.shape[0], parts.shape[1] + 1, parts.shape[2]))
    gradient[:, 1:] += parts
    gradient[:, :-1] -= parts
    return gradient


@dataclass(frozen=True, eq=False)
class VelocityLimitCost:
    """Squared relative excess over the velocity limits when the phase runs evenly.

    A trajectory that runs through its phase evenly in `duration` moves joint j at
    |dq_j/dphase| / duration; summed over joints and segments is the square of what exceeds
    `fraction` of the limit, as a share of it.

    Attributes:
        velocity: (n,) rad/s.
        duration: s.
        fraction: share of the limits that may be used.
    """

    velocity: FloatArray
    duration: float
    fraction: float = VELOCITY_FRACTION

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", _velocities(self.velocity))
        _positive("duration", self.duration)
        _positive("fraction", self.fraction)

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        steps = _differences(trajectories, len(self.velocity))
        per_step = steps.shape[1] / (self.duration * self.fraction * self.velocity)
        share = steps * per_step
        excess = share - np.clip(share, -1.0, 1.0)
        scale = REFERENCE_STEPS / steps.shape[1]
        gradient = _from_differences(2.0 * scale * excess * per_step)
        return scale * np.square(excess).sum(axis=(1, 2)), gradient


@dataclass(frozen=True, eq=False)
class ViaPointCost:
    """C_mod = |F_t|^2 of Eq. (13), in units of `sigma`: half the squared distance to via-points.

    With weight 1 it is the negative logarithm of a Gaussian with standard deviation sigma.

    Attributes:
        steps: (H,) steps at which the via-points are due; negative ones count from the end.
        targets: (H,n) rad, or (n,) for all steps.
        sigma: rad, one for all joints or (n,).
    """

    steps: NDArray[np.int64]
    targets: FloatArray
    sigma: float | FloatArray

    def __post_init__(self) -> None:
        steps = _steps(self.steps)
        width = np.shape(self.targets)[-1] if np.ndim(self.targets) else 0
        if not width:
            raise ValueError(f"targets must have shape (H, n) or (n,), got {self.targets}")
        object.__setattr__(self, "steps", steps)
        object.__setattr__(self, "targets", _points("targets", self.targets, (len(steps), width)))
        object.__setattr__(self, "sigma", _scales("sigma", self.sigma, width))

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        q = check_trajectories(trajectories, self.targets.shape[1])
        steps = _inside(self.steps, q.shape[1])
        error = (q[:, steps] - self.targets) / self.sigma
        value = 0.5 * np.square(error).sum(axis=(1, 2))
        return value, _scatter(q.shape, steps, error / self.sigma)


@dataclass(frozen=True, eq=False)
class CarriedBoxCost:
    """Smooth box of Eq. (14) for a point that the hand carries: d^2 / (2 sigma^2) by dimension.

    d is the distance to the box, zero inside; the reading taken makes weight 1 the negative
    logarithm of Gaussian tails with standard deviation sigma.

    Attributes:
        robot: the arm.
        point: (3,) m, fixed in the end-effector frame.
        steps: (H,) steps at which the point shall be in the box; negative ones count from the end.
        lower: (H,3) or (3,) m, base frame.
        upper: (H,3) or (3,) m, base frame.
        sigma: m, one for all axes or (3,).
    """

    robot: RobotModel
    point: FloatArray
    steps: NDArray[np.int64]
    lower: FloatArray
    upper: FloatArray
    sigma: float | FloatArray

    def __post_init__(self) -> None:
        steps = _steps(self.steps)
        self.robot.carried(self.point)
        object.__setattr__(self, "steps", steps)
        for name in ("lower", "upper"):
            array = _points(name, getattr(self, name), (len(steps), 3))
            object.__setattr__(self, name, array)
        if not (self.lower <= self.upper).all():
            raise ValueError(f"lower {self.lower} must not exceed upper {self.upper}")
        object.__setattr__(self, "sigma", _scales("sigma", self.sigma, 3))

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        q = check_trajectories(trajectories, self.robot.joints)
        steps = _inside(self.steps, q.shape[1])
        points, jacobians = self.robot.carried_points(q[:, steps], self.point)
        error = (points - np.clip(points, self.lower, self.upper)) / self.sigma
        value = 0.5 * np.square(error).sum(axis=(1, 2))
        parts = np.einsum("phi,phij->phj", error / self.sigma, jacobians)
        return value, _scatter(q.shape, steps, parts)


def carried_via_point_cost(
    robot: RobotModel,
    point: ArrayLike,
    steps: ArrayLike,
    targets: ArrayLike,
    sigma: float | ArrayLike,
) -> CarriedBoxCost:
    """Return Eq. (13)'s via-point cost for a point that the hand carries: a box without extent.

    Args:
        robot: the arm.
        point: (3,) m, fixed in the end-effector frame.
        steps: (H,) steps at which the via-points are due; negative ones count from the end.
        targets: (H,3) or (3,) m, base frame.
        sigma: m, one for all axes or (3,).
    """
    target = np.asarray(targets, np.float64)
    return CarriedBoxCost(
        robot, np.asarray(point), np.asarray(steps), target, target, np.asarray(sigma)
    )


@dataclass(frozen=True, eq=False)
class GoalCost:
    """C_mod = -log sum_h pi_h N(...) over goal regions, for the end of the trajectory.

    Each component is a smooth box of Eq. (14), exp(-d_h^2 / (2 sigma^2)), around the point that the
    region names; a region that is a single point gives the paper's Gaussian. Normalising constants
    are left out: with equal weights the cost is log(number of goals) or less inside a region.

    Attributes:
        robot: the arm.
        goals: at least one region.
        sigma: m, one for all axes or (3,).
        shares: mixture weights pi_h, positive; by default equal. They are scaled to sum to one.
    """

    robot: RobotModel
    goals: tuple[GoalRegion, ...]
    sigma: float | FloatArray
    shares: Sequence[float] | None = None
    _log_shares: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not len(self.goals):
            raise ValueError("goals must hold at least one GoalRegion, got none")
        shares = np.ones(len(self.goals)) if self.shares is None else np.asarray(self.shares, float)
        if shares.shape != (len(self.goals),) or not (np.isfinite(shares) & (shares > 0)).all():
            raise ValueError(
                f"shares must be {len(self.goals)} positive numbers, got {self.shares}"
            )
        object.__setattr__(self, "sigma", _scales("sigma", self.sigma, 3))
        object.__setattr__(self, "_log_shares", np.log(shares / shares.sum()))

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        q = check_trajectories(trajectories, self.robot.joints)
        end = np.ascontiguousarray(q[:, -1])
        terms: list[Any] = []
        slopes: list[Any] = []
        for goal in self.goals:
            points, jacobians = self.robot.carried_points(end, goal.point)
            error = (points - np.clip(points, goal.lower, goal.upper)) / self.sigma
            terms.append(-0.5 * np.square(error).sum(axis=1))
            slopes.append(np.einsum("pi,pij->pj", error / self.sigma, jacobians))
        joint = np.stack(terms, axis=1) + self._log_shares
        largest = joint.max(axis=1, keepdims=True)
        membership = np.exp(joint - largest)
        total = membership.sum(axis=1, keepdims=True)
        membership /= total
        gradient = np.zeros(q.shape)
        gradient[:, -1] = np.einsum("ph,hpj->pj", membership, np.stack(slopes))
        return -(largest + np.log(total))[:, 0], gradient
