"""The cost of meeting what moves, Eq. (12) in time.

What moves has no grid. Its distance is exact, in its own frame, placed where it is expected when
the arm is there.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.compiling import FAST, kernel
from smp_gym.geometry import registry
from smp_gym.geometry.distance import to_local
from smp_gym.robot.forward_kernels import link_poses, place
from smp_planner.collision.costs import (
    CUTOFF_WIDTHS,
    ValueAndGradient,
    check_trajectories,
    steps_scale,
)
from smp_planner.collision.forecast import Forecast, checked_times
from smp_planner.collision.robot_model import RobotModel

__all__ = ["MovingCollisionCost"]

_body_distance, _body_gradient = registry.distance, registry.gradient


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
        at = checked_times(times, q.shape[:2])
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
