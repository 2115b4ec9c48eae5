"""RRT-Connect in joint space: two trees that grow towards each other (Kuffner & LaValle 2000)."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_planner.collision.edge_check import EdgeChecker, edge_is_free, new_scratch
from smp_planner.collision.robot_model import RobotModel

__all__ = ["rrt_connect", "search_box"]


@kernel
def _nearest(nodes, count, target):
    """Return the index of the nearest of the first `count` nodes (N,n) to a configuration."""
    best, index = np.inf, -1
    for i in range(count):
        square = 0.0
        for j in range(target.shape[0]):
            square += (nodes[i, j] - target[j]) ** 2
        if square < best:
            best, index = square, i
    return index


@kernel
def _extend(world, scratch, nodes, parents, count, source, target, step):
    """Write the node that is one step from `source` towards a target.

    Returns:
        0 if the edge to it is not free, 2 if the node is the target, else 1.
    """
    distance = 0.0
    for j in range(target.shape[0]):
        distance += (target[j] - nodes[source, j]) ** 2
    distance = math.sqrt(distance)
    last = distance <= step
    for j in range(target.shape[0]):
        here = nodes[source, j]
        nodes[count, j] = target[j] if last else here + step / distance * (target[j] - here)
    if not edge_is_free(world, scratch, nodes[source], nodes[count]):
        return 0
    parents[count] = source
    return 2 if last else 1


@kernel
def _search(world, samples, step, nodes, parents, counts):
    """Grow both trees until they meet; return the nodes where they do, and the iterations.

    The nodes are (-1, -1) where the trees have not met.

    Args:
        world: an `edge_check.World`.
        samples: (I,n), towards which the trees grow.
        step: rad, longest edge.
        nodes: (2,N,n) of the tree from the start and of that from the goals; the roots are given.
        parents: (2,N) indices, -1 for roots.
        counts: (2,) how many nodes there are.
    """
    scratch = new_scratch(world)
    room = nodes.shape[1]
    for i in range(samples.shape[0]):
        tree = i % 2
        target, greedy = samples[i], False
        # First one tree takes a step, then the other goes as far as it comes.
        while True:
            node = _nearest(nodes[tree], counts[tree], target)
            outcome = 1
            while outcome == 1:
                if counts[tree] == room:
                    return -1, -1, i + 1
                outcome = _extend(
                    world, scratch, nodes[tree], parents[tree], counts[tree], node, target, step
                )
                if outcome > 0:
                    node = counts[tree]
                    counts[tree] += 1
                if not greedy:
                    break
            if greedy and outcome == 2:
                met = counts[1 - tree] - 1
                return (node, met, i + 1) if tree == 0 else (met, node, i + 1)
            if greedy or outcome == 0:
                break
            target, greedy = nodes[tree, node], True
            tree = 1 - tree
    return -1, -1, samples.shape[0]


def _branch(nodes: FloatArray, parents: NDArray[np.int64], leaf: int) -> FloatArray:
    """Return the configurations (V,n) from a leaf to its root."""
    indices = [leaf]
    while parents[indices[-1]] >= 0:
        indices.append(int(parents[indices[-1]]))
    return nodes[indices]


def search_box(robot: RobotModel, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the bounds (n,) and (n,) rad within which configurations are drawn.

    They are the joint limits, and for joints with more than one turn half a turn from the start.

    Args:
        robot: whose limits they are.
        start: (n,) rad.
    """
    reach = np.where(robot.endless, np.pi, np.inf)
    return np.maximum(robot.lower, start - reach), np.minimum(robot.upper, start + reach)


def rrt_connect(
    start: ArrayLike,
    goals: ArrayLike,
    checker: EdgeChecker,
    rng: np.random.Generator,
    *,
    iterations: int = 10_000,
    step: float = 0.5,
    counted: list[int] | None = None,
) -> FloatArray | None:
    """Return a path from a configuration to one of several others, or None if none was found.

    Kuffner & LaValle 2000, Fig. 5: two trees; one grows a step towards a random configuration, the
    other as far as it comes towards what the first one gained; then they change places. All goals
    are roots of the second tree. The first step is towards the first goal; after that,
    configurations are drawn evenly within `search_box`.

    Args:
        start: (n,) rad.
        goals: (G,n) rad; those that are not free are passed over.
        checker: says what is free.
        rng: source of all randomness.
        iterations: how often a tree takes a step, at most.
        step: rad, longest edge.
        counted: to which the number of iterations that it took is added; none where an end is not
            free, and there is nothing to search.

    Returns:
        (V,n) rad, its edges free.

    Raises:
        ValueError: wrong shape, not finite, or `iterations` or `step` not positive.
    """
    robot = checker.robot
    root = np.ascontiguousarray(start, np.float64)
    ends = np.ascontiguousarray(goals, np.float64)
    if root.shape != (robot.joints,) or not np.isfinite(root).all():
        raise ValueError(f"start must be {robot.joints} finite numbers, got {start!r}")
    if ends.ndim != 2 or ends.shape[1] != robot.joints or not np.isfinite(ends).all():
        raise ValueError(f"goals must be finite, of shape (G, {robot.joints}), got {ends.shape}")
    if iterations < 1:
        raise ValueError(f"iterations must be at least 1, got {iterations}")
    if not (math.isfinite(step) and step > 0.0):
        raise ValueError(f"step must be positive, got {step}")
    ends = ends[checker.configurations_free(ends)]
    if not len(ends) or not checker.configurations_free(root[None])[0]:
        return None
    lower, upper = search_box(robot, root)
    samples = rng.uniform(lower, upper, (iterations, robot.joints))
    samples[0] = ends[0]
    room = len(ends) + 8 * iterations
    nodes = np.empty((2, room, robot.joints))
    parents = np.empty((2, room), np.int64)
    counts = np.array([1, len(ends)])
    for tree, roots in enumerate((root[None], ends)):
        nodes[tree, : len(roots)] = roots
        parents[tree, : len(roots)] = -1
    near, far, taken = _search(checker.world, samples, float(step), nodes, parents, counts)
    if counted is not None:
        counted.append(taken)
    if near < 0:
        return None
    there = _branch(nodes[0], parents[0], near)[::-1]
    # Both branches end in the configuration where the trees met.
    return np.concatenate([there, _branch(nodes[1], parents[1], far)[1:]])
