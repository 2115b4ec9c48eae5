"""Compiled loops over whole particle sets: the chain, collision costs, carried points.

The functions here check nothing; `smp_planner.costs` and `smp_planner.verification` do, and own the
documentation of what is computed. All arrays are C-contiguous float64 (link indices int64), P is the
number of trajectories, T of steps, n of joints, S of spheres. One thread each, without the
interpreter's lock.

Gradients need no Jacobians: the derivative of the cost with respect to a sphere's centre is a force
on its link; force and moment about the origin are summed from the tip to the base and projected on
the joint axes, as in the recursive Newton-Euler algorithm.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from smp_planner.occupancy.grid import lookup

__all__ = ["carried_points", "chain", "map_collision", "self_collision"]

# Everything that fast mathematics allows but the assumption that NaN and infinity do not occur.
FAST = {"reassoc", "contract", "arcp", "nsz"}

BLOCK = 4
"""Cells of the grid along each edge of a block that is passed over as a whole."""


@njit(cache=True, fastmath=FAST, nogil=True)
def chain(cosine, sine, base, origins, rotation, position):
    """Write the pose of each link.

    Args:
        cosine: (n,) of the joint angles.
        sine: (n,) of the joint angles.
        base: (4,4) pose of link 0.
        origins: (n,4,4) from link i to the frame of joint i + 1 at angle zero.
        rotation: (n + 1, 3, 3), written; its last column is the axis of the joint before the link.
        position: (n + 1, 3) m, written.
    """
    for i in range(3):
        position[0, i] = base[i, 3]
        for j in range(3):
            rotation[0, i, j] = base[i, j]
    for k in range(cosine.shape[0]):
        for i in range(3):
            a = rotation[k, i, 0]
            b = rotation[k, i, 1]
            c = rotation[k, i, 2]
            x = a * origins[k, 0, 0] + b * origins[k, 1, 0] + c * origins[k, 2, 0]
            y = a * origins[k, 0, 1] + b * origins[k, 1, 1] + c * origins[k, 2, 1]
            rotation[k + 1, i, 0] = x * cosine[k] + y * sine[k]
            rotation[k + 1, i, 1] = y * cosine[k] - x * sine[k]
            rotation[k + 1, i, 2] = a * origins[k, 0, 2] + b * origins[k, 1, 2] + c * origins[k, 2, 2]
            position[k + 1, i] = position[k, i] + (
                a * origins[k, 0, 3] + b * origins[k, 1, 3] + c * origins[k, 2, 3]
            )


@njit(cache=True, fastmath=FAST, nogil=True)
def place(rotation, position, link, center, placed):
    """Write the centres (S,3) m in the base frame of spheres given on links."""
    for s in range(link.shape[0]):
        k = np.uint64(link[s])
        for i in range(3):
            placed[s, i] = position[k, i] + (
                rotation[k, i, 0] * center[s, 0]
                + rotation[k, i, 1] * center[s, 1]
                + rotation[k, i, 2] * center[s, 2]
            )


@njit(cache=True, fastmath=FAST, nogil=True)
def project(rotation, position, force, moment, gradient):
    """Write the joint torques (n,) that forces (n+1,3) and moments about the origin (n+1,3) cause."""
    fx = fy = fz = mx = my = mz = 0.0
    for k in range(gradient.shape[0], 0, -1):
        fx += force[k, 0]
        fy += force[k, 1]
        fz += force[k, 2]
        x, y, z = position[k, 0], position[k, 1], position[k, 2]
        mx += moment[k, 0]
        my += moment[k, 1]
        mz += moment[k, 2]
        gradient[k - 1] = (
            rotation[k, 0, 2] * (mx - (y * fz - z * fy))
            + rotation[k, 1, 2] * (my - (z * fx - x * fz))
            + rotation[k, 2, 2] * (mz - (x * fy - y * fx))
        )


@njit(cache=True, nogil=True)
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
    # A node between two blocks counts for both: along each axis from (i - 1) // BLOCK to i // BLOCK.
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


@njit(cache=True, fastmath=FAST, nogil=True)
def block_of(coordinate, count):
    """Return the index of the block that holds a coordinate, counted in blocks, or the nearest."""
    return np.uint64(min(max(coordinate, 0.0), count - 1.0))


@njit(cache=True, fastmath=FAST, nogil=True)
def map_collision(
    cosine,
    sine,
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
    """Write the sum over steps and moving spheres of ``p^2 - p_limit^2``; see `collision_cost`.

    Args:
        cosine: (P,T,n) of the joint angles.
        sine: (P,T,n) of the joint angles.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        link: (S,) link of each sphere; those on link 0 do not move and are left out.
        center: (S,3) m in the link's frame.
        radius: (S,) m.
        values: (X,Y,Z) float32, the grid of signed distances, m.
        origin: (3,) m, position of its first value.
        inv_spacing: steps of the grid per metre.
        blocks: least value in each block of the grid, as from `least_of_blocks`.
        limit: (S,) m, distance of the centre from which on a sphere costs nothing.
        edge_width: m.
        margin: m.
        value: (P,), written.
        gradient: (P,T,n), written.
    """
    joints = cosine.shape[2]
    spheres = link.shape[0]
    rotation = np.empty((joints + 1, 3, 3))
    position = np.empty((joints + 1, 3))
    force = np.empty((joints + 1, 3))
    moment = np.empty((joints + 1, 3))
    inv_width = 1.0 / edge_width
    inv_block = inv_spacing / BLOCK
    floor = np.empty(spheres)
    offset = np.empty(spheres)
    for s in range(spheres):
        offset[s] = radius[s] + margin
        floor[s] = (1.0 / (1.0 + math.exp((limit[s] - offset[s]) * inv_width))) ** 2
    for p in range(cosine.shape[0]):
        total = 0.0
        for t in range(cosine.shape[1]):
            chain(cosine[p, t], sine[p, t], base, origins, rotation, position)
            force[:] = 0.0
            moment[:] = 0.0
            for s in range(spheres):
                k = np.uint64(link[s])
                if k == 0:
                    continue
                a, b, c = center[s, 0], center[s, 1], center[s, 2]
                x = position[k, 0] + (
                    rotation[k, 0, 0] * a + rotation[k, 0, 1] * b + rotation[k, 0, 2] * c
                )
                y = position[k, 1] + (
                    rotation[k, 1, 0] * a + rotation[k, 1, 1] * b + rotation[k, 1, 2] * c
                )
                z = position[k, 2] + (
                    rotation[k, 2, 0] * a + rotation[k, 2, 1] * b + rotation[k, 2, 2] * c
                )
                i = block_of((x - origin[0]) * inv_block, blocks.shape[0])
                j = block_of((y - origin[1]) * inv_block, blocks.shape[1])
                h = block_of((z - origin[2]) * inv_block, blocks.shape[2])
                if blocks[i, j, h] >= limit[s]:
                    continue
                distance, gx, gy, gz = lookup(values, origin, inv_spacing, x, y, z)
                if distance >= limit[s]:
                    continue
                occupancy = 1.0 / (1.0 + math.exp((distance - offset[s]) * inv_width))
                square = occupancy * occupancy
                total += square - floor[s]
                slope = -2.0 * inv_width * square * (1.0 - occupancy)
                gx *= slope
                gy *= slope
                gz *= slope
                force[k, 0] += gx
                force[k, 1] += gy
                force[k, 2] += gz
                moment[k, 0] += y * gz - z * gy
                moment[k, 1] += z * gx - x * gz
                moment[k, 2] += x * gy - y * gx
            project(rotation, position, force, moment, gradient[p, t])
        value[p] = total


@njit(cache=True, fastmath=FAST, nogil=True)
def self_collision(
    cosine,
    sine,
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

    See `self_collision_cost`.

    Args:
        cosine: (P,T,n) of the joint angles.
        sine: (P,T,n) of the joint angles.
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
        reach: gap from which on a pair costs nothing, m.
        edge_width: m.
        margin: m.
        value: (P,), written.
        gradient: (P,T,n), written.
    """
    joints = cosine.shape[2]
    spheres = link.shape[0]
    rotation = np.empty((joints + 1, 3, 3))
    position = np.empty((joints + 1, 3))
    force = np.empty((joints + 1, 3))
    moment = np.empty((joints + 1, 3))
    balls = np.empty((joints + 1, 3))
    placed = np.empty((spheres, 3))
    links = np.arange(joints + 1)
    inv_width = 1.0 / edge_width
    floor = (1.0 / (1.0 + math.exp((reach - margin) * inv_width))) ** 2
    far = np.empty(pairs.shape[0])
    for m in range(pairs.shape[0]):
        far[m] = max(radius[pairs[m, 0]] + radius[pairs[m, 1]] + reach, 0.0) ** 2
    for p in range(cosine.shape[0]):
        total = 0.0
        for t in range(cosine.shape[1]):
            chain(cosine[p, t], sine[p, t], base, origins, rotation, position)
            place(rotation, position, links, ball_center, balls)
            place(rotation, position, link, center, placed)
            force[:] = 0.0
            moment[:] = 0.0
            for g in range(groups.shape[0]):
                i = groups[g, 0]
                j = groups[g, 1]
                dx = balls[i, 0] - balls[j, 0]
                dy = balls[i, 1] - balls[j, 1]
                dz = balls[i, 2] - balls[j, 2]
                clear = ball_radius[i] + ball_radius[j] + reach
                if dx * dx + dy * dy + dz * dz >= clear * clear:
                    continue
                for m in range(groups[g, 2], groups[g, 2] + sizes[g]):
                    u = np.uint64(pairs[m, 0])
                    v = np.uint64(pairs[m, 1])
                    dx = placed[u, 0] - placed[v, 0]
                    dy = placed[u, 1] - placed[v, 1]
                    dz = placed[u, 2] - placed[v, 2]
                    square = dx * dx + dy * dy + dz * dz
                    if square >= far[m]:
                        continue
                    between = math.sqrt(square)
                    gap = between - radius[u] - radius[v]
                    occupancy = 1.0 / (1.0 + math.exp((gap - margin) * inv_width))
                    square = occupancy * occupancy
                    total += square - floor
                    # Concentric spheres have no direction to part in.
                    slope = -2.0 * inv_width * square * (1.0 - occupancy) / max(between, 1e-9)
                    dx *= slope
                    dy *= slope
                    dz *= slope
                    force[i, 0] += dx
                    force[i, 1] += dy
                    force[i, 2] += dz
                    force[j, 0] -= dx
                    force[j, 1] -= dy
                    force[j, 2] -= dz
                    moment[i, 0] += placed[u, 1] * dz - placed[u, 2] * dy
                    moment[i, 1] += placed[u, 2] * dx - placed[u, 0] * dz
                    moment[i, 2] += placed[u, 0] * dy - placed[u, 1] * dx
                    moment[j, 0] -= placed[v, 1] * dz - placed[v, 2] * dy
                    moment[j, 1] -= placed[v, 2] * dx - placed[v, 0] * dz
                    moment[j, 2] -= placed[v, 0] * dy - placed[v, 1] * dx
            project(rotation, position, force, moment, gradient[p, t])
        value[p] = total


@njit(cache=True, fastmath=FAST, nogil=True)
def carried_points(cosine, sine, base, origins, point, points, jacobians):
    """Write where a point of the last link is, and how it moves with each joint.

    Args:
        cosine: (N,n) of the joint angles.
        sine: (N,n) of the joint angles.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        point: (3,) m in the last link's frame.
        points: (N,3) m in the base frame, written.
        jacobians: (N,3,n) m/rad, written.
    """
    joints = cosine.shape[1]
    rotation = np.empty((joints + 1, 3, 3))
    position = np.empty((joints + 1, 3))
    for i in range(cosine.shape[0]):
        chain(cosine[i], sine[i], base, origins, rotation, position)
        for a in range(3):
            points[i, a] = position[joints, a] + (
                rotation[joints, a, 0] * point[0]
                + rotation[joints, a, 1] * point[1]
                + rotation[joints, a, 2] * point[2]
            )
        for k in range(1, joints + 1):
            dx = points[i, 0] - position[k, 0]
            dy = points[i, 1] - position[k, 1]
            dz = points[i, 2] - position[k, 2]
            ax, ay, az = rotation[k, 0, 2], rotation[k, 1, 2], rotation[k, 2, 2]
            jacobians[i, 0, k - 1] = ay * dz - az * dy
            jacobians[i, 1, k - 1] = az * dx - ax * dz
            jacobians[i, 2, k - 1] = ax * dy - ay * dx
