"""Compiled loops over whole particle sets: the costs of collisions.

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

from smp_gym.compiling import FAST, kernel
from smp_gym.robot.forward_kernels import chain, place, sine_cosine
from smp_planner.occupancy.grid import lookup

__all__ = [
    "BLOCK",
    "least_of_blocks",
    "map_collision",
    "self_collision",
]

BLOCK = 4
"""Cells of the grid along each edge of a block that is passed over as a whole."""


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

    Most spheres are far from everything; one lookup in this small grid tells.

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
