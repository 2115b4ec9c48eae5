"""Costs of trajectories, each with its gradient: obstacles, the arm itself, limits.

A cost is called with trajectories (P,T,n) rad or m, at equal steps of phase, and returns its value
(P,) and its gradient (P,T,n), both float64. Calling with anything else raises a ValueError.

A weight (the paper's lambda, Eq. (6)) keeps its meaning when T changes: what is summed along the
trajectory is scaled to `REFERENCE_STEPS` steps. So weight 1 with T = 200 pulls as hard as with
T = 50, and Eq. (12) is met literally at T = 50.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_planner.collision import kernels as compiled
from smp_planner.collision.clearances import SphereClearances
from smp_planner.collision.robot_model import RobotModel, SingleArrays
from smp_planner.occupancy.grid import DistanceGrid

__all__ = [
    "CUTOFF_WIDTHS",
    "REFERENCE_STEPS",
    "VELOCITY_FRACTION",
    "CollisionCost",
    "CompiledCost",
    "Cost",
    "JointLimitCost",
    "SelfCollisionCost",
    "ValueAndGradient",
    "VelocityLimitCost",
    "check_trajectories",
    "evaluated",
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


@runtime_checkable
class CompiledCost(Cost, Protocol):
    """A cost that adds itself to what there is, with no check and without the interpreter's lock.

    Parts of a set may be given to several threads at once.
    """

    def add(
        self, trajectories: FloatArray, weight: float, value: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the weighted cost.

        Args:
            trajectories: (P,T,n) rad, finite, contiguous.
            weight: factor.
            value: (P,), added to.
            gradient: (P,T,n), contiguous, added to.
        """
        ...


def evaluated(cost: CompiledCost, trajectories: FloatArray) -> ValueAndGradient:
    """Return the value (P,) and the gradient (P,T,n) of checked trajectories (P,T,n)."""
    value, gradient = np.zeros(len(trajectories)), np.zeros(trajectories.shape)
    cost.add(trajectories, 1.0, value, gradient)
    return value, gradient


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
        scale: factor of the sum.
    """

    robot: RobotModel
    grid: DistanceGrid
    scale: float = 1.0

    @cached_property
    def _map(self) -> tuple[NDArray[np.float32], NDArray[np.float32], np.float32, NDArray[Any]]:
        grid = self.grid
        origin, inverse = grid.origin.astype(np.float32), np.float32(1.0 / grid.spacing)
        return grid.values, origin, inverse, grid.least_of_blocks

    @cached_property
    def _robot(self) -> SingleArrays:
        return self.robot.single()

    @property
    def clearances(self) -> SphereClearances:
        """Clearances of the spheres in the sum on the same map, one by one."""
        return SphereClearances(self.robot, self.grid)

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
        value, gradient = np.zeros(len(q)), np.zeros(q.shape)
        self.add_stretch(
            q, 0, q.shape[1], width, float(margin), steps_scale(q.shape[1]), value, gradient
        )
        return value, gradient

    def add_stretch(
        self,
        trajectories: FloatArray,
        first: int,
        last: int,
        edge_width: float,
        margin: float,
        weight: float,
        value: FloatArray,
        gradient: FloatArray,
    ) -> None:
        """Add the weighted cost of a stretch; see `CompiledCost.add`.

        The sum over its steps is not scaled to `REFERENCE_STEPS`.

        Args:
            trajectories: (P,T,n) rad, finite, contiguous.
            first: first step of the stretch.
            last: step after its last one.
            edge_width: as of a call, like `margin`.
            margin: see there.
            weight: factor.
            value: (P,), added to.
            gradient: (P,T,n), contiguous, added to.
        """
        robot = self._robot
        reach = np.float32(margin + CUTOFF_WIDTHS * edge_width)
        limit = np.minimum(robot.radius + reach, np.float32(self.grid.largest))
        compiled.map_collision(
            trajectories,
            first,
            last,
            robot,
            self._map,
            limit,
            edge_width,
            margin,
            self.scale * weight,
            value,
            gradient,
        )


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

    @cached_property
    def _robot(self) -> SingleArrays:
        return self.robot.single(self.margin + CUTOFF_WIDTHS * self.edge_width)

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        return evaluated(self, check_trajectories(trajectories, self.robot.joints))

    def add(
        self, trajectories: FloatArray, weight: float, value: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the weighted cost; see `CompiledCost.add`."""
        compiled.self_collision(
            trajectories,
            self._robot,
            self.margin + CUTOFF_WIDTHS * self.edge_width,
            self.edge_width,
            self.margin,
            weight * steps_scale(trajectories.shape[1]),
            value,
            gradient,
        )


@dataclass(frozen=True, eq=False)
class JointLimitCost:
    """Squared excess over the joint limits, rad^2 or m^2, summed over joints and steps.

    Attributes:
        lower: (n,) rad or m.
        upper: (n,) rad or m.
        margin: rad or m, kept from both limits by all joints, or by each (n,).
    """

    lower: FloatArray
    upper: FloatArray
    margin: float | FloatArray = 0.0

    def __post_init__(self) -> None:
        lower, upper = np.asarray(self.lower, np.float64), np.asarray(self.upper, np.float64)
        if lower.ndim != 1 or lower.shape != upper.shape:
            raise ValueError(
                f"lower and upper must have one shape (n,), got {lower.shape} and {upper.shape}"
            )
        if np.shape(self.margin) not in ((), lower.shape):
            raise ValueError(
                f"margin must be a number or have shape {lower.shape}, got {self.margin}"
            )
        room = (lower + self.margin < upper - self.margin).all()
        if not (np.min(self.margin) >= 0.0 and room):
            raise ValueError(
                f"limits {lower} and {upper} with a margin of {self.margin} leave no room"
            )
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        return evaluated(self, check_trajectories(trajectories, len(self.lower)))

    def add(
        self, trajectories: FloatArray, weight: float, value: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the weighted cost; see `CompiledCost.add`."""
        lower, upper = self.lower + self.margin, self.upper - self.margin
        scale = weight * steps_scale(trajectories.shape[1])
        compiled.joint_limits(trajectories, lower, upper, scale, value, gradient)


def _velocities(velocity: ArrayLike) -> FloatArray:
    array = np.asarray(velocity, np.float64)
    if array.ndim != 1 or not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"velocity must be (n,) positive numbers, got {velocity!r}")
    return array


@dataclass(frozen=True, eq=False)
class VelocityLimitCost:
    """Squared relative excess over the velocity limits when the phase runs evenly.

    A trajectory that runs through its phase evenly in `duration` moves joint j at
    |dq_j/dphase| / duration; summed over joints and segments is the square of what exceeds
    `fraction` of the limit, as a share of it.

    Attributes:
        velocity: (n,) rad/s or m/s.
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
        q = check_trajectories(trajectories, len(self.velocity))
        if q.shape[1] < 2:
            raise ValueError(f"trajectories must have at least 2 steps, got {q.shape[1]}")
        return evaluated(self, q)

    def add(
        self, trajectories: FloatArray, weight: float, value: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the weighted cost; see `CompiledCost.add`."""
        segments = trajectories.shape[1] - 1
        per_step = segments / (self.duration * self.fraction * self.velocity)
        scale = weight * REFERENCE_STEPS / segments
        compiled.velocity_limits(trajectories, per_step, scale, value, gradient)
