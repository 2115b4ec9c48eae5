"""Compiled loops over whole particle sets: the costs of collisions and of limits.

The functions here check nothing; `smp_planner.collision.costs` does, and owns the documentation of
what is computed. P is the number of trajectories, T of steps, n of joints, S of spheres.
Trajectories, values and gradients are C-contiguous float64, indices int64; robots and maps are
float32, in which a sphere is placed to a micrometre. One thread each, without the interpreter's
lock.

Configurations are taken `LANES` at a time, whichever trajectory they belong to, and lie last in
memory: so every inner loop has one length that the compiler knows, and works on several
configurations at once. What concerns few of them (spheres near an obstacle, links near each other)
is gathered first, computed, and scattered back. No sum runs over configurations of different
trajectories, so the result for a trajectory does not depend on what else is in the set.

Gradients need no Jacobians: the derivative of the cost with respect to a sphere's centre is a force
on its link; force and moment about the origin are summed from the tip to the base and projected on
the joint axes, as in the recursive Newton-Euler algorithm.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np

from smp_gym.compiling import FAST, kernel
from smp_planner.occupancy.grid import BLOCK

__all__ = [
    "LANES",
    "joint_limits",
    "map_collision",
    "self_collision",
    "velocity_limits",
]

LANES = 128
"""Configurations that are taken through a kernel at once: what they need stays in the cache."""

# Numbers of eight lanes fill a register of AVX2; a rest of fewer would be done one by one.
_TOGETHER = 8
# From this many lanes on, all of them are computed: copying some out and back would take longer.
_DENSE = 80

# Float32 stays float32 in numba only beside numbers of its own kind.
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_CONCENTRIC = np.float32(1e-18)

# Pi / 2 as the sum of two numbers, for twice the digits.
_HALF_PI = 1.5707963267948966
_HALF_PI_REST = 6.123233995736766e-17
_S1, _S2, _S3, _S4 = (np.float32(c) for c in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880))
_C1, _C2, _C3, _C4 = (np.float32(c) for c in (-1 / 2, 1 / 24, -1 / 720, 1 / 40320))

_LOG2_E, _LN_2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)
_E2, _E3, _E4, _E5, _E6 = (np.float32(1.0 / c) for c in (2, 6, 24, 120, 720))
_MOST_EXPONENT = np.float32(80.0)


@kernel(fastmath={"contract", "arcp", "nsz"})
def _sine_cosine(angles, sine, cosine):
    """Write sine and cosine (N,), float32, of angles (N,), float64 rad, to 1e-7.

    As `smp_gym.robot.forward_kernels.sine_cosine`, with as many terms as float32 can show.
    """
    for i in range(angles.shape[0]):
        quarter = np.floor(angles[i] / _HALF_PI + 0.5)
        x = np.float32((angles[i] - quarter * _HALF_PI) - quarter * _HALF_PI_REST)
        z = x * x
        s = x + x * z * (_S1 + z * (_S2 + z * (_S3 + z * _S4)))
        c = _ONE + z * (_C1 + z * (_C2 + z * (_C3 + z * _C4)))
        turn = np.int32(quarter) & np.int32(3)
        odd = (turn & np.int32(1)) == np.int32(1)
        a = c if odd else s
        b = s if odd else c
        sine[i] = -a if turn >= 2 else a
        cosine[i] = -b if turn == 1 or turn == 2 else b


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _exponential(x):
    """Return e^x to 1e-6 for a float32 x; beyond +-80 that of +-80."""
    x = min(max(x, -_MOST_EXPONENT), _MOST_EXPONENT)
    whole = np.floor(x * _LOG2_E + _HALF)
    f = x - whole * _LN_2
    part = _ONE + f * (_ONE + f * (_E2 + f * (_E3 + f * (_E4 + f * (_E5 + f * _E6)))))
    return part * np.int32((np.int32(whole) + 127) << 23).view(np.float32)


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _load(trajectories, first, last, begin, angles):
    """Copy angles (n,LANES) of configurations `begin` and following, the last one repeated.

    Configurations are the steps `first` up to `last` of one trajectory after the other.

    Returns:
        How many configurations there were, at most LANES.
    """
    steps = last - first
    count = min(LANES, trajectories.shape[0] * steps - begin)
    p, t = begin // steps, first + begin % steps
    for lane in range(LANES):
        for j in range(trajectories.shape[2]):
            angles[j, lane] = trajectories[p, t, j]
        if lane < count - 1:
            t += 1
            if t == last:
                p, t = p + 1, first
    return count


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _chain(angles, turns, robot, frames):
    """Write the pose of each link, as `smp_gym.robot.forward_kernels.link_poses`.

    Args:
        angles: (n,LANES) rad, or m of a prismatic joint.
        turns: (2*n,LANES), written: sines, then cosines; of a prismatic joint those of 0.
        robot: as of `RobotModel.single`.
        frames: (12*(n+1),LANES), written: of each link the rotation by rows, then the position.
    """
    base, origins, prismatic = robot.base, robot.origins, robot.prismatic
    joints = angles.shape[0]
    _sine_cosine(angles.ravel(), turns[:joints].ravel(), turns[joints:].ravel())
    for k in range(joints):
        if prismatic[k]:
            turns[k] = _ZERO
            turns[joints + k] = _ONE
    for i in range(3):
        for t in range(LANES):
            frames[3 * i, t] = base[i, 0]
            frames[3 * i + 1, t] = base[i, 1]
            frames[3 * i + 2, t] = base[i, 2]
            frames[9 + i, t] = base[i, 3]
    for k in range(joints):
        xx, xy, xz, xp = origins[k, 0, 0], origins[k, 0, 1], origins[k, 0, 2], origins[k, 0, 3]
        yx, yy, yz, yp = origins[k, 1, 0], origins[k, 1, 1], origins[k, 1, 2], origins[k, 1, 3]
        zx, zy, zz, zp = origins[k, 2, 0], origins[k, 2, 1], origins[k, 2, 2], origins[k, 2, 3]
        at = 12 * k
        for i in range(3):
            for t in range(LANES):
                a = frames[at + 3 * i, t]
                b = frames[at + 3 * i + 1, t]
                c = frames[at + 3 * i + 2, t]
                sine, cosine = turns[k, t], turns[joints + k, t]
                x = a * xx + b * yx + c * zx
                y = a * xy + b * yy + c * zy
                frames[at + 12 + 3 * i, t] = x * cosine + y * sine
                frames[at + 13 + 3 * i, t] = y * cosine - x * sine
                frames[at + 14 + 3 * i, t] = a * xz + b * yz + c * zz
                frames[at + 21 + i, t] = frames[at + 9 + i, t] + (a * xp + b * yp + c * zp)
    for k in range(joints):
        if prismatic[k]:
            # All links beyond the joint move along its axis.
            for link in range(k + 1, joints + 1):
                for i in range(3):
                    for t in range(LANES):
                        along = frames[12 * k + 14 + 3 * i, t] * np.float32(angles[k, t])
                        frames[12 * link + 9 + i, t] += along


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _project(frames, prismatic, wrench, trajectories, first, last, begin, count, weight, gradient):
    """Add the joint torques, or forces, that forces and moments about the origin cause.

    Args:
        frames: from `_chain`.
        prismatic: (n,) whether a joint is.
        wrench: (6*(n+1),LANES) force and moment on each link; overwritten by the sum over the links
            from it outwards.
        trajectories: of the configurations, as the next four of `_load`.
        first: see there.
        last: see there.
        begin: see there.
        count: see there.
        weight: factor of what is added.
        gradient: (P,T,n), added to.
    """
    steps = last - first
    for k in range(trajectories.shape[2], 0, -1):
        at, on = 12 * k, 6 * k
        if prismatic[k - 1]:
            for t in range(LANES):
                for i in range(6):
                    wrench[on - 6 + i, t] += wrench[on + i, t]
                # The force along the axis.
                wrench[on, t] = (
                    frames[at + 2, t] * wrench[on, t]
                    + frames[at + 5, t] * wrench[on + 1, t]
                    + frames[at + 8, t] * wrench[on + 2, t]
                )
            continue
        for t in range(LANES):
            fx, fy, fz = wrench[on, t], wrench[on + 1, t], wrench[on + 2, t]
            mx, my, mz = wrench[on + 3, t], wrench[on + 4, t], wrench[on + 5, t]
            x, y, z = frames[at + 9, t], frames[at + 10, t], frames[at + 11, t]
            wrench[on - 6, t] += fx
            wrench[on - 5, t] += fy
            wrench[on - 4, t] += fz
            wrench[on - 3, t] += mx
            wrench[on - 2, t] += my
            wrench[on - 1, t] += mz
            # The torque about the axis, in place of the force, which is summed already.
            wrench[on, t] = (
                frames[at + 2, t] * (mx - (y * fz - z * fy))
                + frames[at + 5, t] * (my - (z * fx - x * fz))
                + frames[at + 8, t] * (mz - (x * fy - y * fx))
            )
    p, t = begin // steps, first + begin % steps
    for lane in range(count):
        for j in range(trajectories.shape[2]):
            gradient[p, t, j] += weight * wrench[6 * j + 6, lane]
        t += 1
        if t == last:
            p, t = p + 1, first


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _add_values(total, steps, begin, count, weight, value):
    """Add the costs (LANES,) of single configurations to those (P,) of their trajectories."""
    p, t = begin // steps, begin % steps
    for lane in range(count):
        value[p] += weight * total[lane]
        t += 1
        if t == steps:
            p, t = p + 1, 0


@kernel(fastmath=FAST, error_model="numpy")
def map_collision(
    trajectories, first, last, robot, grid, limit, edge_width, margin, weight, value, gradient
):
    """Add the sum over steps and moving spheres of ``p^2 - p_limit^2``; see `CollisionCost`.

    Args:
        trajectories: (P,T,n) rad.
        first: first step that counts.
        last: step after the last one.
        robot: as of `RobotModel.single`; spheres on link 0 do not move and are left out.
        grid: (X,Y,Z) signed distances in m, (3,) position of the first, 1/m inverse spacing, and
            the least value of each of its blocks; all float32.
        limit: (S,) m, distance of the centre from which on a sphere costs nothing.
        edge_width: m.
        margin: m.
        weight: factor of what is added.
        value: (P,), added to.
        gradient: (P,T,n), added to.
    """
    values, origin, inv_spacing, blocks = grid
    link, center, radius = robot.link, robot.center, robot.radius
    joints = trajectories.shape[2]
    angles = np.empty((joints, LANES), np.float64)
    turns = np.empty((2 * joints, LANES), np.float32)
    frames = np.empty((12 * (joints + 1), LANES), np.float32)
    wrench = np.empty((6 * (joints + 1), LANES), np.float32)
    total = np.empty(LANES, np.float32)
    placed = np.empty((3, LANES), np.float32)
    near = np.empty((3, LANES), np.float32)
    corner = np.empty((8, LANES), np.float32)
    force = np.empty((4, LANES), np.float32)
    cell = np.empty(LANES, np.int32)
    lanes = np.empty(LANES, np.int64)
    distances, least = values.ravel(), blocks.ravel()
    ox, oy, oz = origin[0], origin[1], origin[2]
    inv_width = _ONE / np.float32(edge_width)
    inv_block = inv_spacing / np.float32(BLOCK)
    ny, nz = np.int32(values.shape[1]), np.int32(values.shape[2])
    by, bz = np.int32(blocks.shape[1]), np.int32(blocks.shape[2])
    last_x, last_y, last_z = (
        np.float32(values.shape[0] - 1),
        np.float32(values.shape[1] - 1),
        np.float32(values.shape[2] - 1),
    )
    block_x, block_y, block_z = (
        np.float32(blocks.shape[0] - 1),
        np.float32(blocks.shape[1] - 1),
        np.float32(blocks.shape[2] - 1),
    )
    cell_x, cell_y, cell_z = (
        np.int32(values.shape[0] - 2),
        np.int32(values.shape[1] - 2),
        np.int32(values.shape[2] - 2),
    )
    row, plane = np.uint64(values.shape[2]), np.uint64(values.shape[1] * values.shape[2])
    one = np.uint64(1)
    for begin in range(0, trajectories.shape[0] * (last - first), LANES):
        count = _load(trajectories, first, last, begin, angles)
        _chain(angles, turns, robot, frames)
        wrench[:] = _ZERO
        total[:] = _ZERO
        for s in range(link.shape[0]):
            if link[s] == 0:
                continue
            at, on = 12 * link[s], 6 * link[s]
            cx, cy, cz = center[s, 0], center[s, 1], center[s, 2]
            farthest = limit[s]
            for i in range(3):
                for t in range(LANES):
                    placed[i, t] = frames[at + 9 + i, t] + (
                        frames[at + 3 * i, t] * cx
                        + frames[at + 3 * i + 1, t] * cy
                        + frames[at + 3 * i + 2, t] * cz
                    )
            for t in range(LANES):
                u = (placed[0, t] - ox) * inv_block
                v = (placed[1, t] - oy) * inv_block
                w = (placed[2, t] - oz) * inv_block
                # Written so that NaN, for which every comparison is false, lands in the grid.
                u = min(u if u > _ZERO else _ZERO, block_x)
                v = min(v if v > _ZERO else _ZERO, block_y)
                w = min(w if w > _ZERO else _ZERO, block_z)
                cell[t] = (np.int32(u) * by + np.int32(v)) * bz + np.int32(w)
            found = 0
            for t in range(count):
                lanes[found] = t
                found += least[np.uint64(cell[t])] < farthest
            if found == 0:
                continue
            dense = found >= _DENSE
            if dense:
                padded = LANES
                for i in range(3):
                    for t in range(LANES):
                        near[i, t] = placed[i, t]
            else:
                padded = (found + _TOGETHER - 1) // _TOGETHER * _TOGETHER
                for m in range(found, padded):
                    lanes[m] = lanes[0]
                for m in range(padded):
                    t = np.uint64(lanes[m])
                    near[0, m] = placed[0, t]
                    near[1, m] = placed[1, t]
                    near[2, m] = placed[2, t]
            for m in range(padded):
                u = (near[0, m] - ox) * inv_spacing
                v = (near[1, m] - oy) * inv_spacing
                w = (near[2, m] - oz) * inv_spacing
                u = min(u if u > _ZERO else _ZERO, last_x)
                v = min(v if v > _ZERO else _ZERO, last_y)
                w = min(w if w > _ZERO else _ZERO, last_z)
                i, j, k = (
                    min(np.int32(u), cell_x),
                    min(np.int32(v), cell_y),
                    min(np.int32(w), cell_z),
                )
                cell[m] = (i * ny + j) * nz + k
            for m in range(padded):
                c = np.uint64(cell[m])
                corner[0, m] = distances[c]
                corner[1, m] = distances[c + one]
                corner[2, m] = distances[c + row]
                corner[3, m] = distances[c + row + one]
                corner[4, m] = distances[c + plane]
                corner[5, m] = distances[c + plane + one]
                corner[6, m] = distances[c + plane + row]
                corner[7, m] = distances[c + plane + row + one]
            offset = radius[s] + np.float32(margin)
            floor = _ONE / (_ONE + _exponential((farthest - offset) * inv_width))
            floor *= floor
            for m in range(padded):
                u = (near[0, m] - ox) * inv_spacing
                v = (near[1, m] - oy) * inv_spacing
                w = (near[2, m] - oz) * inv_spacing
                # Outside the grid the distance is that of its nearest point, and changes only
                # along the boundary.
                sx = inv_spacing if (u >= _ZERO) & (u <= last_x) else _ZERO
                sy = inv_spacing if (v >= _ZERO) & (v <= last_y) else _ZERO
                sz = inv_spacing if (w >= _ZERO) & (w <= last_z) else _ZERO
                u = min(u if u > _ZERO else _ZERO, last_x)
                v = min(v if v > _ZERO else _ZERO, last_y)
                w = min(w if w > _ZERO else _ZERO, last_z)
                a = u - np.float32(min(np.int32(u), cell_x))
                b = v - np.float32(min(np.int32(v), cell_y))
                c = w - np.float32(min(np.int32(w), cell_z))
                d00 = corner[1, m] - corner[0, m]
                d01 = corner[3, m] - corner[2, m]
                d10 = corner[5, m] - corner[4, m]
                d11 = corner[7, m] - corner[6, m]
                v00 = corner[0, m] + c * d00
                v01 = corner[2, m] + c * d01
                v10 = corner[4, m] + c * d10
                v11 = corner[6, m] + c * d11
                v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
                d0, d1 = d00 + b * (d01 - d00), d10 + b * (d11 - d10)
                distance = v0 + a * (v1 - v0)
                occupancy = _ONE / (_ONE + _exponential((distance - offset) * inv_width))
                square = occupancy * occupancy
                inside = distance < farthest
                slope = -_TWO * inv_width * square * (_ONE - occupancy)
                slope = slope if inside else _ZERO
                force[0, m] = slope * sx * (v1 - v0)
                force[1, m] = slope * sy * ((v01 - v00) + a * ((v11 - v10) - (v01 - v00)))
                force[2, m] = slope * sz * (d0 + a * (d1 - d0))
                force[3, m] = square - floor if inside else _ZERO
            if dense:
                for t in range(LANES):
                    fx, fy, fz = force[0, t], force[1, t], force[2, t]
                    x, y, z = placed[0, t], placed[1, t], placed[2, t]
                    wrench[on, t] += fx
                    wrench[on + 1, t] += fy
                    wrench[on + 2, t] += fz
                    wrench[on + 3, t] += y * fz - z * fy
                    wrench[on + 4, t] += z * fx - x * fz
                    wrench[on + 5, t] += x * fy - y * fx
                for t in range(LANES):
                    total[t] += force[3, t]
            else:
                for m in range(found):
                    t = np.uint64(lanes[m])
                    fx, fy, fz = force[0, m], force[1, m], force[2, m]
                    x, y, z = near[0, m], near[1, m], near[2, m]
                    wrench[on, t] += fx
                    wrench[on + 1, t] += fy
                    wrench[on + 2, t] += fz
                    wrench[on + 3, t] += y * fz - z * fy
                    wrench[on + 4, t] += z * fx - x * fz
                    wrench[on + 5, t] += x * fy - y * fx
                    total[t] += force[3, m]
        _project(
            frames,
            robot.prismatic,
            wrench,
            trajectories,
            first,
            last,
            begin,
            count,
            weight,
            gradient,
        )
        _add_values(total, last - first, begin, count, weight, value)


@kernel(fastmath=FAST, error_model="numpy")
def self_collision(trajectories, robot, reach, edge_width, margin, weight, value, gradient):
    """Add the sum over steps and pairs of spheres of ``p^2 - p_reach^2``; see `SelfCollisionCost`.

    Args:
        trajectories: (P,T,n) rad.
        robot: as of `RobotModel.single`.
        reach: gap from which on a pair costs nothing, m, not negative.
        edge_width: m.
        margin: m.
        weight: factor of what is added.
        value: (P,), added to.
        gradient: (P,T,n), added to.
    """
    center, radius = robot.center, robot.radius
    groups, pairs = robot.groups, robot.pairs
    joints, steps = trajectories.shape[2], trajectories.shape[1]
    angles = np.empty((joints, LANES), np.float64)
    turns = np.empty((2 * joints, LANES), np.float32)
    frames = np.empty((12 * (joints + 1), LANES), np.float32)
    wrench = np.empty((6 * (joints + 1), LANES), np.float32)
    total = np.empty(LANES, np.float32)
    balls = np.empty((3 * (joints + 1), LANES), np.float32)
    # Of the lanes in which two links are near: their poses, spheres, and what acts on them.
    poses = np.empty((24, LANES), np.float32)
    placed = np.empty((3 * robot.most_spheres, LANES), np.float32)
    acting = np.empty((10, LANES), np.float32)
    squares = np.empty(LANES, np.float32)
    lanes = np.empty(LANES, np.int64)
    reach, margin = np.float32(reach), np.float32(margin)
    inv_width = _ONE / np.float32(edge_width)
    floor = _ONE / (_ONE + _exponential((reach - margin) * inv_width))
    floor *= floor
    for begin in range(0, trajectories.shape[0] * steps, LANES):
        count = _load(trajectories, 0, steps, begin, angles)
        _chain(angles, turns, robot, frames)
        wrench[:] = _ZERO
        total[:] = _ZERO
        for k in range(joints + 1):
            cx, cy, cz = robot.ball_center[k, 0], robot.ball_center[k, 1], robot.ball_center[k, 2]
            for i in range(3):
                for t in range(LANES):
                    balls[3 * k + i, t] = frames[12 * k + 9 + i, t] + (
                        frames[12 * k + 3 * i, t] * cx
                        + frames[12 * k + 3 * i + 1, t] * cy
                        + frames[12 * k + 3 * i + 2, t] * cz
                    )
        for g in range(groups.shape[0]):
            i, j = groups[g, 0], groups[g, 1]
            clear = robot.ball_radius[i] + robot.ball_radius[j] + reach
            clear *= clear
            for t in range(LANES):
                dx = balls[3 * i, t] - balls[3 * j, t]
                dy = balls[3 * i + 1, t] - balls[3 * j + 1, t]
                dz = balls[3 * i + 2, t] - balls[3 * j + 2, t]
                squares[t] = dx * dx + dy * dy + dz * dz
            found = 0
            for t in range(count):
                lanes[found] = t
                found += squares[t] < clear
            if found == 0:
                continue
            padded = (found + _TOGETHER - 1) // _TOGETHER * _TOGETHER
            for m in range(found, padded):
                lanes[m] = lanes[0]
            for r in range(12):
                for m in range(padded):
                    t = np.uint64(lanes[m])
                    poses[r, m] = frames[12 * i + r, t]
                    poses[12 + r, m] = frames[12 * j + r, t]
            for s in range(groups[g, 4], groups[g, 5]):
                # Spheres of both links, in the order in which pairs name them.
                u = robot.of_groups[s]
                at = 0 if robot.link[u] == i else 12
                to = 3 * (s - groups[g, 4])
                cx, cy, cz = center[u, 0], center[u, 1], center[u, 2]
                for r in range(3):
                    for m in range(padded):
                        placed[to + r, m] = poses[at + 9 + r, m] + (
                            poses[at + 3 * r, m] * cx
                            + poses[at + 3 * r + 1, m] * cy
                            + poses[at + 3 * r + 2, m] * cz
                        )
            acting[:] = _ZERO
            touched = False
            for q in range(groups[g, 2], groups[g, 3]):
                a, b = 3 * pairs[q, 2], 3 * pairs[q, 3]
                both = radius[pairs[q, 0]] + radius[pairs[q, 1]]
                clear = (both + reach) * (both + reach)
                within = _ZERO
                for m in range(padded):
                    dx = placed[a, m] - placed[b, m]
                    dy = placed[a + 1, m] - placed[b + 1, m]
                    dz = placed[a + 2, m] - placed[b + 2, m]
                    within += max(clear - (dx * dx + dy * dy + dz * dz), _ZERO)
                if not within > _ZERO:
                    continue
                touched = True
                for m in range(padded):
                    ax, ay, az = placed[a, m], placed[a + 1, m], placed[a + 2, m]
                    bx, by, bz = placed[b, m], placed[b + 1, m], placed[b + 2, m]
                    dx, dy, dz = ax - bx, ay - by, az - bz
                    square = dx * dx + dy * dy + dz * dz
                    # Concentric spheres have no direction to part in.
                    between = np.sqrt(max(square, _CONCENTRIC))
                    occupancy = _ONE / (_ONE + _exponential((between - both - margin) * inv_width))
                    excess = occupancy * occupancy
                    slope = -_TWO * inv_width * excess * (_ONE - occupancy) / between
                    slope = slope if square < clear else _ZERO
                    fx, fy, fz = slope * dx, slope * dy, slope * dz
                    acting[0, m] += fx
                    acting[1, m] += fy
                    acting[2, m] += fz
                    acting[3, m] += ay * fz - az * fy
                    acting[4, m] += az * fx - ax * fz
                    acting[5, m] += ax * fy - ay * fx
                    acting[6, m] += by * fz - bz * fy
                    acting[7, m] += bz * fx - bx * fz
                    acting[8, m] += bx * fy - by * fx
                    acting[9, m] += excess - floor if square < clear else _ZERO
            if not touched:
                continue
            for m in range(found):
                t = np.uint64(lanes[m])
                for r in range(3):
                    wrench[6 * i + r, t] += acting[r, m]
                    wrench[6 * j + r, t] -= acting[r, m]
                    wrench[6 * i + 3 + r, t] += acting[3 + r, m]
                    wrench[6 * j + 3 + r, t] -= acting[6 + r, m]
                total[t] += acting[9, m]
        _project(
            frames, robot.prismatic, wrench, trajectories, 0, steps, begin, count, weight, gradient
        )
        _add_values(total, steps, begin, count, weight, value)


@kernel
def joint_limits(trajectories, lower, upper, weight, value, gradient):
    """Add the squared excess over joint limits; see `JointLimitCost`.

    Args:
        trajectories: (P,T,n) rad.
        lower: (n,) rad.
        upper: (n,) rad.
        weight: factor of what is added.
        value: (P,), added to.
        gradient: (P,T,n), added to.
    """
    count, steps, joints = trajectories.shape
    for p in range(count):
        for t in range(steps):
            for j in range(joints):
                q = trajectories[p, t, j]
                if lower[j] <= q <= upper[j]:
                    continue
                excess = q - min(max(q, lower[j]), upper[j])
                value[p] += weight * excess * excess
                gradient[p, t, j] += 2.0 * weight * excess


@kernel
def velocity_limits(trajectories, per_step, weight, value, gradient):
    """Add the squared relative excess over velocity limits; see `VelocityLimitCost`.

    Args:
        trajectories: (P,T,n) rad.
        per_step: (n,) share of the allowed velocity that a change of one rad in a step is.
        weight: factor of what is added.
        value: (P,), added to.
        gradient: (P,T,n), added to.
    """
    count, steps, joints = trajectories.shape
    for p in range(count):
        for t in range(steps - 1):
            for j in range(joints):
                share = (trajectories[p, t + 1, j] - trajectories[p, t, j]) * per_step[j]
                if abs(share) <= 1.0:
                    continue
                excess = share - min(max(share, -1.0), 1.0)
                value[p] += weight * excess * excess
                slope = 2.0 * weight * excess * per_step[j]
                gradient[p, t + 1, j] += slope
                gradient[p, t, j] -= slope
