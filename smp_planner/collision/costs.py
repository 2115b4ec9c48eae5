"""Costs of trajectories, each with its gradient: obstacles, the arm itself, limits.

A cost is called with trajectories (P,T,n) rad, at equal steps of phase, and returns its value (P,)
and its gradient (P,T,n), both float64. Calling with anything else raises a ValueError.

A weight (the paper's lambda, Eq. (6)) keeps its meaning when T changes: what is summed along the
trajectory is scaled to `REFERENCE_STEPS` steps. So weight 1 with T = 200 pulls as hard as with
T = 50, and Eq. (12) is met literally at T = 50.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_planner.collision import kernels as compiled
from smp_planner.collision.robot_model import RobotModel
from smp_planner.occupancy.grid import DistanceGrid

__all__ = [
    "CUTOFF_WIDTHS",
    "REFERENCE_STEPS",
    "VELOCITY_FRACTION",
    "CollisionCost",
    "Cost",
    "JointLimitCost",
    "SelfCollisionCost",
    "ValueAndGradient",
    "VelocityLimitCost",
    "check_trajectories",
    "steps_scale",
]
ValueAndGradient = tuple[FloatArray, FloatArray]

REFERENCE_STEPS = 50
"""Steps to which sums along a trajectory are scaled, whatever its T."""


def steps_scale(steps: int) -> float:
    """Return the factor of a sum over steps, so that weights do not depend on their number."""
    return REFERENCE_STEPS / steps


CUTOFF_WIDTHS = 6.0
"""Edge widths from a sphere's surface at which its occupancy counts as zero (p^2 = 6e-6 there)."""

VELOCITY_FRACTION = 0.9
"""Share of a joint's velocity limit that plans may use: up to it a grasp holds."""


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


@dataclass(frozen=True)
class CollisionCost:
    """Squared occupancy of the link spheres, Eq. (12).

    The map is evaluated at each moving sphere: p = sigma(-(d - r - margin) / edge_width) with d the
    distance of the centre to the nearest obstacle and r the radius. Summed is p^2 less the
    value that it has where the map is cut off or `CUTOFF_WIDTHS` edge widths away, whichever is
    nearer: a sphere far from everything costs exactly nothing, and nothing is computed for it.

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
        limit = np.minimum(robot.radius + margin + CUTOFF_WIDTHS * width, self._truncation)
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
        scale = steps_scale(q.shape[1])
        return scale * value, scale * np.ascontiguousarray(gradient.swapaxes(1, 2))


@dataclass(frozen=True)
class SelfCollisionCost:
    """Squared occupancy of the arm's spheres by one another, in the manner of Eq. (12).

    For each pair of `RobotModel.collision_pairs`, p = sigma(-(gap - margin) / edge_width) with the
    gap between the two surfaces; p^2, less its value at `margin` + `CUTOFF_WIDTHS` edge widths, is
    summed.

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
        if not (math.isfinite(self.margin) and self.margin > -CUTOFF_WIDTHS * self.edge_width):
            raise ValueError(
                f"margin must be above {-CUTOFF_WIDTHS * self.edge_width} (minus {CUTOFF_WIDTHS} "
                f"edge widths), got {self.margin}"
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
            self.margin + CUTOFF_WIDTHS * self.edge_width,
            self.edge_width,
            self.margin,
            value,
            gradient,
        )
        scale = steps_scale(q.shape[1])
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
        scale = steps_scale(q.shape[1])
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
