"""Obstacles that move: where they are expected, the cost of meeting them, and the check in time.

What moves has no grid. Its distance is exact, in its own frame, placed where it is expected when
the arm is there. The expectation is extrapolated from one observation, so the body is enlarged by
a margin that grows with time.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.geometry import registry
from smp_gym.geometry.distance import PackedObstacles, to_local
from smp_gym.robot.forward_kernels import link_poses, place
from smp_gym.scene import Obstacle
from smp_planner.collision.costs import (
    CUTOFF_WIDTHS,
    ValueAndGradient,
    check_trajectories,
    steps_scale,
)
from smp_planner.collision.robot_model import RobotModel

__all__ = [
    "Forecast",
    "MovingCollisionCost",
    "clearance_in_time",
    "is_moving",
]

_LEAST_SPEED = 1e-3
"""m/s, below which a body counts as standing."""

_MOST_HALVINGS = 12

_body_distance, _body_gradient = registry.distance, registry.gradient


def is_moving(obstacle: Obstacle) -> bool:
    """Return whether an obstacle is observed to move."""
    return math.hypot(*obstacle.velocity) > _LEAST_SPEED


@dataclass(frozen=True, eq=False)
class Forecast:
    """Where obstacles are expected after one observation of them, and how surely.

    A body goes on at its velocity, which turns at a constant rate where one is known, until the
    horizon; from then on it is taken to stay. Its margin grows with the distance that it is
    expected to have gone, up to a cap. A body that stands has none.

    Attributes:
        obstacles: as they were observed.
        turn: (N, 3) rad/s, at which their velocities turn.
        horizon: s, from which on they are taken to stay.
        growth: m of margin for each metre that a body has gone.
        most: m, largest margin.
        least: m, margin of what moves at the time of the observation: the arm follows its reference
            a little late.

    Raises:
        ValueError: `turn` does not fit the obstacles or is not finite, or a number is negative or
            not finite.
    """

    obstacles: tuple[Obstacle, ...]
    turn: FloatArray
    horizon: float
    growth: float
    most: float
    least: float = 0.0

    def __post_init__(self) -> None:
        turn = np.asarray(self.turn, np.float64)
        if turn.shape != (len(self.obstacles), 3) or not np.isfinite(turn).all():
            raise ValueError(
                f"turn must be ({len(self.obstacles)}, 3) finite numbers, got {self.turn!r}"
            )
        object.__setattr__(self, "turn", turn)
        for name in ("horizon", "growth", "most", "least"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        object.__setattr__(self, "_packed", PackedObstacles.of(self.obstacles))

    @property
    def packed(self) -> PackedObstacles:
        """The obstacles as they were observed."""
        packed: PackedObstacles = self._packed  # type: ignore[attr-defined]
        return packed

    @property
    def speed(self) -> FloatArray:
        """(N,) m/s."""
        velocity = np.array([o.velocity for o in self.obstacles], np.float64).reshape(-1, 3)
        return np.asarray(np.linalg.norm(velocity, axis=1))

    def positions(self, times: ArrayLike) -> FloatArray:
        """Return where the centres are expected, (..., N, 3) m.

        Args:
            times: (...) s since the observation.
        """
        time = np.clip(np.asarray(times, np.float64), 0.0, self.horizon)[..., None, None]
        velocity = np.array([o.velocity for o in self.obstacles], np.float64).reshape(-1, 3)
        rate = np.linalg.norm(self.turn, axis=1, keepdims=True)
        axis = self.turn / np.where(rate > 0.0, rate, 1.0)
        along = (velocity * axis).sum(axis=1, keepdims=True) * axis
        across, sideways = velocity - along, np.cross(axis, velocity)
        angle = rate * time
        # The integral of a vector that turns: sin(a) / rate and (1 - cos(a)) / rate, finite at 0.
        forward = time * np.sinc(angle / np.pi)
        half = np.sinc(angle / (2.0 * np.pi))
        aside = 0.5 * rate * np.square(time) * np.square(half)
        moved = time * along + forward * across + aside * sideways
        return np.asarray(self.packed.position + moved)

    def margins(self, times: ArrayLike) -> FloatArray:
        """Return by how much bodies are enlarged, (..., N) m, at times (...) s."""
        time = np.clip(np.asarray(times, np.float64), 0.0, self.horizon)[..., None]
        speed = self.speed
        grown = np.where(speed > _LEAST_SPEED, self.least + self.growth * speed * time, 0.0)
        return np.asarray(np.minimum(grown, self.most))


@kernel(fastmath=FAST)
def _project(rotation, position, prismatic, force, moment, gradient):
    """Write the joint torques (n,T), or forces, that forces and moments about the origin cause.

    Args:
        rotation: (n+1,3,3,T), from `link_poses`.
        position: (n+1,3,T) m, from `link_poses`.
        prismatic: (n,) whether a joint is.
        force: (n+1,3,T) on each link; overwritten by the sum over the links from it outwards.
        moment: (n+1,3,T), likewise.
        gradient: (n,T), written.
    """
    joints, steps = gradient.shape
    for k in range(joints, 0, -1):
        for t in range(steps):
            fx, fy, fz = force[k, 0, t], force[k, 1, t], force[k, 2, t]
            mx, my, mz = moment[k, 0, t], moment[k, 1, t], moment[k, 2, t]
            x, y, z = position[k, 0, t], position[k, 1, t], position[k, 2, t]
            gradient[k - 1, t] = (
                rotation[k, 0, 2, t] * (mx - (y * fz - z * fy))
                + rotation[k, 1, 2, t] * (my - (z * fx - x * fz))
                + rotation[k, 2, 2, t] * (mz - (x * fy - y * fx))
            )
            force[k - 1, 0, t] += fx
            force[k - 1, 1, t] += fy
            force[k - 1, 2, t] += fz
            moment[k - 1, 0, t] += mx
            moment[k - 1, 1, t] += my
            moment[k - 1, 2, t] += mz
    for k in range(1, joints + 1):
        if prismatic[k - 1]:
            for t in range(steps):
                gradient[k - 1, t] = (
                    rotation[k, 0, 2, t] * force[k, 0, t]
                    + rotation[k, 1, 2, t] * force[k, 1, t]
                    + rotation[k, 2, 2, t] * force[k, 2, t]
                )


@kernel(fastmath=FAST)
def _moving_collision(
    angles, robot, bodies, positions, margins, limit, edge_width, margin, value, gradient
):
    """Write the sum over steps and moving spheres of ``p^2 - p_limit^2``.

    As `kernels.map_collision`, with the exact distance to bodies that are elsewhere at each step.

    Args:
        angles: (P,n,T) rad.
        robot: `RobotArrays`.
        bodies: (shape, rotation, size, bound) of N bodies, as in `PackedObstacles`.
        positions: (P,T,N,3) m.
        margins: (P,T,N) m.
        limit: (S,) m, distance of the centre from which on a sphere costs nothing.
        edge_width: m.
        margin: m.
        value: (P,), written.
        gradient: (P,n,T), written.
    """
    shape, rotations, size, bound = bodies
    count, joints, steps = angles.shape
    sine, cosine = np.empty((joints, steps)), np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    force, moment = np.empty((joints + 1, 3, steps)), np.empty((joints + 1, 3, steps))
    placed = np.empty((1, 3, steps))
    link, center, radius = robot.link, robot.center, robot.radius
    inv_width = 1.0 / edge_width
    for p in range(count):
        link_poses(
            angles[p],
            robot.prismatic,
            robot.base,
            robot.origins,
            sine,
            cosine,
            rotation,
            position,
        )
        force[:] = 0.0
        moment[:] = 0.0
        total = 0.0
        for s in range(link.shape[0]):
            k = link[s]
            if k == 0:
                continue
            place(rotation, position, link[s : s + 1], center[s : s + 1], placed)
            offset = radius[s] + margin
            farthest = limit[s]
            floor = (1.0 / (1.0 + math.exp((farthest - offset) * inv_width))) ** 2
            for t in range(steps):
                x, y, z = placed[0, 0, t], placed[0, 1, t], placed[0, 2, t]
                best, nearest = farthest, -1
                for i in range(shape.shape[0]):
                    dx = x - positions[p, t, i, 0]
                    dy = y - positions[p, t, i, 1]
                    dz = z - positions[p, t, i, 2]
                    horizon = best + margins[p, t, i] + bound[i]
                    if horizon < 0.0 or dx * dx + dy * dy + dz * dz >= horizon * horizon:
                        continue
                    a, b, c = to_local(x, y, z, rotations[i], positions[p, t, i])
                    distance = _body_distance(shape[i], a, b, c, size[i]) - margins[p, t, i]
                    if distance < best:
                        best, nearest = distance, i
                if nearest < 0:
                    continue
                occupancy = 1.0 / (1.0 + math.exp((best - offset) * inv_width))
                square = occupancy * occupancy
                total += square - floor
                slope = -2.0 * inv_width * square * (1.0 - occupancy)
                a, b, c = to_local(x, y, z, rotations[nearest], positions[p, t, nearest])
                ga, gb, gc = _body_gradient(shape[nearest], a, b, c, size[nearest])
                r = rotations[nearest]
                gx = slope * (r[0, 0] * ga + r[1, 0] * gb + r[2, 0] * gc)
                gy = slope * (r[0, 1] * ga + r[1, 1] * gb + r[2, 1] * gc)
                gz = slope * (r[0, 2] * ga + r[1, 2] * gb + r[2, 2] * gc)
                force[k, 0, t] += gx
                force[k, 1, t] += gy
                force[k, 2, t] += gz
                moment[k, 0, t] += y * gz - z * gy
                moment[k, 1, t] += z * gx - x * gz
                moment[k, 2, t] += x * gy - y * gx
        _project(rotation, position, robot.prismatic, force, moment, gradient[p])
        value[p] = total


@dataclass(frozen=True, eq=False)
class MovingCollisionCost:
    """Squared occupancy of the link spheres by bodies that move, Eq. (12) in time.

    The distance of a sphere is that to the nearest body where it is expected at the step's time,
    less the body's margin; else as `smp_planner.collision.costs.CollisionCost`. The gradient is
    that at given times: by how much a change of the trajectory changes its timing is left out.

    Attributes:
        robot: the arm and what it carries.
        forecast: of the bodies.
    """

    robot: RobotModel
    forecast: Forecast

    def __call__(
        self,
        trajectories: ArrayLike,
        times: ArrayLike,
        edge_width: float = 0.01,
        margin: float = 0.0,
    ) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n).

        Args:
            trajectories: (P,T,n) rad.
            times: (P,T) s since the observation, at which the samples are passed.
            edge_width: m, scale of the sigmoid, positive.
            margin: m, by which every sphere is enlarged.

        Raises:
            ValueError: wrong shape or not finite, or `edge_width` is not positive.
        """
        q = check_trajectories(trajectories, self.robot.joints)
        at = _checked_times(times, q.shape[:2])
        if not (math.isfinite(edge_width) and edge_width > 0.0):
            raise ValueError(f"edge_width must be positive, got {edge_width}")
        packed, robot = self.forecast.packed, self.robot
        value, gradient = np.empty(len(q)), np.empty((len(q), robot.joints, q.shape[1]))
        _moving_collision(
            np.ascontiguousarray(q.swapaxes(1, 2)),
            robot.arrays,
            (packed.shape, packed.rotation, packed.size, packed.bound),
            np.ascontiguousarray(self.forecast.positions(at)),
            np.ascontiguousarray(self.forecast.margins(at)),
            robot.radius + margin + CUTOFF_WIDTHS * edge_width,
            edge_width,
            float(margin),
            value,
            gradient,
        )
        scale = steps_scale(q.shape[1])
        return scale * value, scale * np.ascontiguousarray(gradient.swapaxes(1, 2))


def _checked_times(times: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(times, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"times must be {shape} finite numbers, got shape {array.shape}")
    return array


@kernel(fastmath=FAST)
def _clearance(
    trajectories, counts, robot, bodies, positions, margins, enough, tolerance, clearance
):
    """Write the least clearance (P,) of trajectories (P,n,T); see `clearance_in_time`.

    Between two samples configuration, positions and margins are linear. There the distance of a
    sphere to a body changes by no more than both move and the margin grows: on a share h of a
    segment over which that is w, with distances a and b at its ends, it is at least
    (a + b - h w) / 2. Where that does not settle the matter, the segment is halved, for this
    sphere and body.
    """
    shape, rotations, size, bound = bodies
    count, joints, steps = trajectories.shape
    spheres, number = robot.link.shape[0], shape.shape[0]
    sine, cosine = np.empty((joints, steps)), np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    placed = np.empty((spheres, 3, steps))
    angles = np.empty((joints, 1))
    sine_between, cosine_between = np.empty((joints, 1)), np.empty((joints, 1))
    rotation_between = np.empty((joints + 1, 3, 3, 1))
    position_between = np.empty((joints + 1, 3, 1))
    placed_between = np.empty((1, 3, 1))
    middle = np.empty(3)
    before = np.empty((spheres, number))
    at = np.empty(_MOST_HALVINGS + 2)
    gap = np.empty(_MOST_HALVINGS + 2)
    for p in range(count):
        link_poses(
            trajectories[p],
            robot.prismatic,
            robot.base,
            robot.origins,
            sine,
            cosine,
            rotation,
            position,
        )
        place(rotation, position, robot.link, robot.center, placed)
        nearest = np.inf
        for t in range(counts[p]):
            for s in range(spheres):
                if robot.link[s] == 0:
                    continue
                travel = 0.0
                if t > 0:
                    for j in range(joints):
                        turn = trajectories[p, j, t] - trajectories[p, j, t - 1]
                        travel += abs(turn) * robot.lever[s, j]
                for i in range(number):
                    x = placed[s, 0, t] - positions[p, t, i, 0]
                    y = placed[s, 1, t] - positions[p, t, i, 1]
                    z = placed[s, 2, t] - positions[p, t, i, 2]
                    enlarged = robot.radius[s] + margins[p, t, i]
                    # A bound will do for what is far away.
                    here = math.sqrt(x * x + y * y + z * z) - bound[i] - enlarged
                    if here < nearest or here < enough:
                        a, b, c = to_local(
                            placed[s, 0, t],
                            placed[s, 1, t],
                            placed[s, 2, t],
                            rotations[i],
                            positions[p, t, i],
                        )
                        here = _body_distance(shape[i], a, b, c, size[i]) - enlarged
                    nearest = min(nearest, here)
                    last = before[s, i]
                    before[s, i] = here
                    if t == 0:
                        continue
                    dx = positions[p, t, i, 0] - positions[p, t - 1, i, 0]
                    dy = positions[p, t, i, 1] - positions[p, t - 1, i, 1]
                    dz = positions[p, t, i, 2] - positions[p, t - 1, i, 2]
                    change = travel + math.sqrt(dx * dx + dy * dy + dz * dz)
                    change += abs(margins[p, t, i] - margins[p, t - 1, i])
                    # Entry 0 is up to where the segment is settled; above it what is still ahead.
                    top = 1
                    at[0], at[1] = 0.0, 1.0
                    gap[0], gap[1] = last, here
                    while top > 0:
                        share = at[top] - at[0]
                        ahead = 0.5 * (gap[0] + gap[top] - share * change)
                        if ahead >= min(nearest, enough) - tolerance or top > _MOST_HALVINGS:
                            at[0], gap[0] = at[top], gap[top]
                            top -= 1
                            continue
                        h = 0.5 * (at[0] + at[top])
                        for j in range(joints):
                            first = trajectories[p, j, t - 1]
                            angles[j, 0] = first + h * (trajectories[p, j, t] - first)
                        link_poses(
                            angles,
                            robot.prismatic,
                            robot.base,
                            robot.origins,
                            sine_between,
                            cosine_between,
                            rotation_between,
                            position_between,
                        )
                        place(
                            rotation_between,
                            position_between,
                            robot.link[s : s + 1],
                            robot.center[s : s + 1],
                            placed_between,
                        )
                        for axis in range(3):
                            first = positions[p, t - 1, i, axis]
                            middle[axis] = first + h * (positions[p, t, i, axis] - first)
                        a, b, c = to_local(
                            placed_between[0, 0, 0],
                            placed_between[0, 1, 0],
                            placed_between[0, 2, 0],
                            rotations[i],
                            middle,
                        )
                        enlarged = margins[p, t - 1, i]
                        enlarged += h * (margins[p, t, i] - enlarged) + robot.radius[s]
                        between = _body_distance(shape[i], a, b, c, size[i]) - enlarged
                        nearest = min(nearest, between)
                        at[top + 1], gap[top + 1] = h, between
                        top += 1
        clearance[p] = nearest


def clearance_in_time(
    trajectories: ArrayLike,
    times: ArrayLike,
    robot: RobotModel,
    forecast: Forecast,
    *,
    until: float = math.inf,
    enough: float = 0.05,
    tolerance: float = 1e-3,
) -> FloatArray:
    """Return the least distance (P,) m of trajectories to bodies that move, margins taken off.

    It is exact up to `tolerance` below `enough`, between the samples, too; above, it is a lower
    bound of at least about `enough`. Infinity without bodies.

    Args:
        trajectories: (P,T,n) rad, linear between samples.
        times: (P,T) s since the observation, at which the samples are passed.
        robot: the arm and what it carries; spheres on link 0 are left out.
        forecast: of the bodies; linear between samples, too.
        until: s; what is later is not looked at.
        enough: m, clearances above which need not be told apart.
        tolerance: m, positive.

    Raises:
        ValueError: wrong shape or not finite, or `tolerance` is not positive.
    """
    q = check_trajectories(trajectories, robot.joints)
    at = _checked_times(times, q.shape[:2])
    if not (math.isfinite(tolerance) and tolerance > 0.0):
        raise ValueError(f"tolerance must be positive, got {tolerance}")
    clearance = np.full(len(q), np.inf)
    packed = forecast.packed
    if len(packed):
        _clearance(
            np.ascontiguousarray(q.swapaxes(1, 2)),
            np.minimum((at <= until).sum(axis=1) + 1, q.shape[1]),
            robot.arrays_along(q),
            (packed.shape, packed.rotation, packed.size, packed.bound),
            np.ascontiguousarray(forecast.positions(at)),
            np.ascontiguousarray(forecast.margins(at)),
            enough,
            tolerance,
            clearance,
        )
    return clearance
