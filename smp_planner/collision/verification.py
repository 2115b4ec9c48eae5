"""The exact check of finished trajectories: collisions between the steps, joint limits, duration.

Nothing learned and no grid, unless a grid is all that is known of a scene: spheres against the
exact distance of the obstacles, along the whole piecewise linear path in joint space. Between two
configurations no sphere can come nearer to anything than half of what is left of the two distances
after the length of its path is taken off; where that does not settle the matter, the segment is
halved. So the result holds for the path, not only for samples of it.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.geometry.distance import PackedObstacles, point_distance
from smp_gym.robot.forward_kernels import link_poses, place
from smp_gym.scene import Obstacle
from smp_planner.collision.costs import VELOCITY_FRACTION, check_trajectories
from smp_planner.collision.robot_model import RobotModel
from smp_planner.occupancy.grid import DistanceGrid, lookup

__all__ = [
    "CLEARANCE_TOLERANCE",
    "DURATION_LIMIT",
    "LIMIT_TOLERANCE",
    "CollisionCheck",
    "Verification",
    "check_collisions",
    "grid_arrays",
    "minimum_duration",
    "verify",
    "within_joint_limits",
]

CLEARANCE_TOLERANCE = 1e-3
"""Metres by which the clearance of a path may be overestimated."""

DURATION_LIMIT = 15.0
"""Seconds within which an executable trajectory is finished."""

LIMIT_TOLERANCE = 1e-6
"""rad by which a configuration may be beyond a joint's limit: what is conditioned to be at the
limit lands within rounding of it, and encoders and texts round, too."""

SELF_HORIZON = 0.05
"""Distance, m, from which on pairs of spheres of the arm are not told apart."""

# Halvings of one segment: enough for a segment of a kilometre at a tolerance of a millimetre.
_MOST_HALVINGS = 22
# Arrays of `lookup`, and the steepness of the distance, where there is no grid.
_NO_GRID = np.empty((0, 0, 0), np.float32), np.zeros(3), 1.0, 1.0


def grid_arrays(
    grid: DistanceGrid | None,
) -> tuple[NDArray[np.float32], FloatArray, float, float]:
    """Return the arrays of `lookup` and a bound on the distance's change per metre, for kernels."""
    if grid is None:
        return _NO_GRID
    return grid.values, grid.origin, 1.0 / grid.spacing, max(grid.steepness, 1.0)


@dataclass(frozen=True)
class CollisionCheck:
    """Results of the check of P trajectories against obstacles and the arm itself.

    Attributes:
        clearance: (P,) m, least distance of a sphere to an obstacle, negative inside; infinity
            without obstacles. The path may come nearer by `CLEARANCE_TOLERANCE`, no more.
        free: (P,) whether the whole path is certainly clear of obstacles and of the arm itself.
        self_free: (P,) whether it is clear of the arm itself.
    """

    clearance: FloatArray
    free: BoolArray
    self_free: BoolArray


@dataclass(frozen=True)
class Verification:
    """Results of all checks of P trajectories: collisions, joint limits, duration.

    Attributes:
        collision_free: (P,) as `CollisionCheck.free`.
        self_collision_free: (P,) as `CollisionCheck.self_free`.
        clearance: (P,) m, as `CollisionCheck.clearance`.
        within_limits: (P,) whether all configurations respect the joint limits.
        duration: (P,) s, shortest execution, see `minimum_duration`.
        executable: (P,) whether joint limits hold and the duration is within the limit.
    """

    collision_free: BoolArray
    self_collision_free: BoolArray
    clearance: FloatArray
    within_limits: BoolArray
    duration: FloatArray
    executable: BoolArray


@kernel(fastmath=FAST)
def self_gap_of(placed, balls, step, robot):
    """Return the least gap, m, between spheres of `robot.pairs` at a step; at most the horizon."""
    least = SELF_HORIZON
    groups, sizes, pairs = robot.groups, robot.sizes, robot.pairs
    radius, ball_radius = robot.radius, robot.ball_radius
    for g in range(groups.shape[0]):
        i, j = groups[g, 0], groups[g, 1]
        dx = balls[i, 0, step] - balls[j, 0, step]
        dy = balls[i, 1, step] - balls[j, 1, step]
        dz = balls[i, 2, step] - balls[j, 2, step]
        clear = ball_radius[i] + ball_radius[j] + least
        if dx * dx + dy * dy + dz * dz >= clear * clear:
            continue
        for m in range(groups[g, 2], groups[g, 2] + sizes[g]):
            u, v = pairs[m, 0], pairs[m, 1]
            dx = placed[u, 0, step] - placed[v, 0, step]
            dy = placed[u, 1, step] - placed[v, 1, step]
            dz = placed[u, 2, step] - placed[v, 2, step]
            between = radius[u] + radius[v]
            square = dx * dx + dy * dy + dz * dz
            if square < max(between + least, 0.0) ** 2:
                least = math.sqrt(square) - between
    return least


@kernel(fastmath=FAST)
def _check(
    trajectories,
    robot,
    obstacles,
    grid,
    tolerance,
    clearance,
    self_free,
):
    """Write clearance (P,) and self_free (P,) of trajectories (P,n,T); see `check_collisions`.

    Each segment is halved until a bound settles it. Along a segment with the change dq of the
    joints, the centre of sphere s moves by at most w_s = sum_j |dq_j| l_sj, where l_sj is its lever
    about joint j (`RobotModel.levers`). A distance changes by no more than the point moves (times
    the grid's steepness), so on a share h of the segment with distances a and b at its ends it is
    at least (a + b - h w_s) / 2. Of two spheres of the arm, only the joints between them change the
    distance, by no more than the outer one moves: it is at least (a + b - h max_s w_s) / 2.

    `robot` is a `RobotArrays`, `obstacles` are the arrays of `PackedObstacles`, `grid` is as
    of `grid_arrays`.
    """
    values, corner, inv_spacing, steepness = grid
    has_grid = values.shape[0] > 0
    count, joints, steps = trajectories.shape
    base, origins, link, center, radius = (
        robot.base,
        robot.origins,
        robot.link,
        robot.center,
        robot.radius,
    )
    spheres = link.shape[0]
    sine = np.empty((joints, steps))
    cosine = np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    placed = np.empty((spheres, 3, steps))
    balls = np.empty((joints + 1, 3, steps))
    # The same for one configuration between two steps.
    angles = np.empty((joints, 1))
    sine_between = np.empty((joints, 1))
    cosine_between = np.empty((joints, 1))
    rotation_between = np.empty((joints + 1, 3, 3, 1))
    position_between = np.empty((joints + 1, 3, 1))
    placed_between = np.empty((spheres, 3, 1))
    balls_between = np.empty((joints + 1, 3, 1))
    links = np.arange(joints + 1)
    measured_at = np.empty((spheres, 3))
    measured = np.empty(spheres)
    travel = np.empty(spheres)
    # Row 0 is the configuration up to which the path is settled; above it those still ahead.
    at = np.empty(_MOST_HALVINGS + 2)
    gap = np.empty((_MOST_HALVINGS + 2, spheres))
    self_gap = np.empty(_MOST_HALVINGS + 2)
    for p in range(count):
        link_poses(
            trajectories[p], robot.prismatic, base, origins, sine, cosine, rotation, position
        )
        place(rotation, position, link, center, placed)
        place(rotation, position, links, robot.ball_center, balls)
        nearest = np.inf
        # All are to be measured at first.
        measured[:] = -np.inf
        measured_at[:] = 0.0
        clear_of_itself = True
        for t in range(steps):
            before = max(t - 1, 0)
            longest = 0.0
            for s in range(spheres):
                travel[s] = 0.0
                for j in range(joints):
                    turn = trajectories[p, j, t] - trajectories[p, j, before]
                    travel[s] += abs(turn) * robot.lever[s, j]
                travel[s] *= steepness
                longest = max(longest, travel[s])
            top = 1
            at[0] = 0.0
            at[1] = 1.0
            fresh = True
            while top > 0:
                if fresh:
                    spheres_here, balls_here, step = placed, balls, t
                    if at[top] < 1.0:
                        for j in range(joints):
                            start, end = trajectories[p, j, before], trajectories[p, j, t]
                            angles[j, 0] = start + at[top] * (end - start)
                        link_poses(
                            angles,
                            robot.prismatic,
                            base,
                            origins,
                            sine_between,
                            cosine_between,
                            rotation_between,
                            position_between,
                        )
                        place(rotation_between, position_between, link, center, placed_between)
                        place(
                            rotation_between,
                            position_between,
                            links,
                            robot.ball_center,
                            balls_between,
                        )
                        spheres_here, balls_here, step = placed_between, balls_between, 0
                    for s in range(spheres):
                        if link[s] == 0:
                            gap[top, s] = np.inf
                            continue
                        x = spheres_here[s, 0, step]
                        y = spheres_here[s, 1, step]
                        z = spheres_here[s, 2, step]
                        dx = x - measured_at[s, 0]
                        dy = y - measured_at[s, 1]
                        dz = z - measured_at[s, 2]
                        least = measured[s] - steepness * math.sqrt(dx * dx + dy * dy + dz * dz)
                        # What is farther than the nearest by the segment's path length settles
                        # the segment as it is; there is no need to measure it anew.
                        if least < nearest + travel[s]:
                            least = point_distance(x, y, z, *obstacles)
                            if has_grid:
                                least = min(least, lookup(values, corner, inv_spacing, x, y, z)[0])
                            least -= radius[s]
                            measured[s] = least
                            measured_at[s, 0] = x
                            measured_at[s, 1] = y
                            measured_at[s, 2] = z
                            nearest = min(nearest, least)
                        gap[top, s] = least
                    if clear_of_itself:
                        self_gap[top] = self_gap_of(
                            spheres_here,
                            balls_here,
                            step,
                            robot,
                        )
                        clear_of_itself = self_gap[top] >= tolerance
                    fresh = False
                share = at[top] - at[0]
                settled = True
                if t > 0 and share * longest > 2.0 * tolerance and top < _MOST_HALVINGS + 1:
                    if clear_of_itself:
                        settled = self_gap[0] + self_gap[top] >= share * longest
                    if settled:
                        for s in range(spheres):
                            ahead = 0.5 * (gap[0, s] + gap[top, s] - share * travel[s])
                            if ahead < nearest - tolerance:
                                settled = False
                                break
                if settled:
                    at[0] = at[top]
                    self_gap[0] = self_gap[top]
                    gap[0] = gap[top]
                    top -= 1
                else:
                    at[top + 1] = 0.5 * (at[0] + at[top])
                    top += 1
                    fresh = True
        clearance[p] = nearest
        self_free[p] = clear_of_itself


def check_collisions(
    trajectories: ArrayLike,
    robot: RobotModel,
    obstacles: Sequence[Obstacle] | PackedObstacles,
    tolerance: float = CLEARANCE_TOLERANCE,
    grid: DistanceGrid | None = None,
) -> CollisionCheck:
    """Check whole paths against obstacles and the arm itself.

    The path is linear in joint space between the given configurations. Spheres on link 0 are not
    checked against obstacles: they stand where the robot is mounted.

    Args:
        trajectories: (P,T,n) rad.
        robot: the arm and what it carries.
        obstacles: bodies at rest.
        tolerance: m, by which the clearance may be overestimated; a path is free if its clearance
            is at least this.
        grid: distance to what else there is, of which nothing better is known; it is taken as it
            is, and outside it the value is that of the nearest boundary point.

    Raises:
        ValueError: wrong shape or not finite, or `tolerance` is not positive.
    """
    q = check_trajectories(trajectories, robot.joints)
    if not (math.isfinite(tolerance) and tolerance > 0.0):
        raise ValueError(f"tolerance must be positive, got {tolerance}")
    packed = obstacles if isinstance(obstacles, PackedObstacles) else PackedObstacles.of(obstacles)
    clearance, self_free = np.empty(len(q)), np.empty(len(q), np.bool_)
    _check(
        np.ascontiguousarray(q.swapaxes(1, 2)),
        robot.arrays_along(q),
        packed.arrays,
        grid_arrays(grid),
        tolerance,
        clearance,
        self_free,
    )
    return CollisionCheck(clearance, (clearance >= tolerance) & self_free, self_free)


def minimum_duration(
    trajectories: ArrayLike, velocity: ArrayLike, fraction: float = VELOCITY_FRACTION
) -> FloatArray:
    """Return the shortest duration (P,) s within the velocity limits, the phase running evenly.

    Args:
        trajectories: (P,T,n) rad, at equal steps of phase.
        velocity: (n,) rad/s, velocity limits.
        fraction: share of the limits that may be used.

    Raises:
        ValueError: wrong shape, not finite, or limits or fraction not positive.
    """
    limits = np.asarray(velocity, np.float64)
    if limits.ndim != 1 or not (np.isfinite(limits) & (limits > 0.0)).all():
        raise ValueError(f"velocity must be (n,) positive numbers, got {velocity!r}")
    if not (math.isfinite(fraction) and fraction > 0.0):
        raise ValueError(f"fraction must be positive, got {fraction}")
    q = check_trajectories(trajectories, len(limits))
    shortest = (np.abs(np.diff(q, axis=1)) / (fraction * limits)).max(axis=(1, 2), initial=0.0)
    return np.asarray(shortest * (q.shape[1] - 1))


def within_joint_limits(trajectories: ArrayLike, robot: RobotModel) -> BoolArray:
    """Return (P,) whether trajectories (P,T,n) rad stay within the joint limits, up to rounding.

    Raises:
        ValueError: wrong shape or not finite.
    """
    q = check_trajectories(trajectories, robot.joints)
    above, below = q >= robot.lower - LIMIT_TOLERANCE, q <= robot.upper + LIMIT_TOLERANCE
    inside: BoolArray = np.all(above & below, axis=(1, 2))
    return inside


def verify(
    trajectories: ArrayLike,
    robot: RobotModel,
    obstacles: Sequence[Obstacle] | PackedObstacles,
    duration_limit: float = DURATION_LIMIT,
    grid: DistanceGrid | None = None,
) -> Verification:
    """Check collisions, joint limits and duration of trajectories (P,T,n) rad.

    Args:
        trajectories: (P,T,n) rad.
        robot: the arm and what it carries.
        obstacles: bodies at rest.
        duration_limit: s, within which an executable trajectory is finished.
        grid: distance to what else there is; see `check_collisions`.

    Raises:
        ValueError: wrong shape or not finite, or `duration_limit` is not positive.
    """
    if not duration_limit > 0.0:
        raise ValueError(f"duration_limit must be positive, got {duration_limit}")
    check = check_collisions(trajectories, robot, obstacles, grid=grid)
    limits = within_joint_limits(trajectories, robot)
    duration = minimum_duration(trajectories, robot.velocity)
    return Verification(
        collision_free=check.free,
        self_collision_free=check.self_free,
        clearance=check.clearance,
        within_limits=limits,
        duration=duration,
        executable=limits & (duration <= duration_limit),
    )
