"""Collision check of configurations and of straight edges between them, for tree searches.

The same geometry and the same bound as `smp_planner.collision.verification`, for the question that
a search poses ten thousand times: not how near a path comes, but whether it keeps a given distance.
The first configuration that does not keep it ends the check, and what is far from everything is
not measured again.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import Float32Array, FloatArray, IntArray
from smp_gym.compiling import FAST, kernel
from smp_gym.geometry.distance import PackedObstacles, point_distance
from smp_gym.robot.forward_kernels import link_poses, place
from smp_gym.robot.kinematics import concatenate
from smp_gym.scene import Obstacle
from smp_planner.collision.robot_model import RobotArrays, RobotModel, jaco_of_spheres
from smp_planner.collision.verification import CLEARANCE_TOLERANCE, grid_arrays, self_gap_of
from smp_planner.occupancy.grid import DistanceGrid, lookup

__all__ = ["EdgeChecker", "World", "edge_is_free", "new_scratch"]

# Halvings of one edge: enough for paths of a kilometre.
_MOST_HALVINGS = 22


class World(NamedTuple):
    """Robot, obstacles and the distance to keep, as arrays for compiled loops.

    Attributes:
        robot: see `RobotArrays`.
        parts: (K,4), each the first sphere, the one after the last, and likewise for the obstacles
            that these spheres must stay clear of.
        shape: (N,), as in `PackedObstacles`, like the next four.
        rotation: (N,3,3).
        position: (N,3) m.
        size: (N,3) m.
        bound: (N,) m.
        margin: m, least distance to obstacles.
        values: (X,Y,Z) m, distance on a grid to what else there is; of no length if there is none.
        corner: (3,) m, position of its first node.
        inv_spacing: 1/m.
        steepness: bound on the change of all distances per metre.
    """

    robot: RobotArrays
    parts: IntArray
    shape: IntArray
    rotation: FloatArray
    position: FloatArray
    size: FloatArray
    bound: FloatArray
    margin: float
    values: Float32Array
    corner: FloatArray
    inv_spacing: float
    steepness: float


class Scratch(NamedTuple):
    """Memory of `edge_is_free`, reused from edge to edge; each thread needs its own."""

    angles: FloatArray
    sine: FloatArray
    cosine: FloatArray
    rotation: FloatArray
    position: FloatArray
    placed: FloatArray
    balls: FloatArray
    links: IntArray
    travel: FloatArray
    measured: FloatArray
    at: FloatArray
    gap: FloatArray
    self_gap: FloatArray


@kernel
def new_scratch(world):
    """Return the `Scratch` for a `World`."""
    joints, spheres = world.robot.origins.shape[0], world.robot.link.shape[0]
    return Scratch(
        np.empty((joints, 1)),
        np.empty((joints, 1)),
        np.empty((joints, 1)),
        np.empty((joints + 1, 3, 3, 1)),
        np.empty((joints + 1, 3, 1)),
        np.empty((spheres, 3, 1)),
        np.empty((joints + 1, 3, 1)),
        np.arange(joints + 1),
        np.empty(spheres),
        np.empty(spheres),
        np.empty(_MOST_HALVINGS + 2),
        np.empty((_MOST_HALVINGS + 2, spheres)),
        np.empty(_MOST_HALVINGS + 2),
    )


@kernel(fastmath=FAST)
def _measure(world, scratch, row):
    """Write the gaps at `scratch.angles` to a row; return whether all are wide enough.

    A gap wider than the sphere's path along the whole edge settles the edge for that sphere: it is
    kept and not measured again.
    """
    robot = world.robot
    link_poses(
        scratch.angles,
        robot.prismatic,
        robot.base,
        robot.origins,
        scratch.sine,
        scratch.cosine,
        scratch.rotation,
        scratch.position,
    )
    placed = scratch.placed
    place(scratch.rotation, scratch.position, robot.link, robot.center, placed)
    least_allowed = world.margin + CLEARANCE_TOLERANCE
    for part in range(world.parts.shape[0] - 1, -1, -1):
        first, last = world.parts[part, 2], world.parts[part, 3]
        shape, rotation = world.shape[first:last], world.rotation[first:last]
        position, size = world.position[first:last], world.size[first:last]
        bound = world.bound[first:last]
        # The hand leads: what it carries collides first.
        for s in range(world.parts[part, 1] - 1, world.parts[part, 0] - 1, -1):
            if robot.link[s] == 0:
                scratch.gap[row, s] = np.inf
                continue
            gap = scratch.measured[s]
            if gap < least_allowed + scratch.travel[s]:
                x, y, z = placed[s, 0, 0], placed[s, 1, 0], placed[s, 2, 0]
                gap = point_distance(x, y, z, shape, rotation, position, size, bound)
                if world.values.shape[0] > 0:
                    gap = min(
                        gap, lookup(world.values, world.corner, world.inv_spacing, x, y, z)[0]
                    )
                gap -= robot.radius[s]
                if gap < least_allowed:
                    return False
                scratch.measured[s] = gap
            scratch.gap[row, s] = gap
    place(scratch.rotation, scratch.position, scratch.links, robot.ball_center, scratch.balls)
    scratch.self_gap[row] = self_gap_of(placed, scratch.balls, 0, robot)
    return scratch.self_gap[row] >= 2.0 * CLEARANCE_TOLERANCE


@kernel(fastmath=FAST)
def edge_is_free(world, scratch, start, end):
    """Return whether the straight edge between configurations (n,) rad is certainly free.

    Free is what keeps `world.margin` to all obstacles and `CLEARANCE_TOLERANCE` to itself all
    along. An edge that keeps less than that tolerance more may be refused. Settled by interval
    halving with the bound (a + b - h w_s) / 2 of `smp_planner.collision.verification`.
    """
    joints, spheres = start.shape[0], world.robot.link.shape[0]
    travel, at, gap, self_gap = scratch.travel, scratch.at, scratch.gap, scratch.self_gap
    longest = 0.0
    for s in range(spheres):
        travel[s] = 0.0
        for j in range(joints):
            travel[s] += abs(end[j] - start[j]) * world.robot.lever[s, j]
        travel[s] *= world.steepness
        longest = max(longest, travel[s])
        scratch.measured[s] = -np.inf
    # Row 0 is the configuration up to which the edge is settled; above it those still ahead.
    at[0], at[1] = 0.0, 1.0
    for row in range(1, -1, -1):
        for j in range(joints):
            scratch.angles[j, 0] = end[j] if row == 1 else start[j]
        if not _measure(world, scratch, row):
            return False
    top = 1
    while top > 0:
        share = at[top] - at[0]
        settled = True
        if share * longest > 2.0 * CLEARANCE_TOLERANCE and top < _MOST_HALVINGS + 1:
            settled = self_gap[0] + self_gap[top] - share * longest >= 2.0 * CLEARANCE_TOLERANCE
            if settled:
                for s in range(spheres):
                    if gap[0, s] + gap[top, s] - share * travel[s] < 2.0 * world.margin:
                        settled = False
                        break
        if settled:
            at[0] = at[top]
            self_gap[0] = self_gap[top]
            for s in range(spheres):
                gap[0, s] = gap[top, s]
            top -= 1
            continue
        middle = 0.5 * (at[0] + at[top])
        for j in range(joints):
            scratch.angles[j, 0] = start[j] + middle * (end[j] - start[j])
        # The stack holds what is ahead from far to near, so the new one goes on top.
        top += 1
        at[top] = middle
        if not _measure(world, scratch, top):
            return False
    return True


@kernel
def _edges(world, starts, ends, free):
    scratch = new_scratch(world)
    for i in range(starts.shape[0]):
        free[i] = edge_is_free(world, scratch, starts[i], ends[i])


class EdgeChecker:
    """Collision check of a robot among obstacles, by configurations and straight edges.

    Args:
        robot: the arm and what it carries.
        obstacles: bodies at rest.
        margin: m, distance to keep to obstacles; at least `CLEARANCE_TOLERANCE`, so that what is
            free here is free for `smp_planner.collision.verification` too.
        parts: (K,4), which spheres must stay clear of which obstacles, as in `World`; by default
            all of all.
        grid: distance to what else there is, of which nothing better is known; all spheres must
            stay clear of that, too.

    Raises:
        ValueError: `margin` is less than `CLEARANCE_TOLERANCE` or not finite.
    """

    def __init__(
        self,
        robot: RobotModel,
        obstacles: Sequence[Obstacle] | PackedObstacles,
        margin: float = CLEARANCE_TOLERANCE,
        parts: ArrayLike | None = None,
        grid: DistanceGrid | None = None,
    ) -> None:
        if not (math.isfinite(margin) and margin >= CLEARANCE_TOLERANCE):
            raise ValueError(
                f"margin must be finite and at least {CLEARANCE_TOLERANCE}, got {margin}"
            )
        packed = (
            obstacles if isinstance(obstacles, PackedObstacles) else PackedObstacles.of(obstacles)
        )
        table: ArrayLike = [(0, len(robot.link), 0, len(packed))] if parts is None else parts
        self.robot = robot
        table = np.array(table, np.int64)
        self.world = World(robot.arrays, table, *packed.arrays, margin, *grid_arrays(grid))

    @classmethod
    def of_all(
        cls,
        bodies: Sequence[tuple[RobotModel, Sequence[Obstacle]]],
        margin: float = CLEARANCE_TOLERANCE,
        grid: DistanceGrid | None = None,
    ) -> EdgeChecker:
        """Return the space that is free for several sets of spheres of the JACO at once.

        The spheres of each must stay clear of its own obstacles, and all of them of each other.

        Args:
            bodies: at least one robot model with its obstacles.
            margin: see the class.
            grid: see the class.

        Raises:
            ValueError: `margin` is less than `CLEARANCE_TOLERANCE` or not finite.
        """
        if len(bodies) == 1:
            return cls(*bodies[0], margin, grid=grid)
        models, obstacles = zip(*bodies, strict=True)
        spheres = np.cumsum([0] + [len(model.link) for model in models])
        places = np.cumsum([0] + [len(of_one) for of_one in obstacles])
        return cls(
            jaco_of_spheres(concatenate(*(model.spheres for model in models))),
            [obstacle for of_one in obstacles for obstacle in of_one],
            margin,
            np.column_stack([spheres[:-1], spheres[1:], places[:-1], places[1:]]),
            grid,
        )

    def configurations_free(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Return (N,) whether configurations (N,n) rad are free.

        Raises:
            ValueError: wrong shape, or not finite.
        """
        q = self._checked("configurations", configurations)
        return self._free(q, q)

    def edges_free(self, starts: ArrayLike, ends: ArrayLike) -> NDArray[np.bool_]:
        """Return (N,) whether the straight edges between configurations (N,n) rad are free.

        Free is what certainly keeps `margin` to all obstacles and `CLEARANCE_TOLERANCE` to itself
        all along. An edge that keeps less than that tolerance more may be refused.

        Raises:
            ValueError: wrong shape, or not finite.
        """
        a, b = self._checked("starts", starts), self._checked("ends", ends)
        if a.shape != b.shape:
            raise ValueError(f"ends must have the shape of starts {a.shape}, got {b.shape}")
        return self._free(a, b)

    def _free(self, starts: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
        free, world = np.empty(len(starts), np.bool_), self.world
        if self.robot.prismatic.any():
            world = world._replace(robot=self.robot.arrays_along(np.stack([starts, ends])))
        _edges(world, starts, ends, free)
        return free

    def _checked(self, name: str, value: ArrayLike) -> FloatArray:
        q = np.ascontiguousarray(value, np.float64)
        if q.ndim != 2 or q.shape[1] != self.robot.joints:
            raise ValueError(f"{name} must have shape (N, {self.robot.joints}), got {q.shape}")
        if not np.isfinite(q).all():
            raise ValueError(f"{name} must be finite, got {q[~np.isfinite(q).all(axis=1)][0]}")
        return q
