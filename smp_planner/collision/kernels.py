"""Compiled loops over whole particle sets: the chain, collision costs, carried points.

The functions here check nothing; `smp_planner.collision.costs` and
`smp_planner.collision.verification` do, and own the documentation of what is computed. P is the
number of trajectories, T of steps, n of joints, S of spheres; arrays are C-contiguous float64,
indices int64. The steps come last in memory, so that the processor works on several at once. One
thread each, without the interpreter's lock.

Gradients need no Jacobians: the derivative of the cost with respect to a sphere's centre is a force
on its link; force and moment about the origin are summed from the tip to the base and projected on
the joint axes, as in the recursive Newton-Euler algorithm.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np

from smp_gym.compiling import kernel
from smp_planner.occupancy.grid import lookup

__all__ = [
    "BLOCK",
    "FAST",
    "carried_points",
    "chain",
    "least_of_blocks",
    "map_collision",
    "place",
    "self_collision",
    "sine_cosine",
]

FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Fast mathematics, but for the assumption that NaN and infinity do not occur."""

BLOCK = 4
"""Cells of the grid along each edge of a block that is passed over as a whole."""

# Pi / 2 as the sum of two numbers, for twice the digits.
_HALF_PI = 1.5707963267948966
_HALF_PI_REST = 6.123233995736766e-17


@kernel(fastmath={"contract", "arcp", "nsz"})
def sine_cosine(angles, sine, cosine):
    """Write sine and cosine of angles (N,) rad, twenty times faster than one by one.

    The Taylor series after reduction to [-pi/4, pi/4], where what is left out is below 1e-16;
    without branches, so that several angles are done at once. The error grows with the angle, by
    1e-16 each radian.
    """
    for i in range(angles.shape[0]):
        quarter = np.floor(angles[i] / _HALF_PI + 0.5)
        x = (angles[i] - quarter * _HALF_PI) - quarter * _HALF_PI_REST
        z = x * x
        s = 1 - z / 72 * (1 - z / 110 * (1 - z / 156 * (1 - z / 210)))
        s = x * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * s)))
        c = 1 - z / 90 * (1 - z / 132 * (1 - z / 182 * (1 - z / 240)))
        c = 1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * c)))
        turn = np.int64(quarter) & 3
        odd = (turn & 1) == 1
        a = c if odd else s
        b = s if odd else c
        sine[i] = -a if turn >= 2 else a
        cosine[i] = -b if turn == 1 or turn == 2 else b


@kernel(fastmath=FAST)
def chain(sine, cosine, base, origins, rotation, position):
    """Write the pose of each link at each step.

    Args:
        sine: (n,T) of the joint angles.
        cosine: (n,T) of the joint angles.
        base: (4,4) pose of link 0.
        origins: (n,4,4) from link i to the frame of joint i + 1 at angle zero.
        rotation: (n+1,3,3,T), written; its last column is the axis of the joint before the link.
        position: (n+1,3,T) m, written.
    """
    joints, steps = sine.shape
    for i in range(3):
        position[0, i] = base[i, 3]
        for j in range(3):
            rotation[0, i, j] = base[i, j]
    for k in range(joints):
        o = origins[k]
        for i in range(3):
            for t in range(steps):
                a = rotation[k, i, 0, t]
                b = rotation[k, i, 1, t]
                c = rotation[k, i, 2, t]
                x = a * o[0, 0] + b * o[1, 0] + c * o[2, 0]
                y = a * o[0, 1] + b * o[1, 1] + c * o[2, 1]
                rotation[k + 1, i, 0, t] = x * cosine[k, t] + y * sine[k, t]
                rotation[k + 1, i, 1, t] = y * cosine[k, t] - x * sine[k, t]
                rotation[k + 1, i, 2, t] = a * o[0, 2] + b * o[1, 2] + c * o[2, 2]
                position[k + 1, i, t] = position[k, i, t] + (
                    a * o[0, 3] + b * o[1, 3] + c * o[2, 3]
                )


@kernel(fastmath=FAST)
def place(rotation, position, link, center, placed):
    """Write the centres (S,3,T) m in the base frame of spheres given on links."""
    for s in range(link.shape[0]):
        k = link[s]
        for i in range(3):
            for t in range(placed.shape[2]):
                placed[s, i, t] = position[k, i, t] + (
                    rotation[k, i, 0, t] * center[s, 0]
                    + rotation[k, i, 1, t] * center[s, 1]
                    + rotation[k, i, 2, t] * center[s, 2]
                )


@kernel(fastmath=FAST)
def project(rotation, position, force, moment, gradient):
    """Write the joint torques (n,T) that forces and moments about the origin cause.

    Args:
        rotation: (n+1,3,3,T), from `chain`.
        position: (n+1,3,T) m, from `chain`.
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


@kernel
def least_of_blocks(values):
    """Return the least value that the interpolant takes in each block of `BLOCK`^3 cells.

    Most spheres are far from everything; one look at this small grid tells.

    Args:
        values: (X,Y,Z) grid of distances, m.
    """
    nx, ny, nz = values.shape
    least = np.full(
        ((nx + BLOCK - 2) // BLOCK, (ny + BLOCK - 2) // BLOCK, (nz + BLOCK - 2) // BLOCK),
        np.float32(np.inf),
    )
    # A node between two blocks counts for both: those of i - 1 and of i along each axis.
    for i in range(nx):
        for a in range(max(i - 1, 0) // BLOCK, min(i // BLOCK, least.shape[0] - 1) + 1):
            for j in range(ny):
                for b in range(max(j - 1, 0) // BLOCK, min(j // BLOCK, least.shape[1] - 1) + 1):
                    for k in range(nz):
                        value = values[i, j, k]
                        c = max(k - 1, 0) // BLOCK
                        if value < least[a, b, c]:
                            least[a, b, c] = value
                        c = min(k // BLOCK, least.shape[2] - 1)
                        if value < least[a, b, c]:
                            least[a, b, c] = value
    return least


@kernel(fastmath=FAST)
def map_collision(
    angles,
    base,
    origins,
    link,
    center,
    radius,
    values,
    origin,
    inv_spacing,
    blocks,
    limit,
    edge_width,
    margin,
    value,
    gradient,
):
    """Write the sum over steps and moving spheres of ``p^2 - p_limit^2``; see `CollisionCost`.

    Args:
        angles: (P,n,T) rad.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        link: (S,) link of each sphere; those on link 0 do not move and are left out.
        center: (S,3) m in the link's frame.
        radius: (S,) m.
        values: (X,Y,Z) float32, the grid of signed distances, m.
        origin: (3,) m, position of its first value.
        inv_spacing: 1/m.
        blocks: from `least_of_blocks`.
        limit: (S,) m, distance of the centre from which on a sphere costs nothing.
        edge_width: m.
        margin: m.
        value: (P,), written.
        gradient: (P,n,T), written.
    """
    count, joints, steps = angles.shape
    sine = np.empty((joints, steps))
    cosine = np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    force = np.empty((joints + 1, 3, steps))
    moment = np.empty((joints + 1, 3, steps))
    placed = np.empty((1, 3, steps))
    block = np.empty(steps, np.int64)
    inv_width = 1.0 / edge_width
    inv_block = inv_spacing / BLOCK
    nx, ny, nz = blocks.shape
    least = blocks.ravel()
    for p in range(count):
        sine_cosine(angles[p].ravel(), sine.ravel(), cosine.ravel())
        chain(sine, cosine, base, origins, rotation, position)
        force[:] = 0.0
        moment[:] = 0.0
        total = 0.0
        for s in range(link.shape[0]):
            k = link[s]
            if k == 0:
                continue
            place(rotation, position, link[s : s + 1], center[s : s + 1], placed)
            for t in range(steps):
                u = int(min(max((placed[0, 0, t] - origin[0]) * inv_block, 0.0), nx - 1.0))
                v = int(min(max((placed[0, 1, t] - origin[1]) * inv_block, 0.0), ny - 1.0))
                w = int(min(max((placed[0, 2, t] - origin[2]) * inv_block, 0.0), nz - 1.0))
                block[t] = (u * ny + v) * nz + w
            offset = radius[s] + margin
            farthest = limit[s]
            floor = (1.0 / (1.0 + math.exp((farthest - offset) * inv_width))) ** 2
            for t in range(steps):
                # Unsigned, so that no negative index has to be thought of.
                if least[np.uint64(block[t])] >= farthest:
                    continue
                x, y, z = placed[0, 0, t], placed[0, 1, t], placed[0, 2, t]
                distance, gx, gy, gz = lookup(values, origin, inv_spacing, x, y, z)
                if distance >= farthest:
                    continue
                occupancy = 1.0 / (1.0 + math.exp((distance - offset) * inv_width))
                square = occupancy * occupancy
                total += square - floor
                slope = -2.0 * inv_width * square * (1.0 - occupancy)
                gx *= slope
                gy *= slope
                gz *= slope
                force[k, 0, t] += gx
                force[k, 1, t] += gy
                force[k, 2, t] += gz
                moment[k, 0, t] += y * gz - z * gy
                moment[k, 1, t] += z * gx - x * gz
                moment[k, 2, t] += x * gy - y * gx
        project(rotation, position, force, moment, gradient[p])
        value[p] = total


@kernel(fastmath=FAST)
def _within(first, second, distance, squares):
    """Write squared distances (T,) of two moving points (3,T); return how many are less."""
    count = 0
    limit = distance * distance
    for t in range(squares.shape[0]):
        dx = first[0, t] - second[0, t]
        dy = first[1, t] - second[1, t]
        dz = first[2, t] - second[2, t]
        squares[t] = dx * dx + dy * dy + dz * dz
        count += squares[t] < limit
    return count


@kernel(fastmath=FAST)
def self_collision(
    angles,
    base,
    origins,
    link,
    center,
    radius,
    groups,
    sizes,
    pairs,
    ball_center,
    ball_radius,
    reach,
    edge_width,
    margin,
    value,
    gradient,
):
    """Write the sum over steps and pairs of spheres of ``p^2 - p_reach^2``.

    See `SelfCollisionCost`.

    Args:
        angles: (P,n,T) rad.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        link: (S,) link of each sphere.
        center: (S,3) m in the link's frame.
        radius: (S,) m.
        groups: (G,3), as in `LinkPairs`, like the next four.
        sizes: (G,).
        pairs: (M,2).
        ball_center: (n+1,3) m.
        ball_radius: (n+1,) m.
        reach: gap from which on a pair costs nothing, m, not negative.
        edge_width: m.
        margin: m.
        value: (P,), written.
        gradient: (P,n,T), written.
    """
    count, joints, steps = angles.shape
    sine = np.empty((joints, steps))
    cosine = np.empty((joints, steps))
    rotation = np.empty((joints + 1, 3, 3, steps))
    position = np.empty((joints + 1, 3, steps))
    force = np.empty((joints + 1, 3, steps))
    moment = np.empty((joints + 1, 3, steps))
    placed = np.empty((link.shape[0], 3, steps))
    balls = np.empty((joints + 1, 3, steps))
    links = np.arange(joints + 1)
    squares = np.empty(steps)
    inv_width = 1.0 / edge_width
    floor = (1.0 / (1.0 + math.exp((reach - margin) * inv_width))) ** 2
    for p in range(count):
        sine_cosine(angles[p].ravel(), sine.ravel(), cosine.ravel())
        chain(sine, cosine, base, origins, rotation, position)
        place(rotation, position, link, center, placed)
        place(rotation, position, links, ball_center, balls)
        force[:] = 0.0
        moment[:] = 0.0
        total = 0.0
        for g in range(groups.shape[0]):
            i = groups[g, 0]
            j = groups[g, 1]
            if not _within(balls[i], balls[j], ball_radius[i] + ball_radius[j] + reach, squares):
                continue
            for m in range(groups[g, 2], groups[g, 2] + sizes[g]):
                u = pairs[m, 0]
                v = pairs[m, 1]
                both = radius[u] + radius[v]
                if not _within(placed[u], placed[v], both + reach, squares):
                    continue
                for t in range(steps):
                    if squares[t] >= (both + reach) ** 2:
                        continue
                    between = math.sqrt(squares[t])
                    occupancy = 1.0 / (1.0 + math.exp((between - both - margin) * inv_width))
                    square = occupancy * occupancy
                    total += square - floor
                    # Concentric spheres have no direction to part in.
                    slope = -2.0 * inv_width * square * (1.0 - occupancy) / max(between, 1e-9)
                    ax, ay, az = placed[u, 0, t], placed[u, 1, t], placed[u, 2, t]
                    bx, by, bz = placed[v, 0, t], placed[v, 1, t], placed[v, 2, t]
                    fx, fy, fz = slope * (ax - bx), slope * (ay - by), slope * (az - bz)
                    force[i, 0, t] += fx
                    force[i, 1, t] += fy
                    force[i, 2, t] += fz
                    force[j, 0, t] -= fx
                    force[j, 1, t] -= fy
                    force[j, 2, t] -= fz
                    moment[i, 0, t] += ay * fz - az * fy
                    moment[i, 1, t] += az * fx - ax * fz
                    moment[i, 2, t] += ax * fy - ay * fx
                    moment[j, 0, t] -= by * fz - bz * fy
                    moment[j, 1, t] -= bz * fx - bx * fz
                    moment[j, 2, t] -= bx * fy - by * fx
        project(rotation, position, force, moment, gradient[p])
        value[p] = total


@kernel(fastmath=FAST)
def carried_points(angles, base, origins, link, point, placed, jacobians):
    """Write where a point fixed to the last link is, and how it moves with each joint.

    Args:
        angles: (n,N) rad.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        link: (1,) the last link.
        point: (1,3) m in the last link's frame.
        placed: (1,3,N) m in the base frame, written.
        jacobians: (3,n,N) m/rad, written.
    """
    joints, count = angles.shape
    sine = np.empty((joints, count))
    cosine = np.empty((joints, count))
    rotation = np.empty((joints + 1, 3, 3, count))
    position = np.empty((joints + 1, 3, count))
    sine_cosine(angles.ravel(), sine.ravel(), cosine.ravel())
    chain(sine, cosine, base, origins, rotation, position)
    place(rotation, position, link, point, placed)
    for k in range(1, joints + 1):
        for i in range(count):
            dx = placed[0, 0, i] - position[k, 0, i]
            dy = placed[0, 1, i] - position[k, 1, i]
            dz = placed[0, 2, i] - position[k, 2, i]
            ax, ay, az = rotation[k, 0, 2, i], rotation[k, 1, 2, i], rotation[k, 2, 2, i]
            jacobians[0, k - 1, i] = ay * dz - az * dy
            jacobians[1, k - 1, i] = az * dx - ax * dz
            jacobians[2, k - 1, i] = ax * dy - ay * dx
