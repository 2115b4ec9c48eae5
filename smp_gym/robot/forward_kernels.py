"""Compiled forward kinematics: the chain of links, and what is fixed to them.

The functions check nothing. T is the number of configurations, n of joints, S of spheres; arrays
are C-contiguous float64, indices int64. Configurations come last in memory, so that the processor
works on several at once. `chain` and `place` may contract and reorder sums; `exact_chain` and
`exact_place` are the same code in IEEE arithmetic, on which scenes depend to the last bit.
"""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np

from smp_gym.compiling import FAST, kernel

__all__ = [
    "carried_points",
    "chain",
    "exact_chain",
    "exact_place",
    "link_poses",
    "place",
    "sine_cosine",
    "sphere_paths",
]

_TOGETHER = 64
"""Configurations that `sphere_paths` takes through the chain at once, to keep them in cache."""

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


def _chain(sine, cosine, base, origins, rotation, position):
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


def _place(rotation, position, link, center, placed):
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


chain, exact_chain = kernel(_chain, fastmath=FAST), kernel(_chain)
place, exact_place = kernel(_place, fastmath=FAST), kernel(_place)


@kernel(fastmath=FAST)
def link_poses(positions, prismatic, base, origins, sine, cosine, rotation, position):
    """Write the pose of each link, as `chain`, of joints some of which may be prismatic.

    A prismatic joint turns nothing, and moves all links beyond it along its axis.

    Args:
        positions: (n,T) rad or m, of the joints.
        prismatic: (n,) whether a joint is.
        base: (4,4), as in `chain`, like the next.
        origins: (n,4,4).
        sine: (n,T), written, like the next; of a prismatic joint those of 0.
        cosine: (n,T).
        rotation: (n+1,3,3,T), written, as in `chain`, like the next.
        position: (n+1,3,T) m.
    """
    joints, steps = positions.shape
    sine_cosine(positions.ravel(), sine.ravel(), cosine.ravel())
    for k in range(joints):
        if prismatic[k]:
            sine[k] = 0.0
            cosine[k] = 1.0
    chain(sine, cosine, base, origins, rotation, position)
    for k in range(joints):
        if prismatic[k]:
            for link in range(k + 1, joints + 1):
                for i in range(3):
                    for t in range(steps):
                        position[link, i, t] += rotation[k + 1, i, 2, t] * positions[k, t]


@kernel
def sphere_paths(configurations, base, origins, link, center):
    """Return the centres of link spheres for many configurations.

    Args:
        configurations: (N, 6) rad.
        base: (4, 4) transform from the base frame to link 0.
        origins: (6, 4, 4) transform from each link to the frame of the next joint at angle 0.
        link: (S,) link of each sphere.
        center: (S, 3) in the link's frame.

    Returns:
        (N, S, 3).
    """
    count, joints = configurations.shape
    out = np.empty((count, len(link), 3))
    sine, cosine = np.empty((joints, _TOGETHER)), np.empty((joints, _TOGETHER))
    rotation = np.empty((joints + 1, 3, 3, _TOGETHER))
    position = np.empty((joints + 1, 3, _TOGETHER))
    placed = np.empty((len(link), 3, _TOGETHER))
    for start in range(0, count, _TOGETHER):
        steps = min(_TOGETHER, count - start)
        for k in range(joints):
            for t in range(steps):
                sine[k, t] = math.sin(configurations[start + t, k])
                cosine[k, t] = math.cos(configurations[start + t, k])
        exact_chain(sine, cosine, base, origins, rotation, position)
        exact_place(rotation, position, link, center, placed)
        for t in range(steps):
            for s in range(len(link)):
                for i in range(3):
                    out[start + t, s, i] = placed[s, i, t]
    return out


@kernel(fastmath=FAST)
def carried_points(positions, prismatic, base, origins, link, point, placed, jacobians):
    """Write where a point fixed to the last link is, and how it moves with each joint.

    Args:
        positions: (n,N) rad or m, as in `link_poses`.
        prismatic: (n,), as in `link_poses`.
        base: (4,4), as in `chain`.
        origins: (n,4,4), as in `chain`.
        link: (1,) the last link.
        point: (1,3) m in the last link's frame.
        placed: (1,3,N) m in the base frame, written.
        jacobians: (3,n,N) m/rad, or without unit of a prismatic joint; written.
    """
    joints, count = positions.shape
    sine = np.empty((joints, count))
    cosine = np.empty((joints, count))
    rotation = np.empty((joints + 1, 3, 3, count))
    position = np.empty((joints + 1, 3, count))
    link_poses(positions, prismatic, base, origins, sine, cosine, rotation, position)
    place(rotation, position, link, point, placed)
    for k in range(1, joints + 1):
        if prismatic[k - 1]:
            jacobians[:, k - 1] = rotation[k, :, 2]
            continue
        for i in range(count):
            dx = placed[0, 0, i] - position[k, 0, i]
            dy = placed[0, 1, i] - position[k, 1, i]
            dz = placed[0, 2, i] - position[k, 2, i]
            ax, ay, az = rotation[k, 0, 2, i], rotation[k, 1, 2, i], rotation[k, 2, 2, i]
            jacobians[0, k - 1, i] = ay * dz - az * dy
            jacobians[1, k - 1, i] = az * dx - ax * dz
            jacobians[2, k - 1, i] = ax * dy - ay * dx
