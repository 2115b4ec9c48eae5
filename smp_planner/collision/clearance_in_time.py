"""The least distance of trajectories to what moves, between their samples, too."""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.geometry import registry
from smp_gym.geometry.distance import to_local
from smp_gym.robot.forward_kernels import link_poses, place
from smp_planner.collision.costs import check_trajectories
from smp_planner.collision.forecast import Forecast, checked_times
from smp_planner.collision.robot_model import RobotModel

__all__ = ["clearance_in_time"]

_MOST_HALVINGS = 12

_body_distance = registry.distance


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
    at = checked_times(times, q.shape[:2])
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
