"""Search for a short path through layers of configurations, one of each in turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.collision.edge_check import EdgeChecker

__all__ = ["PathSearch", "path_through"]

PathSearch = Callable[[FloatArray, FloatArray, EdgeChecker, np.random.Generator], FloatArray | None]
"""Search for a path (V,n) rad from a start (n,) to one of several goals (G,n), such as
`tree_search.rrt_connect`."""

_PREDECESSORS = 4
"""Configurations of a layer, at most, from which a straight edge to each of the next is tried."""

_ROOTS = 4
"""Configurations of a layer, at most, from which a search is tried."""


def path_through(
    start: FloatArray,
    layers: Sequence[FloatArray],
    checker: EdgeChecker,
    rng: np.random.Generator,
    search: PathSearch,
) -> list[FloatArray] | None:
    """Return free paths from a start through one configuration of each layer, or None.

    Neighbouring layers are joined by straight edges where some are free, and the shortest chain of
    them is kept for each configuration (Viterbi 1967). Where none is, a search joins them.

    Args:
        start: (n,) rad.
        layers: each (C,n) rad; what is not free is passed over.
        checker: says what is free.
        rng: source of all randomness.
        search: joins what straight edges do not.

    Returns:
        One path (V,n) rad per layer, each beginning where the one before it ends.
    """
    nodes, costs = start[None], np.zeros(1)
    arrivals: list[list[tuple[int, FloatArray]]] = []
    for layer in layers:
        ahead = layer[checker.configurations_free(layer)]
        if not len(ahead):
            return None
        lengths = np.linalg.norm((ahead[:, None] - nodes) / checker.robot.velocity, axis=-1)
        totals = costs + lengths
        previous = np.argsort(totals, axis=1)[:, :_PREDECESSORS]
        starts = nodes[previous].reshape(-1, len(start))
        ends = np.repeat(ahead, previous.shape[1], axis=0)
        free = checker.edges_free(starts, ends).reshape(previous.shape)
        joined = np.flatnonzero(free.any(axis=1))
        if len(joined):
            chosen = previous[joined, free[joined].argmax(axis=1)]
            pairs = zip(chosen.tolist(), joined.tolist(), strict=True)
            arrivals.append([(i, np.stack([nodes[i], ahead[j]])) for i, j in pairs])
            nodes, costs = ahead[joined], totals[joined, chosen]
            continue
        for i in np.argsort(totals.min(axis=0))[:_ROOTS].tolist():
            path = search(nodes[i], ahead, checker, rng)
            if path is not None:
                break
        else:
            return None
        arrivals.append([(i, path)])
        nodes, costs = path[-1:], np.zeros(1)
    index = int(costs.argmin())
    chain: list[FloatArray] = []
    for of_layer in reversed(arrivals):
        index, path = of_layer[index]
        chain.append(path)
    return chain[::-1]
